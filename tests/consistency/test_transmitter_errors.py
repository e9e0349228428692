"""Errors of pseudolites as states of the filter: consistent, and as the covariance analysis says."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing import study
from navsim.landing.result import result
from navsim.landing.study import covariance_analysis, fly_all
from navsim.report.summary_tables import summary_table
from navsim.results.result import Result
from navsim.runner.executor import threads
from tests.helpers import case, in_brief

BRIEF = (
    "duration_s=20", "receiver.rate_hz=2", "imu.rate_hz=20", "pseudolites.frame=runway", "sky.source=nominal-gps",
    "pseudolites.clock=gps", "filter.kind=eskf",
)  # fmt: skip
FREE = (
    "pseudolites.survey_sigma_m=0.5", "pseudolites.clock_sigma_ns=15", "pseudolites.clock_drift_sigma_ppb=5",
    "pseudolites.clock_noise={oscillator: tcxo}", "pseudolites.clock_age_s=3", "pseudolites.range_bias_sigma_m=0.5",
)  # fmt: skip


def computed(method: str, *settings: str) -> Result:
    flown = case(*BRIEF, f"method={method}", *settings)
    if method == "covariance":
        return study.covariance_result(flown, covariance_analysis(flown), 1)
    return result(flown, fly_all(flown, 1, 0, 2, threads(1), keep="none"), 1, keep="none")


@pytest.mark.parametrize("coupling", ["loose", "tight"])
@pytest.mark.parametrize("more", [(), ("receiver.latency_s=0.2",)], ids=["now", "late"])
def test_every_state_is_consistent(coupling: str, more: tuple[str, ...]) -> None:
    """RMS of error / sigma over 80 landings, of every state at several times; the covariance analysis has the same
    sigma as the filter, whose model is the truth."""
    flown = case(*BRIEF, *FREE, f"filter.coupling={coupling}", *more)
    analysis = covariance_analysis(flown)
    names = flown.states
    own = [i for i, name in enumerate(names) if name.startswith("transmitter_")]
    assert len(own) == 12
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    runs = list(flown.fly_runs(20, 0, 80, measured=False))
    z = np.concatenate([run.error for run in runs]) / np.concatenate([run.sigma for run in runs])
    rms = np.sqrt(np.mean(z**2, axis=0))
    assert np.all(np.abs(ratio[:, own] - 1.0) < 0.02)
    assert np.all(np.abs(rms[[0, 1, -1]][:, [*range(9), *own]] - 1.0) < 4.0 / np.sqrt(160.0))


@pytest.mark.parametrize("coupling", ["loose", "tight"])
@pytest.mark.parametrize("offset", ["0", "15"])
def test_clocks_without_noise(coupling: str, offset: str) -> None:
    """Offset and rate of a clock that nothing disturbs follow from constants: the covariance is positive definite, as
    offset and rate at age 30 s alone were not; errors are as large as both analyses say."""
    flown = case(
        *BRIEF, f"filter.coupling={coupling}", "pseudolites.clock_drift_sigma_ppb=3", "pseudolites.clock_age_s=30",
        "pseudolites.range_bias_sigma_m=1", f"pseudolites.clock_sigma_ns={offset}",
    )  # fmt: skip
    analysis = covariance_analysis(flown)
    true, assumed = (np.sqrt(np.einsum("tii->ti", p)) for p in (analysis.covariance, analysis.assumed))
    np.testing.assert_allclose(true, assumed, rtol=1e-3)
    correlation = analysis.assumed / assumed[:, :, None] / assumed[:, None]
    assert np.linalg.eigvalsh(correlation).min() > 1e-10
    runs = list(flown.fly_runs(22, 0, 64, measured=False))
    nees = np.concatenate([run.nees for run in runs])
    assert nees.mean() / flown.degrees() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("coupling", in_brief(["loose", "tight"], 0))
@pytest.mark.parametrize("kind", in_brief(["rts", "map"], 0, 1))
def test_smoothers_have_them(kind: str, coupling: str) -> None:
    """RMS of error / sigma of position and of the pseudolites' errors over 48 landings."""
    flown = case(*BRIEF[:-1], *FREE, f"filter.coupling={coupling}", f"filter.kind={kind}")
    own = [i for i, name in enumerate(flown.states) if name.startswith("transmitter_")]
    runs = list(flown.fly_runs(21, 0, 48, measured=False))
    z = np.concatenate([run.error for run in runs]) / np.concatenate([run.sigma for run in runs])
    rms = np.sqrt(np.mean(z**2, axis=0))
    assert np.all(np.abs(rms[[0, 1, -1]][:, [*range(6), *own]] - 1.0) < 4.0 / np.sqrt(96.0))


FAR_AIR = (
    "pseudolites.s_m=1000", "pseudolites.l1_m=5000",
    "pseudolites.air={correction: refractivity, truth_refractivity_n: 315, refractivity_sigma_n: 100}",
)  # fmt: skip
"""Air that delays the ranges of both pseudolites by 0.5 m, 1 sigma."""


@pytest.mark.parametrize("coupling", ["loose", "tight"])
@pytest.mark.parametrize("beside", [(), FREE], ids=["air", "all"])
def test_refractivity_is_one_state_of_all(coupling: str, beside: tuple[str, ...]) -> None:
    """RMS of error / sigma over 200 landings, and the analysis, whose budget has the air."""
    flown = case(*BRIEF, *FAR_AIR, *beside, f"filter.coupling={coupling}")
    assert [name for name in flown.states if "refractivity" in name] == ["transmitter_refractivity"]
    own = [i for i, name in enumerate(flown.states) if name.startswith("transmitter_")]
    analysis = covariance_analysis(flown)
    assert analysis.variance[analysis.sources.index("pseudolite_air"), -1, 2] > 0.0
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)
    runs = list(flown.fly_runs(42, 0, 200, measured=False))
    z = np.concatenate([run.error for run in runs]) / np.concatenate([run.sigma for run in runs])
    rms = np.sqrt(np.mean(z**2, axis=0))
    assert np.all(np.abs(rms[[1, -1]][:, [*range(9), *own]] - 1.0) < 4.0 / np.sqrt(400.0))


