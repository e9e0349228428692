"""Consistency test of every state at every output.

z is the root mean square over runs of error / sigma, one for a correct sigma. Over N runs N z^2 is then chi-square with
N degrees of freedom [1]. Every state at every output is one test, tens of thousands in a landing. The band must hold
for all of them: a consistent filter leaves it anywhere with the probability `FALSE_ALARM`.

Above the band, tests of a state follow each other in time and are correlated. With A_t for "beyond at output t", [2]
bounds P(A_1 or ... A_T) <= P(A_1) + sum P(A_t and not A_t-1), which needs only the correlation of neighbours. Divided
by P(A_1) this is the effective number of independent tests; those of all states add up. Below the band, exceedances
hardly cluster if there are few runs, so every test counts.

Sources:

- [1] Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
- [2] Worsley, Biometrika 69 (1982), An improved Bonferroni inequality and applications. docs/theory/consistency.md has
  the derivation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.filter.states import display_name, is_sigma_wrong
from navsim.results.findings import several
from navsim.statistics import chi_square, normal
from navsim.statistics.rounding import digits

FALSE_ALARM = 1e-3
"""Chance that a right filter is outside the band in any state at any output."""
LIMITS = (1.959963984540054, 3.2905267314918945)
"""Sigmas beyond which a normal error is with a chance of 5 % and of 0.1 %."""
_GROSS = 2.0
"""Ratio from which on a wrong sigma is reported as a factor, not in percent."""
_NONE = 1e-3
"""Ratio below which the filter knows of an error that is next to none."""
_SAME_MODEL = 5e-4
"""Least difference of an expected z from 1, at any state and output, that shows two models instead of one."""


@dataclass(frozen=True)
class Ratios:
    """Ratios z (t, n) of states; nan if a state has no uncertainty or is not finite."""

    time: np.ndarray
    """(t,) s."""
    names: Sequence[str]
    z: np.ndarray
    runs: int
    """Runs in the root mean square, the least of all outputs; 0: expected by a covariance analysis."""
    correlation: np.ndarray
    """(n,) of error / sigma at neighbouring outputs."""
    flown: int = 0
    """Runs, including those that are not finite at some output; 0: the same."""

    @property
    def looks(self) -> np.ndarray:
        """Outputs (n,) at which each state has a ratio."""
        return np.sum(~np.isnan(self.z), axis=0)


@dataclass(frozen=True)
class RatioBand:
    """Limits of z that a right filter keeps in all states at all outputs. looks: (n,) effective number of independent
    outputs of each state."""

    low: float
    high: float
    looks: np.ndarray


def correlation_of(squares: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Correlation (n,) of error / sigma at neighbouring outputs.

    squares: (t, n) means of z^2. steps: (n,) means of the sum over outputs of the squared change of z. nan where
    not evaluated by this method.
    """
    pairs = squares[1:] + squares[:-1]
    total = np.where(np.isfinite(pairs), pairs, 0.0).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(total > 0.0, np.clip(1.0 - steps / total, 0.0, 1.0), np.nan))


def simultaneous_band(ratios: Ratios, chance: float = FALSE_ALARM) -> RatioBand:
    """The band of z for all looks at once, which a right filter leaves with this chance, half of it to each side."""
    runs, outputs = ratios.runs, ratios.looks
    if not runs:
        return RatioBand(1.0, 1.0, outputs.astype(float))
    every = int(outputs.sum())
    if not every:
        return RatioBand(math.nan, math.nan, np.zeros(outputs.size))
    fewest, most = 1.0, float(every)  # of the logarithm of looks the root is found by halves
    for _ in range(40):
        looks = math.sqrt(fewest * most)
        found = float(_effective_looks(ratios.correlation, outputs, 0.5 * chance / looks).sum())
        fewest, most = (looks, most) if found > looks else (fewest, looks)
    high = chi_square.exceeded(0.5 * chance / most, runs) / runs
    low = chi_square.quantile(0.5 * chance / every, runs) / runs
    looks_of = _effective_looks(ratios.correlation, outputs, 0.5 * chance / most)
    return RatioBand(math.sqrt(low), math.sqrt(high), looks_of)


def _effective_looks(correlation: np.ndarray, outputs: np.ndarray, chance: float) -> np.ndarray:
    """Effective number of independent tests (n,) at states with so many outputs (n,), each beyond with this
    probability."""
    # mean squares of normal variables with correlation r have the correlation r^2
    # a state whose correlation is unknown counts every output as independent: the wider band
    known = np.where(np.isnan(correlation), 0.0, correlation)
    again = _conditional_exceedance(-normal.quantile(chance), known**2)
    return np.where(outputs > 0, 1.0 + np.maximum(outputs - 1, 0) * (1.0 - again), 0.0)


