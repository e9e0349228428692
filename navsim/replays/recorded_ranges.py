"""Fixes and ranges of a recorded flight from RINEX observations and navigation messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from navsim.formats.recorded_data import Fixes, Ranges
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.formats.text import Dropped, FileError
from navsim.geodesy.earth import SPEED_OF_LIGHT
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.systems import System
from navsim.replays.single_point import PositioningOptions, solve

_STEP = 1e-3 * SPEED_OF_LIGHT
"""Step by which receivers correct their clocks, m: a whole millisecond."""


@dataclass(frozen=True)
class NavigationMessages:
    """Content of navigation files: constellations, and Klobuchar's coefficients if present."""

    constellations: tuple[Constellation, ...]
    klobuchar: tuple[np.ndarray, np.ndarray] | None


def read_messages(path: Path, lenient: bool, dropped: Dropped, systems: Sequence[System]) -> NavigationMessages:
    """The messages of some systems in a navigation file. Raises FileError, OSError as `rinex_nav.read_nav`."""
    found = read_nav(path, lenient, systems)
    others = found.without_usual()
    dropped.lines += found.left_out
    dropped.lines += (f"{of.title} flies by {sent}: there is no {of.message}" for of, sent in others.items())
    return NavigationMessages(tuple(found.constellations(others)), found.klobuchar)


def merge_messages(several: list[NavigationMessages]) -> NavigationMessages:
    """Messages of several files; the first file with a system counts."""
    each = {one.system.name: one for messages in reversed(several) for one in messages.constellations}
    klobuchar = next((messages.klobuchar for messages in several if messages.klobuchar is not None), None)
    return NavigationMessages(tuple(each.values()), klobuchar)


def read_ranges(
    path: Path, messages: NavigationMessages, options: PositioningOptions, fewest: int, shift: float, dropped: Dropped
) -> tuple[Fixes, Ranges]:
    """Fixes from RINEX observations, and their ranges with those of epochs without a fix.

    - `options`: without the ionosphere's coefficients, which the messages contain.
    - `fewest`: satellites of a fix; `shift`: from GPS s to the requested times, s.
    - `dropped`: omissions are added to it.

    Raises FileError, OSError as `rinex_obs.read_obs`, and for fewer than two fixes.
    """
    observations = read_obs(path, dropped.lenient)
    dropped.lines += observations.left_out
    try:
        klobuchar = messages.klobuchar if options.troposphere else None
        solution = solve(observations, messages.constellations, replace(options, klobuchar=klobuchar))
    except ValueError as error:
        raise FileError(0, str(error), path) from None
    dropped.lines += solution.verdicts.report(solution.ranges.names)
    solved = np.isfinite(solution.llh[:, 0])
    few = solved & (solution.satellites < fewest)
    dropped.add(f"fixes with fewer than {fewest} satellites", int(few.sum()))
    solved &= ~few
    if solved.sum() < 2:
        text = "".join(f"; {line}" for line in dropped.reasons())
        raise FileError(0, f"{solved.sum()} fixes by these messages; two are the least{text}", path)
    time = solution.time + shift
    ranges = replace(_steadied(solution.ranges, solution.clocks), time=time)
    empty = ~np.isfinite(ranges.pseudorange).any(axis=1)
    dropped.add("epochs without a range that the messages can use", int(empty.sum()))
    ranges = ranges.take(np.flatnonzero(~empty))
    return Fixes(time[solved], solution.llh[solved], solution.velocity[solved]), ranges


def _steadied(ranges: Ranges, clocks: np.ndarray) -> Ranges:
    """The ranges without the receiver's clock corrections by whole milliseconds; clocks: (e, c) as of
    `single_point.Solution`."""
    known = np.isfinite(clocks)
    first = np.where(known.any(axis=1), clocks[np.arange(clocks.shape[0]), np.argmax(known, axis=1)], np.nan)
    fixed = np.flatnonzero(np.isfinite(first))
    steps = np.zeros(clocks.shape[0])
    steps[fixed[1:]] = np.round(np.diff(first[fixed]) / _STEP)
    return replace(ranges, pseudorange=ranges.pseudorange - _STEP * np.cumsum(steps)[:, None])