def test_refractivity_without_a_state_is_an_error_beyond_sigma() -> None:
    """The receiver's correction is 15 N-units off on average, which the state takes up; without one, errors exceed
    sigma, as analysis and runs say alike."""
    off = "pseudolites.air.truth_refractivity_n=330"
    followed, ignored = (
        case(*BRIEF, *FAR_AIR, off, f"filter.fix_errors={how}", "filter.coupling=tight") for how in ("states", "none")
    )
    analysis = covariance_analysis(ignored)
    error = np.concatenate([run.error for run in ignored.fly_runs(43, 0, 200, measured=False)])[:, -1, 2]
    true = np.sqrt(analysis.covariance[-1, 2, 2] + analysis.mean[-1, 2] ** 2)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(true, rel=0.2)
    assert true > 1.05 * np.sqrt(analysis.assumed[-1, 2, 2])
    k = list(followed.states).index("transmitter_refractivity")
    assert covariance_analysis(followed).mean[0, k] == pytest.approx(15.0)
    drawn = np.concatenate([run.error for run in followed.fly_runs(44, 0, 200, measured=False)])[:, 0, k]
    assert np.mean(drawn) == pytest.approx(15.0, abs=3.0 * 100.0 / np.sqrt(200.0))


CLOCKS = {
    **{f"{ppb} ppb": (f"pseudolites.clock_drift_sigma_ppb={ppb}",) for ppb in (0, 0.1, 1, 3, 10)},
    "constant": ("pseudolites.survey_sigma_m=0.5", "pseudolites.clock_sigma_ns=15"),
    "assumed": ("pseudolites.clock_drift_sigma_ppb=1", "filter.pseudolites.clock_drift_sigma_ppb=2"),
    "inflated": ("pseudolites.clock_drift_sigma_ppb=1", "filter.fix_errors=inflate"),
}


@pytest.fixture(scope="module")
def alone() -> tuple[np.ndarray, ...]:
    """Accuracy by satellites alone."""
    return accuracy("pseudolites.count=0")


def accuracy(*settings: str) -> tuple[np.ndarray, ...]:
    """True RMS of position north, east, down, m, of the flight, and of its last 10 s."""
    flown = case("duration_s=60", "receiver.rate_hz=2", "imu.rate_hz=20", "filter.kind=eskf", *settings)
    square = np.einsum("tii->ti", covariance_analysis(flown).covariance)[:, :3]
    return np.sqrt(square.mean(axis=0)), np.sqrt(square[flown.shared.filter_time > 50.0].mean(axis=0))


@pytest.mark.parametrize("of", CLOCKS)
def test_a_pseudolite_never_spoils_a_fix(of: str, alone: tuple[np.ndarray, ...]) -> None:
    """A loosely coupled filter is as accurate as without pseudolites, whatever their clocks do, and better with useful
    ones. It was worse: 2.0 m instead of 0.8 m vertically with constant errors, 1.5 m with 1 ppb."""
    flight, end = accuracy(*CLOCKS[of])
    for mine, without in zip((flight, end), alone, strict=True):
        assert np.all(mine < 1.003 * without)
    assert flight[2] < 0.99 * alone[0][2]


@pytest.mark.parametrize("method", ["covariance", "monte-carlo"])
def test_what_geometry_cannot_tell_apart(method: str) -> None:
    """A range shows the sum of the clock's offset and the position along the line of sight: at 50 m and 45 m each, to
    some metres. The table names the pair; a clock alone is known."""
    brief = ("filter.coupling=tight", "pseudolites.clock_sigma_ns=150", "pseudolites.count=1")
    both, clock = (computed(method, *brief, f"pseudolites.survey_sigma_m={size}") for size in (50, 0))
    pair = "clock of PL1, position of PL1 along the line of sight"
    assert both["/summary/consistency/pair"].tolist() == [pair]
    assert both["/summary/consistency/pair_correlation"] < -0.99
    (row,) = (row for row in summary_table([("x", both)]).rows if "cannot tell apart" in str(row.cells[0]))
    assert row.texts()[1].startswith(pair)
    assert not clock["/summary/consistency/pair"].size
    biased = computed(method, *brief, "pseudolites.range_bias_sigma_m=50")
    assert biased["/summary/consistency/pair"].tolist() == ["range bias of PL1, clock of PL1"]
    assert "/summary/consistency/pair" not in computed(method).variables


@pytest.mark.long
@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_two_thousand_landings(coupling: str) -> None:
    """Every state is consistent at all times over 2000 landings with the default filter, and the covariance analysis
    is within 8 %."""
    flown = case(*BRIEF[:-1], *FREE, f"filter.coupling={coupling}")
    analysis = covariance_analysis(flown)
    square, normalised = np.zeros((2, *flown.shared.filter_time.shape, len(flown.states)))
    for run in flown.fly_runs(778899, 0, 2000, measured=False):
        square += np.sum(run.error**2, axis=0)
        normalised += np.sum((run.error / run.sigma) ** 2, axis=0)
    z, true = np.sqrt(normalised / 2000.0), np.sqrt(np.einsum("tii->ti", analysis.covariance))
    assert z.min() > 0.93
    assert z.max() < 1.07
    np.testing.assert_allclose(np.sqrt(square / 2000.0), true, rtol=0.08)
