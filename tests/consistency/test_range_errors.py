"""What errors ranges have, by what the receiver and its monitor believe of them: counts of fresh runs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from navsim.core.lanes import WIDTH
from navsim.estimation.estimate import in_all_lanes
from navsim.simulation import landing as simulation
from navsim.simulation.monitoring import ALARM, QUIET
from navsim.study.landing import Case
from tests.helpers import case

BRIEF = ("duration_s=20", "receiver.rate_hz=2", "filter.kind=eskf")


def ranges_of(c: Case, seed: int, runs: int) -> np.ndarray:
    """Pseudoranges of runs (run, e, s), m."""
    return np.stack([simulation.measured(c.world, seed, run)[0] for run in range(runs)])


def range_errors(c: Case, seed: int, runs: int) -> np.ndarray:
    """What is drawn of them by its believed sigma (run, e, s), of sources that are received throughout."""
    used = c.world.signals.used.all(axis=0)
    errors = (ranges_of(c, seed, runs) - simulation.without_noise(c.world)[0]) / c.world.signals.fix_sigma
    return np.asarray(errors[..., used])


def watched(c: Case, ranges: np.ndarray) -> simulation.Watched:
    """What the monitor says of the fixes from ranges (run, e, s), as many runs as there are lanes."""
    lanes = np.ascontiguousarray(np.moveaxis(ranges, 0, -1))
    rates = in_all_lanes(simulation.without_noise(c.world)[1])
    llh, _, clocks, _ = simulation.receiver_fixes(c.world, lanes, rates)
    return simulation.Watched.of(c.flight, lanes, llh, clocks)


def alarms(c: Case, seed: int, runs: int) -> tuple[int, int]:
    """Alarms of the fixes of runs, and how many are tested."""
    found = [watched(c, part) for part in np.split(ranges_of(c, seed, runs), runs // WIDTH)]
    status = np.concatenate([one.status for one in found])
    return int((status == ALARM).sum()), int((status >= QUIET).sum())


def within_99(count: int, of: int, share: float) -> bool:
    """Whether a count is where 99 % of binomial ones are."""
    low, high = stats.binom.ppf([0.005, 0.995], of, share)
    return bool(low <= count <= high)


CORRECTED = (
    "sky.source=nominal", "signals.range_sigma_m=0.3", "signals.range_law=constant", "pseudolites.range_sigma_m=0.3",
    "pseudolites.differential.sigma_m=0.5", "signals.ephemeris.clock_sigma_m=1.0",
)  # fmt: skip
"""Two systems and two pseudolites, corrections whose noise is more than that of the ranges."""


def test_corrected_ranges_err_independently() -> None:
    """The station's noise is of each correction by itself, so R is diagonal: between satellites of one clock, across
    clocks and towards pseudolites. A part that all corrections share would correlate them by 0.7."""
    c = case(*BRIEF, *CORRECTED)
    errors = range_errors(c, 20261, 400)
    flat = errors.reshape(-1, errors.shape[2])
    sigma = c.world.signals.fix_sigma[0, c.world.signals.used.all(axis=0)]
    assert set(np.round(sigma, 9)) == {round(np.hypot(0.3, 0.5), 9), 0.3}
    low, high = stats.chi2.ppf([0.005 / flat.shape[1], 1 - 0.005 / flat.shape[1]], len(flat))
    assert (((flat**2).sum(axis=0) > low) & ((flat**2).sum(axis=0) < high)).all()
    correlation = np.corrcoef(flat.T)[np.triu_indices(flat.shape[1], 1)]
    assert correlation.size > 100
    assert np.abs(correlation).max() * np.sqrt(len(flat)) < stats.norm.isf(0.005 / correlation.size / 2)


@pytest.mark.parametrize("method", ["{method: chi2, p_fa: 1.0e-2}", "{p_constellation: 1.0e-9, p_fa_v: 1.0e-2}"])
def test_corrected_ranges_raise_no_more_alarms(method: str) -> None:
    """With R diagonal: as often as allowed by the residuals' square, no more often by separations."""
    c = case(*BRIEF, *CORRECTED, f"integrity={method}")
    count, tested = alarms(c, 20262, 400)
    assert tested == 400 * c.world.signals.time.size
    if "chi2" in method:
        assert within_99(count, tested, 1e-2)
    else:
        assert 0 < count <= stats.binom.ppf(0.995, tested, 1e-2 + 9e-8)
