"""What errors ranges have, by what the receiver and its monitor believe of them: counts of fresh runs."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from navsim.compiler.lanes import WIDTH
from navsim.filter.estimate import in_all_lanes
from navsim.integrity.monitoring import ALARM, QUIET
from navsim.landing.ensemble import LandingStudy
from navsim.landing.study import Case
from navsim.results.result import read
from navsim.scenario_files.source import InputError
from navsim.simulation import measurements, run_inputs
from navsim.simulation.run import MonitorOutput
from navsim.statistics.random_streams import generator
from tests.helpers import SCENARIOS, case
from tests.layout import as_declared
from tests.product.test_run import navsim

BRIEF = ("duration_s=20", "receiver.rate_hz=2", "filter.kind=eskf")


def ranges_of(c: Case, seed: int, runs: int) -> np.ndarray:
    """Pseudoranges of runs (run, e, s), m."""
    return np.stack([measurements.measured(c.shared, seed, run)[0] for run in range(runs)])


def range_errors(c: Case, seed: int, runs: int) -> np.ndarray:
    """What is drawn of them by its believed sigma (run, e, s), of sources that are received throughout."""
    used = c.shared.signals.used.all(axis=0)
    errors = (ranges_of(c, seed, runs) - measurements.without_noise(c.shared)[0]) / c.shared.signals.fix_sigma
    return np.asarray(errors[..., used])


def watched(c: Case, ranges: np.ndarray) -> MonitorOutput:
    """What the monitor says of the fixes from ranges (run, e, s), as many runs as there are lanes."""
    lanes = np.ascontiguousarray(np.moveaxis(ranges, 0, -1))
    rates = in_all_lanes(measurements.without_noise(c.shared)[1])
    fixes = measurements.receiver_fixes(c.shared, lanes, rates)
    return MonitorOutput.of_fixes(c.flight, in_all_lanes(c.shared.signals.antenna), lanes, fixes)


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
    sigma = c.shared.signals.fix_sigma[0, c.shared.signals.used.all(axis=0)]
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
    assert tested == 400 * c.shared.signals.time.size
    if "chi2" in method:
        assert within_99(count, tested, 1e-2)
    else:
        assert 0 < count <= stats.binom.ppf(0.995, tested, 1e-2 + 9e-8)


HEAVIER = (
    "integrity={method: chi2, p_fa: 1.0e-2, error_model: heavy_tailed, heavy_tailed: {core: 0.9, tail: 4, share: 0.2}}"
)
CORE, TAIL, SHARE = 0.9, 4.0, 0.2


def beyond(size: float, core: np.ndarray | float = CORE, tail: np.ndarray | float = TAIL) -> float:
    """The chance that a value of the mixture is larger than this, either way: the closed form."""
    return float(2 * (1 - SHARE) * stats.norm.sf(size / core) + 2 * SHARE * stats.norm.sf(size / tail))


def test_believed_noise_is_what_it_was() -> None:
    """To the bit: the stream's normal numbers times sigma, where no other noise is asked for."""
    c = case(*BRIEF, "integrity={method: chi2, p_fa: 1.0e-2, error_model: gaussian}")
    s, run = c.shared.signals, 3
    drawn = generator(20263, run, "measurements").standard_normal((*s.range.shape, 2))
    ranges, rates = measurements.measured(c.shared, 20263, run)
    expected = s.range + s.range_bias + c.shared.clock[:, :1] + s.sigma * drawn[..., 0]
    np.testing.assert_array_equal(ranges, np.where(s.used, expected, np.nan))
    expected = s.range_rate + c.shared.clock[:, 1:] + s.rate_sigma * drawn[..., 1]
    np.testing.assert_array_equal(rates, np.where(s.used, expected, np.nan))


def test_heavier_noise_is_the_believed_one_wider_here_and_there() -> None:
    """The same normal numbers, times core or tail; range rates to the bit the same, runs independent of neighbours."""
    believed, heavier = case(*BRIEF), case(*BRIEF, HEAVIER)
    exact = measurements.without_noise(believed.shared)[0]
    used = believed.shared.signals.used
    wide = 0
    for run in range(20):
        (plain, rates), (wider, same) = (measurements.measured(c.shared, 20264, run) for c in (believed, heavier))
        np.testing.assert_array_equal(rates, same)
        ratio = ((wider - exact) / (plain - exact))[used]
        is_tail = ratio > 2.0
        sure = np.abs((plain - exact)[used]) > 0.01  # ranges have 24 000 km and 16 digits
        np.testing.assert_allclose(ratio[sure], np.where(is_tail, TAIL, CORE)[sure], rtol=1e-5)
        wide += int(is_tail.sum())
    assert within_99(wide, 20 * int(used.sum()), SHARE)
    together = run_inputs.draw_inputs(heavier.flight, 20264, [0, 1, 2]).ranges
    np.testing.assert_array_equal(together[..., 2], measurements.measured(heavier.shared, 20264, 2)[0])


def test_heavier_noise_exceeds_sizes_as_often_as_the_mixture() -> None:
    """From 1 to 10 believed sigmas, of satellites and pseudolites together, where a Gaussian has none beyond 5."""
    errors = np.abs(range_errors(case(*BRIEF, HEAVIER), 20265, 400)).ravel()
    for size in (1.0, 2.0, 3.0, 5.0, 8.0, 10.0):
        assert within_99(int((errors > size).sum()), errors.size, beyond(size)), size
    rms = np.sqrt((1 - SHARE) * CORE**2 + SHARE * TAIL**2)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(rms, rel=0.02)


