"""Outlier test of single-point fixes: residuals, exclusion of ranges, geometry, plausible heights and speeds.

The sum of squared residuals of a fix, each over its sigma, is chi-square distributed if all ranges are good. A fix that
fails the test is computed again without each of its ranges. The range without which it passes is excluded, if no other
would do nearly as well. Otherwise the fix is refused. A fix from as many ranges as unknowns has no residuals, and is
only compared with its neighbours.

Range rates are tested in the same way afterwards. The velocity is computed without those that contradict the others, or
omitted.

Sources: [1] Kaplan & Hegarty (2017), section 11.4 (chi-square test, exclusion). [2] RTKLIB 2.4.3, `pntpos.c` (`valsol`,
`raim_fde`: the test, its limit of DOP).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from navsim.geodesy.earth import ned_matrix

FALSE_ALARM = 1e-5
"""Probability that good ranges fail the test."""
_MOST_PDOP_WITHOUT = 10.0
"""Largest PDOP of a fix with excluded ranges, since a wrong exclusion has a large effect in a weak geometry."""
HEIGHTS = (-1e3, 1e5)
"""Heights of fixes that are given, m."""
FASTEST = 2000.0
"""Largest speed of fixes that are given, m/s."""
_MOST_EXCLUDED = 4
"""Ranges of an epoch that may be excluded."""
_DISTINCT = 2.0 * np.log(1000.0)
"""By how much the sum of squares has to be larger without any other range: the one is a thousand times likelier."""
_PAIRED, _VERY_BEST = 9, 3
"""Number of ranges, those without which the sum of squares is least, that are excluded in pairs; and number that are
combined with all others. A large error can hide a small one."""
_EPOCHS_AT_ONCE = 500
"""Epochs whose ranges are tried at once."""
_SCATTER = 500.0
"""Largest distance of an untested fix from its neighbours, m, beyond the distance flown between them."""
_MOST_NAMES = 12
RATE_SIGMA = 0.1
"""1 sigma of range rates, m/s, unless those of a recording scatter by more."""
_WORST_APART = 3.0
"""Largest ratio of the scatter of good rates to that without the worst of each epoch."""
_UNKNOWN_RATES = 4
"""Unknowns of a velocity: three components and the drift of the receiver's clock."""


@dataclass(frozen=True)
class TestedFixes:
    """Fixes at e epochs from any choice of s satellites; nan without a fix."""

    llh: np.ndarray
    """(e, 3)."""
    velocity: np.ndarray
    """(e, 3)."""
    clocks: np.ndarray
    """(e, c)."""
    covariance: np.ndarray
    """(e, 6, 6)."""
    position: np.ndarray
    """(e, 3) ECEF."""
    pdop: np.ndarray
    """(e,)."""
    used: np.ndarray
    """(e, s)."""
    residual: np.ndarray
    """(e, s) m, nan where not used."""
    sigma: np.ndarray
    """(e, s) m."""
    unknowns: np.ndarray
    """(e,) number of unknowns of a fix."""

    @property
    def fixed(self) -> np.ndarray:
        """(e,) whether there is a fix."""
        return np.isfinite(self.llh[:, 0])

    @property
    def redundancy(self) -> np.ndarray:
        """(e,) how many ranges there are beyond those that a fix needs."""
        return self.used.sum(axis=1) - self.unknowns

    @property
    def chi2(self) -> np.ndarray:
        """(e,) sum of squared residuals over their sigmas; inf without a fix."""
        return np.where(self.fixed, np.nansum((self.residual / self.sigma) ** 2, axis=1), np.inf)

    @property
    def passes(self) -> np.ndarray:
        """(e,) whether the residuals pass the test; nothing without redundancy does."""
        some = self.redundancy > 0
        return some & (self.chi2 <= chdtri(np.where(some, self.redundancy, 1), FALSE_ALARM))

    def put(self, rows: np.ndarray, others: TestedFixes, theirs: np.ndarray) -> None:
        """Take other fixes for some rows."""
        for name, mine in vars(self).items():
            mine[rows] = getattr(others, name)[theirs]

    def refuse(self, rows: np.ndarray) -> None:
        """Make some rows (e,), bool, of no fix."""
        for table in (self.llh, self.velocity, self.clocks, self.covariance, self.position, self.pdop, self.residual):
            table[rows] = np.nan