_NODES = np.linspace(0.0, 1.0, 401)[1:] ** 3
"""Nodes of the integral above a level: dense near it, where a high correlation makes it steep."""


def _conditional_exceedance(level: float, correlation: np.ndarray) -> np.ndarray:
    """Chance (n,) that of two standard normal variables of these correlations the second is above a level, if the first
    is."""
    from scipy.special import ndtr

    above = 10.0 * _NODES
    x = level + above
    density = np.exp(-0.5 * above**2 - level * above)  # over that at the level
    rest = np.sqrt(np.maximum(1.0 - correlation**2, 1e-30))[:, None]
    second = ndtr((correlation[:, None] * x - level) / rest)
    return np.asarray(np.trapezoid(density * second, above, axis=1) / np.trapezoid(density, above))


@dataclass(frozen=True)
class StateVerdict:
    """Result of a consistency test."""

    words: str
    """In words."""
    small: bool
    """A sigma is too small, by more than the tolerance and by more than chance: the filter is inconsistent."""
    at: tuple[int, int] | None
    """(output, state) of the largest z, None if nothing is known."""


def evaluate(ratios: Ratios, band: RatioBand, tolerance: float) -> StateVerdict:
    """The verdict on all states at all outputs: the worst one by name and time.

    tolerance: of z - 1, above or below, that serves as well as none.
    """
    z = ratios.z
    if not ratios.looks.any():
        return StateVerdict("none: no uncertainty", False, None)
    top, bottom = (_place(pick(z), z) for pick in (np.nanargmax, np.nanargmin))
    most, least = float(z[top]), float(z[bottom])
    small, large = is_sigma_wrong(most, least, (band.low, band.high), tolerance)
    whose = "to first order" if not ratios.runs else several(ratios.runs, "run")
    first = f"{_at(ratios, top)} (z {_number(most)}, {whose})"
    last = f"{_at(ratios, bottom)} (z {_number(least)}, {whose})"
    reach = max(most / band.low - 1.0, 1.0 - least / band.high)
    largest = f"largest z {_number(most)}, {_at(ratios, top)}"
    if ratios.runs == 1:
        found = "" if small else "no "
        words = f"{found}error beyond {band.high:.1f}σ in one run: {_number(most)}σ, {_at(ratios, top)}"
    elif small or large:
        words = "; ".join([f"sigma {_off(most)}: {first}"] * small + [f"sigma {_off(least)}: {last}"] * large)
    elif not ratios.runs and reach < _SAME_MODEL:
        words = "not tested: filter and truth have the same model"
    elif reach <= tolerance:
        words = f"sigma right within {_percent(reach)}: {largest} ({whose})"
    elif band.low <= least and most <= band.high:
        words = f"sigma right as far as {whose} tell (z {band.low:.2f} to {band.high:.2f}): {largest}"
    else:
        worst, at = (most, first) if most - 1.0 > 1.0 - least else (least, last)
        words = f"errors {_beside(worst)} sigma (significant, within the {_percent(tolerance)} tolerance): {at}"
    return StateVerdict(words + _unknown(ratios), small, top)


def _unknown(ratios: Ratios) -> str:
    """Runs, and outputs after the first, that are not tested, in words."""
    known = ~np.isnan(ratios.z)
    count = int((~known[1:, known.any(axis=0)]).any(axis=1).sum())
    lost = max(ratios.flown - ratios.runs, 0)
    runs = (
        f"; {several(lost, 'run')} of {ratios.flown} not finite at some outputs, and not tested there" if lost else ""
    )
    return runs + (f"; {count} of {known.shape[0]} outputs are not finite and not tested" if count else "")


def _place(flat: np.intp, z: np.ndarray) -> tuple[int, int]:
    output, state = np.unravel_index(flat, z.shape)
    return int(output), int(state)


def _at(ratios: Ratios, at: tuple[int, int]) -> str:
    return f"{display_name(ratios.names[at[1]])} at {ratios.time[at[0]]:g} s"


def _off(z: float) -> str:
    """By how much a sigma is wrong, in words."""
    if math.isinf(z):
        return "0 where there are errors"
    if z > _GROSS:
        return f"too small by a factor of {digits(z)}"
    if z < _NONE:
        return "over 1000 times too large"
    if z < 1.0 / _GROSS:
        return f"too large by a factor of {digits(1.0 / z)}"
    return f"too {'small' if z > 1.0 else 'large'}, errors {_beside(z)} it"


def _beside(z: float) -> str:
    """By how much errors are larger or smaller than a sigma, as z and the tolerance count it, in words."""
    return f"{_percent(abs(z - 1.0))} {'above' if z > 1.0 else 'below'}"


def _number(z: float) -> str:
    return f"{z:.2f}" if z < 10.0 else digits(z)


def _percent(share: float) -> str:
    return f"{100.0 * share:.{0 if share >= 0.0095 else 1}f} %"