def of_an_epoch(c: Case, e: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a fix, by plain matrices: what whitened ranges do to the height (n,), and to the whitened residuals (n, n)."""
    s = c.shared.signals
    use = s.used[e]
    clocks = s.time_scale[use][:, None] == np.unique(s.time_scale[use])
    rows = np.concatenate([-s.los[e, use], clocks], axis=1) / s.fix_sigma[e, use][:, None]
    gain = np.linalg.inv(rows.T @ rows) @ rows.T
    return gain[2], np.eye(len(rows)) - rows @ gain


def test_heights_and_alarms_under_heavier_noise() -> None:
    """Errors of fixes against the sum over all patterns of core and tail, alarms against the same residuals of other
    random numbers: what the monitor believes in allows 1 % of alarms, and there is one at every other epoch."""
    c, runs = case(*BRIEF, HEAVIER), 400
    found = [watched(c, part) for part in np.split(ranges_of(c, 20266, runs), runs // WIDTH)]
    error = np.concatenate([one.error[:, 1] for one in found], axis=1)
    epochs = len(error)
    rng = np.random.default_rng(20267)
    size, chance, alarm, squares, monitor = 12.0, 0.0, 0.0, 0.0, c.flight.monitor
    assert monitor is not None
    for e in range(epochs):
        height, left = of_an_epoch(c, e)
        patterns = np.array(list(itertools.product((False, True), repeat=height.size)))
        sigma = np.sqrt((np.where(patterns, TAIL, CORE) ** 2 * height**2).sum(axis=1))
        weight = SHARE ** patterns.sum(axis=1) * (1 - SHARE) ** (~patterns).sum(axis=1)
        chance += float(weight @ (2 * stats.norm.sf(size / sigma))) / epochs
        drawn = rng.standard_normal((height.size, 5000))
        drawn *= np.where(rng.random(drawn.shape) < SHARE, TAIL, CORE)
        statistic = ((left @ drawn) ** 2).sum(axis=0)
        alarm += float(np.mean(statistic > monitor.threshold[e])) / epochs
        squares += float(np.trace(left)) / epochs
    assert within_99(int((error > size).sum()), error.size, chance)
    count = sum(int((one.status == ALARM).sum()) for one in found)
    assert 0.3 < alarm < 0.7
    assert within_99(count, error.size, alarm)
    mean = np.mean([one.statistic.mean() for one in found])
    assert mean == pytest.approx(squares * ((1 - SHARE) * CORE**2 + SHARE * TAIL**2), rel=0.03)


def test_exceeded_levels_are_counted(tmp_path: Path) -> None:
    """A spoofer who puts everything 200 m higher half way: whatever has no alarm from then on is beyond its level."""
    spoofed = "events=[{what: spoof, sources: [all], offset_ned_m: [0, 0, -200], at_s: 10.2}]"
    settings = (*BRIEF, spoofed, "integrity={method: chi2, error_model: heavy_tailed}")
    keys = [part for key in settings for part in ("--set", key)]
    done = navsim(
        "run", SCENARIOS / "landing.yaml", *keys, "--runs", 30, "--figures", "none", "-o", "a.h5", cwd=tmp_path
    )
    assert "noise of ranges" in done.stdout
    assert "1 σ, 3 σ of 10 %" in done.stdout
    result = read(tmp_path / "a.h5")
    as_declared(result)
    status, late = result["/integrity/status"], result["/integrity/time"] > 10.2
    assert (status >= QUIET).all()
    over = (status[:, late] == QUIET).sum() / status.size
    assert 0.1 < over < 0.5
    assert result["/summary/integrity/exceeded_vertical"][0] == over
    assert result["/summary/integrity/exceeded_horizontal"][0] == 0.0
    quiet = case(*BRIEF, "integrity={method: chi2}")
    one = LandingStudy(quiet, 1, "none").batch(0, 8)[0]
    assert not one["integrity_exceeded"].any()


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (("method=covariance",), "use method monte-carlo"),
        (("method=rare", "box={lateral_m: 1}"), "use method monte-carlo"),
        (("integrity.tails={at_s: [5]}",), "count runs"),
        (("integrity.heavy_tailed={core: 4, tail: 2}",), "the tail is the wider"),
    ],
)
def test_what_is_of_believed_noise_alone_is_refused(settings: tuple[str, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        case(*BRIEF, "integrity={error_model: heavy_tailed}", *settings)


def test_availability_by_levels_alone_is_not_judged(tmp_path: Path) -> None:
    """Levels of a sweep by geometry are what they were; how many alarms come, runs alone tell."""
    limits = "limits: {hal_m: 100, val_m: 150, tta_s: 2}"
    verdicts = []
    for model in ("gaussian", "heavy_tailed"):
        study = tmp_path / f"{model}.yaml"
        study.write_text(
            f"kind: sweep\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\n"
            f"set: {{duration_s: 20, receiver.rate_hz: 2,\n"
            f"  integrity: {{method: chi2, error_model: {model}, {limits}}},\n"
            "  requirements: [{what: availability, at_least: 0.9}]}\n"
            "vary: [{key: pseudolites.s_m, values: [200, 400]}]\noutputs: [vpl_p95, requirements]\n"
        )
        navsim("sweep", study, "-o", f"{model}.h5", cwd=tmp_path)
        result = read(tmp_path / f"{model}.h5")
        verdicts.append((list(result["/sweep/requirement_1_verdict"]), list(result["/sweep/vpl_p95"])))
    (met, levels), (unknown, same) = verdicts
    assert levels == same
    assert met == [2, 2]
    assert unknown == [1, 1]