@dataclass(frozen=True)
class Verdicts:
    """Result of the outlier test."""

    excluded: np.ndarray
    """(e, s) ranges."""
    contradictory: np.ndarray
    """(e,) fixes refused because their ranges contradict each other."""
    weak: np.ndarray
    """(e,) fixes refused because their PDOP exceeds `most_pdop`."""
    implausible: np.ndarray
    """(e,) fixes refused because they are implausible."""
    unsolved: np.ndarray
    """(e,) epochs with ranges that no fix follows from."""
    untested: np.ndarray
    """(e,) fixes without a test."""
    most_pdop: float
    excluded_rates: np.ndarray
    """(e, s) range rates."""
    without_velocity: np.ndarray
    """(e,) fixes without a velocity because all range rates contradict each other."""

    def report(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Lines for all that was found; names: of the satellites."""
        out = []
        contradicting = self.excluded_rates & ~self.without_velocity[:, None]
        for excluded, what in ((self.excluded, "ranges"), (contradicting, "range rates")):
            if count := int(excluded.sum()):
                each = excluded.sum(axis=0)
                most = [i for i in np.argsort(-each, kind="stable") if each[i]]
                some = ", ".join(f"{names[i]} {each[i]}" for i in most[:_MOST_NAMES])
                more = f" and {len(most) - _MOST_NAMES} more" if len(most) > _MOST_NAMES else ""
                when = f"{count} {what} excluded at {int(excluded.any(axis=1).sum())} epochs"
                out.append(f"{when}, since they contradict the others: {some}{more}")
        for marks, text in (
            (self.contradictory, "epochs without a fix, since their ranges contradict each other"),
            (self.weak, f"epochs without a fix, since PDOP is above {self.most_pdop:g}"),
            (self.implausible, "epochs without a fix, since height, speed or distance from others is implausible"),
            (self.unsolved, "epochs without a fix, since too few ranges are above the mask, or no position fits them"),
            (self.untested, "fixes from as many ranges as unknowns, which nothing tests"),
            (self.without_velocity, "fixes without a velocity, since their range rates contradict each other"),
        ):
            if marks.any():
                out.append(f"{int(marks.sum())} {text}")
        return tuple(out)


def evaluate_fixes(
    time: np.ndarray,
    fixes: TestedFixes,
    possible: np.ndarray,
    again: Callable[[np.ndarray, np.ndarray], TestedFixes],
    rates: Callable[[TestedFixes], tuple[np.ndarray, np.ndarray]],
    most_pdop: float,
) -> Verdicts:
    """Test fixes, in place, and exclude ranges and range rates.

    - `possible` (e, s): ranges that a fix could use, visible from wherever it is.
    - `again`: computes fixes of epochs by index (k,) with ranges (k, s) alone.
    - `rates`: computes directions (e, s, 3) of satellites from the fixes, ECEF, and range rates (e, s), m/s, minus the
      effect of the satellites' motion and clocks.
    - `most_pdop`: largest PDOP of an accepted fix.
    """
    excluded = np.zeros(fixes.used.shape, dtype=bool)
    begun, several = fixes.fixed, possible.sum(axis=1) > fixes.unknowns
    # a wrong fix may put so many ranges below the mask that the others do not test it
    bare = begun & several & (fixes.redundancy <= 0)
    failed = bare | np.where(begun, (fixes.redundancy > 0) & ~fixes.passes, several)
    for some in np.array_split(np.flatnonzero(failed), failed.sum() // _EPOCHS_AT_ONCE + 1):
        _exclude(some, fixes, possible, excluded, again)
    given_up = failed & ~fixes.passes & ~bare
    excluded[given_up] = False
    fixes.refuse(given_up)
    contradictory = given_up & begun
    excluded_rates, without_velocity = _test_rates(fixes, *rates(fixes))
    with np.errstate(invalid="ignore"):
        weak = fixes.pdop > most_pdop
        speed = np.linalg.norm(fixes.velocity, axis=1)
        implausible = (fixes.llh[:, 2] < HEIGHTS[0]) | (fixes.llh[:, 2] > HEIGHTS[1]) | (speed > FASTEST)
    untested = fixes.fixed & (fixes.redundancy <= 0)
    implausible |= untested & _is_far(time, fixes.position, fixes.fixed & ~untested & ~weak & ~implausible)
    implausible &= ~weak
    fixes.refuse(weak | implausible)
    unsolved = possible.any(axis=1) & ~fixes.fixed & ~(contradictory | weak | implausible)
    return Verdicts(excluded, contradictory, weak, implausible, unsolved, untested & ~weak & ~implausible, most_pdop,
                    excluded_rates, without_velocity)  # fmt: skip


def _exclude(
    rows: np.ndarray,
    fixes: TestedFixes,
    possible: np.ndarray,
    excluded: np.ndarray,
    again: Callable[[np.ndarray, np.ndarray], TestedFixes],
) -> None:
    """Exclude one range of each epoch `rows`, or two, or more one after the other, where a fix then passes and no
    other choice does nearly as well."""
    choices: dict[int, list[tuple[int, ...]]]
    choices = {epoch: [(i,) for i in np.flatnonzero(possible[epoch]).tolist()] for epoch in rows.tolist()}
    while choices:
        epochs = np.repeat(list(choices), [len(sets) for sets in choices.values()])
        kept = possible[epochs]
        for k, out in enumerate(itertools.chain.from_iterable(choices.values())):
            kept[k, list(out)] = False
        found = again(epochs, kept)
        without = (possible[epochs] & ~kept).sum(axis=1)
        # as many wrong ranges as are excluded could still oppose as many right ones
        told = (found.redundancy >= without) & (found.pdop <= _MOST_PDOP_WITHOUT)
        chi2 = np.where(told, found.chi2, np.inf)
        passes, first, left = found.passes & told, 0, {}
        for epoch, sets in choices.items():
            order = first + np.argsort(chi2[first : first + len(sets)], kind="stable")
            ranked = [sets[k - first] for k in order]
            first += len(sets)
            if len(sets) > 1 and passes[order[0]]:
                if chi2[order[1]] - chi2[order[0]] > _DISTINCT:
                    excluded[epoch, list(ranked[0])] = True
                    fixes.put(np.array([epoch]), found, order[:1])
            elif len(sets) > 1 and np.isfinite(chi2[order[0]]) and len(ranked[0]) < _MOST_EXCLUDED:
                left[epoch] = _larger(ranked, np.flatnonzero(possible[epoch]))
        choices = left


@dataclass(frozen=True)
class _Velocities:
    """Velocities of k epochs from some range rates (k, s)."""

    velocity: np.ndarray
    """(k, 3) ECEF."""
    covariance: np.ndarray
    """(k, 4, 4) for 1 sigma of 1 m/s, the clock's drift last."""
    residual: np.ndarray
    """(k, s) m/s."""
    share: np.ndarray
    """(k, s) fraction of the variance of a rate that its residual shows."""


def _velocities(los: np.ndarray, rates: np.ndarray, used: np.ndarray) -> _Velocities:
    """Velocities by least squares from the used rates (k, s), of directions (k, s, 3)."""
    design = np.where(used[..., None], np.concatenate([-los, np.ones((*used.shape, 1))], axis=2), 0.0)
    inverse = np.linalg.pinv(np.einsum("ksi,ksj->kij", design, design))
    seen = np.where(used, rates, 0.0)
    solution = np.einsum("kij,ksj,ks->ki", inverse, design, seen)
    residual = seen - np.einsum("ksi,ki->ks", design, solution)
    share = 1.0 - np.einsum("ksi,kij,ksj->ks", design, inverse, design)
    return _Velocities(solution[:, :3], inverse, residual, share)


def _gains(found: _Velocities, used: np.ndarray) -> np.ndarray:
    """By how much the sum of squared residuals falls without each rate (k, s), m2/s2."""
    square, shown = found.residual**2, used & (found.share > 1e-6)
    return np.divide(square, found.share, out=np.zeros_like(square), where=shown)


def _scatter(found: _Velocities, used: np.ndarray) -> float:
    """1 sigma of rates by the median of their residuals, m/s."""
    shown = used & (found.share > 0.1)
    scaled = np.abs(found.residual[shown]) / np.sqrt(found.share[shown])
    return 1.4826 * float(np.median(scaled)) if scaled.size else 0.0


def _test_rates(fixes: TestedFixes, los: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Test the range rates of fixes, whose velocity is put right in place: rates (e, s) that are excluded, fixes (e,)
    whose velocity is not given. los, rates: as of `evaluate_fixes`.

    The rate whose residual is largest in its sigma is excluded, one after the other, until the rest agree. No other
    choice may do nearly as well in the end, and as many must be left to test the rest as are excluded.
    """
    used = fixes.used & fixes.fixed[:, None] & np.isfinite(rates) & np.isfinite(los).all(axis=2)
    excluded, refused = np.zeros(used.shape, dtype=bool), np.zeros(fixes.fixed.shape, dtype=bool)
    rows = np.flatnonzero(used.sum(axis=1) > _UNKNOWN_RATES)
    if not rows.size:
        return excluded, refused
    first = _velocities(los[rows], rates[rows], used[rows])
    rest = used[rows].copy()
    rest[np.arange(rows.size), np.argmax(_gains(first, rest), axis=1)] = False
    many = rest.sum(axis=1) > _UNKNOWN_RATES + 1
    without = _velocities(los[rows[many]], rates[rows[many]], rest[many])
    sigma = _scatter(first, used[rows])
    if many.any():  # where one rate of most epochs is wrong, it shows in all residuals
        sigma = min(sigma, _WORST_APART * _scatter(without, rest[many]))
    sigma = max(RATE_SIGMA, sigma)
    limits = chdtri(np.maximum(used.sum(axis=1) - _UNKNOWN_RATES, 1), FALSE_ALARM)
    bad = rows[np.sum(first.residual**2, axis=1) / sigma**2 > limits[rows]]
    for row in bad.tolist():
        kept = used[row].copy()
        while True:
            found = _velocities(los[row : row + 1], rates[row : row + 1], kept[None])
            out, spare = int(np.sum(used[row] & ~kept)), int(kept.sum()) - _UNKNOWN_RATES
            chi2 = float(np.sum(found.residual**2)) / sigma**2
            if spare >= out and spare > 0 and chi2 <= chdtri(spare, FALSE_ALARM):
                excluded[row] = used[row] & ~kept
                axes = ned_matrix(fixes.llh[row])
                fixes.velocity[row] = axes @ found.velocity[0]
                fixes.covariance[row, 3:, 3:] = RATE_SIGMA**2 * axes @ found.covariance[0, :3, :3] @ axes.T
                break
            gain = _gains(found, kept[None])[0] / sigma**2
            best = np.argsort(gain)[::-1]
            passes = chi2 - gain[best[0]] <= chdtri(max(spare - 1, 1), FALSE_ALARM)
            if spare < out + 2 or out == _MOST_EXCLUDED or (passes and gain[best[0]] - gain[best[1]] < _DISTINCT):
                excluded[row], refused[row] = used[row], True
                fixes.velocity[row] = np.nan
                fixes.covariance[row, 3:, :] = fixes.covariance[row, :, 3:] = np.nan
                break
            kept[best[0]] = False
    return excluded, refused


def _larger(ranked: list[tuple[int, ...]], there: np.ndarray) -> list[tuple[int, ...]]:
    """Choices of one range more: after single ones all pairs of the best, and of the very best with any other; later
    the best choice and any other."""
    if len(ranked[0]) == 1:
        order = [i for (i,) in ranked]
        return sorted(
            {(min(pair), max(pair)) for pair in itertools.combinations(order[:_PAIRED], 2)}
            | {(min(i, j), max(i, j)) for i in order[:_VERY_BEST] for j in order if i != j}
        )
    return [(*ranked[0], i) for i in there.tolist() if i not in ranked[0]]


def _is_far(time: np.ndarray, position: np.ndarray, tested: np.ndarray) -> np.ndarray:
    """(e,) whether fixes lie farther from the tested ones before or after than anything flies."""
    good = np.flatnonzero(tested)
    far = np.zeros(time.size, dtype=bool)
    if not good.size:
        return far
    after = np.searchsorted(good, np.arange(time.size))
    for neighbour in (good[np.clip(after - 1, 0, good.size - 1)], good[np.clip(after, 0, good.size - 1)]):
        away = np.linalg.norm(position - position[neighbour], axis=1)
        far |= away > FASTEST * np.abs(time - time[neighbour]) + _SCATTER
    return far
