"""Outputs of a combination of a sweep, by name: of its geometry, its landing, its monitored fixes, its requirements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from navsim.results.schema import HEIGHTS, VERDICTS
from navsim.sweeps.scenario import BEACON_OUTPUTS, DOP_OUTPUTS, TOTAL_OUTPUTS, WATCHED_OUTPUTS

if TYPE_CHECKING:
    from navsim.landing.beacons import BeaconGlide
    from navsim.landing.requirements import RequirementValue
    from navsim.results.builder import ResultBuilder
    from navsim.results.result import Result
    from navsim.simulation.placement_geometry import Geometry

NUMBERED = "requirement_"
"""Beginning of the names of outputs of requirements."""


def dop_outputs(geometry: Geometry, sites: np.ndarray) -> dict[str, np.ndarray]:
    """The outputs of every method for placements (p, k, 3), ECEF m: each (p,)."""
    dops, lost = geometry.dops(sites)
    sigmas, _ = geometry.fix_sigmas(sites)
    values = [*dops[:, 0], *dops[:, 2], sigmas[1, 0], sigmas[2, 0], lost.astype(float)]
    return dict(zip(DOP_OUTPUTS, values, strict=True))


def beacon_outputs(glide: BeaconGlide, sites: np.ndarray) -> dict[str, np.ndarray]:
    """The outputs of beacons for placements (p, k, 3), ECEF m: each (p,)."""
    dops, _ = glide.dops(sites, median=True)
    return dict(zip(BEACON_OUTPUTS, [*dops[:, 0], *dops[:, 2], *dops[:, 3]], strict=True))


def landing_outputs(summary: ResultBuilder, lost: int) -> dict[str, float]:
    """Outputs of a landing from its result; lost: epochs of the glide without a fix."""

    def of_dops(group: str, *statistics: int) -> list[float]:
        dops = [summary[f"/summary/{group}/{name}"] for name in ("pdop", "hdop", "vdop")]
        return [float(d[i]) for i in statistics for d in dops]

    sigmas = [float(summary[f"/summary/fix/rms_{name}"][0]) for name in ("horizontal", "vertical")]
    out = dict(zip(DOP_OUTPUTS, [*of_dops("dop", 0, 2), *sigmas, float(lost)], strict=True))
    if "/summary/beacons/pdop" in summary:
        out |= dict(zip(BEACON_OUTPUTS, of_dops("beacons", 0, 2, 3), strict=True))
    return out


def watched_outputs(flown: Result) -> dict[str, float]:
    """Counts of monitored fixes, if any, with the ends of the intervals."""
    return _with_ends({
        name: flown[path] for name in WATCHED_OUTPUTS if (path := f"/summary/integrity/{name}") in flown
    })  # fmt: skip


def total_outputs(flown: Result) -> dict[str, float]:
    """Total system errors and ends of runs, if any, with the ends of the intervals."""
    paths = {"outside_box": "/summary/box/probability", "go_around": "/summary/go_around/share"}
    found = {name: flown[path] for name, path in paths.items() if path in flown}
    for name in TOTAL_OUTPUTS:
        axis, _, height = name.partition("_total_")
        if height and (path := f"/summary/at/{axis}_tse") in flown:
            found[name] = flown[path][list(HEIGHTS).index(height)]
    return _with_ends(found)


def _with_ends(found: dict[str, np.ndarray]) -> dict[str, float]:
    """Values with their intervals (3,) as outputs."""
    out: dict[str, float] = {}
    for name, interval in found.items():
        out |= dict(zip((name, f"{name}_low", f"{name}_high"), map(float, interval), strict=True))
    return out


def requirement_outputs(flown: Result) -> dict[str, float]:
    """Values of requirements, in the order of the scenario, as in a result; empty without any."""
    branch = "/summary/requirements"
    if f"{branch}/verdict" not in flown:
        return {}
    return _numbered(flown[f"{branch}/value"], [str(word) for word in flown[f"{branch}/verdict"]])


def outputs_of_fulfilments(found: Sequence[RequirementValue]) -> dict[str, float]:
    """Values of requirements without a result."""
    return _numbered(np.array([one.value for one in found]), [one.verdict() for one in found])


def _numbered(values: np.ndarray, words: Sequence[str]) -> dict[str, float]:
    out: dict[str, float] = {}
    for i, (interval, word) in enumerate(zip(values, words, strict=True), start=1):
        name = f"{NUMBERED}{i}"
        out |= dict(zip((name, f"{name}_low", f"{name}_high"), map(float, interval), strict=True))
        out[f"{name}_verdict"] = VERDICTS.index(word)
    return out
