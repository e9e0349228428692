"""Atmosphere, messages, corrections, time scales and smoothing in a landing: each does what it says, and no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.gnss import atmosphere, timescales
from navsim.gnss.correction_link import CorrectionLink
from navsim.gnss.signals import build_signals
from navsim.landing import study as landing
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.simulation import landing as simulation
from navsim.simulation.measurements import measured
from navsim.statistics.random_streams import generator
from tests.helpers import case, scenario

BASE = ("sky.source=nominal", "receiver.rate_hz=1", "pseudolites.count=1")
QUIET = ("signals.range_sigma_m=1e-6", "signals.range_rate_sigma_m_s=1e-6", "pseudolites.range_sigma_m=1e-6")


def fix_errors(c: landing.Case, run: int = 0) -> np.ndarray:
    """Errors of the fixes of a run, NED m."""
    from navsim.geodesy.earth import ecef_from_llh, ned_matrix

    flown = c.fly(1, run)
    truth = c.shared.signals.antenna
    llh = flown.fix_llh
    return np.einsum("nij,nj->ni", ned_matrix(llh), ecef_from_llh(llh) - truth)


def test_the_ideal_world_is_untouched() -> None:
    plain = case(*BASE).shared.signals
    assert not plain.range_bias.any()
    assert plain.source_errors is None
    assert plain.smoothing is None
    np.testing.assert_array_equal(plain.fix_sigma, plain.sigma)
    assert plain.used.any()


def test_ionosphere_leaves_its_share() -> None:
    """Half of Klobuchar's delay is left of 1.5 times it; GLONASS sees it by the square of the frequencies."""
    iono = "signals.ionosphere={truth_scale: 1.5}"
    s = case(*BASE, iono).shared.signals
    raw = case(*BASE, "signals.ionosphere={truth_scale: 1.5, corrected: false}").shared.signals
    seen = s.used & (np.array([n[0] for n in s.names]) != "P")
    np.testing.assert_allclose(raw.range_bias[seen], 3.0 * s.range_bias[seen], rtol=1e-9)
    assert np.all(s.range_bias[seen] > 0.5)
    assert s.range_bias[:, -1] == pytest.approx(0.0)
    section = scenario(*BASE, iono).signals.ionosphere
    assert section is not None
    first = np.flatnonzero(seen[0])[0]
    llh = case(*BASE).shared.at_filter.llh[1]
    model = atmosphere.klobuchar(
        np.array(section.alpha), np.array(section.beta), float(timescales.gps_from_utc(1536840001.0)), llh,
        s.azimuth[0, first], s.elevation[0, first],
    )  # fmt: skip
    ratio2 = (atmosphere.L1 / (1602e6 + 0.5625e6 * 1)) ** 2
    assert s.names[first] == "R01"
    assert s.range_bias[0, first] == pytest.approx(0.5 * model * ratio2, rel=1e-6)


def test_troposphere_is_taken_off() -> None:
    used = case(*BASE).shared.signals.used
    none, saastamoinen, mops = (
        case(*BASE, f"signals.troposphere={{truth_scale: 1.0, correction: {c}}}").shared.signals.range_bias[used]
        for c in ("none", "saastamoinen", "mops")
    )
    assert none.max() > 8.0
    assert np.abs(saastamoinen).max() < 0.06 * none.max()
    assert np.abs(mops).max() < 1e-12


def test_messages_are_drawn_a_run_and_stay() -> None:
    """The scatter over runs of each satellite's ranges is that of orbit and clock; within a run it hardly moves."""
    messages = "signals.ephemeris={orbit_sigma_m: [1.0, 2.0, 1.5], clock_sigma_m: 1.0}"
    c = case(*BASE, *QUIET, messages, "imu.rate_hz=20", "filter.kind=eskf")
    s = c.shared.signals
    assert s.source_errors is not None
    flown = [simulation.fly(c.flight, 1, range(first, first + WIDTH)) for first in range(0, 200, WIDTH)]
    drawn = np.concatenate([run.pseudorange for run in flown]) - s.range - c.shared.clock[:, 0, None]
    seen = s.used[0] & s.used[-1]
    ground = np.array([n.startswith("PL") for n in s.names])
    assert np.abs(drawn[:, :, ground]).max() < 1e-3
    sky = seen & ~ground
    sigma = np.sqrt(np.sum(s.source_errors[0] ** 2, axis=1))
    np.testing.assert_allclose(drawn[:, 0, sky].std(axis=0), sigma[sky], rtol=0.2)
    # radial counts most from far away, the clock fully
    assert np.all((sigma[sky] > 1.3) & (sigma[sky] < 2.0))
    assert np.abs(drawn[:, -1, sky] - drawn[:, 0, sky]).max() < 0.5


def test_differential_corrections_remove_what_is_common() -> None:
    errors = (
        "signals.ephemeris={}", "signals.ionosphere={}", "signals.troposphere={truth_scale: 1.05}",
    )  # fmt: skip
    alone = fix_errors(case(*BASE, *QUIET, *errors))
    corrected = fix_errors(case(*BASE, *QUIET, *errors, "pseudolites.differential={latency_s: 1, sigma_m: 1e-6}"))
    late = fix_errors(case(*BASE, *QUIET, *errors, "pseudolites.differential={latency_s: 60, sigma_m: 1e-6}"))
    size = [np.sqrt(np.mean(np.sum(e**2, axis=1))) for e in (alone, corrected, late)]
    assert size[1] < 0.1 * size[0]
    assert size[1] < size[2] < size[0]
    noisy = case(*BASE, "pseudolites.differential={sigma_m: 1.0}").shared.signals
    plain = case(*BASE).shared.signals
    sky = np.array([not n.startswith("PL") for n in plain.names])
    np.testing.assert_allclose(noisy.sigma[:, sky] ** 2, plain.sigma[:, sky] ** 2 + 1.0)
    np.testing.assert_array_equal(noisy.sigma[:, ~sky], plain.sigma[:, ~sky])


def test_corrections_come_over_a_link() -> None:
    """They end with the last pseudolite that sends them, and grow old until then; ranges then have their whole errors,
    those of a scenario without corrections, and the others those of a station of that latency."""
    errors = ("signals.ephemeris={}", "signals.ionosphere={}", "signals.troposphere={correction: none}")
    silence = "events=[{what: silence, sources: [PL1], at_s: 20}, {what: silence, sources: [PL2], at_s: 25}]"
    base = (*BASE, *errors, silence, "duration_s=60", "receiver.rate_hz=2", "pseudolites.count=2")
    linked = case(*base, "pseudolites.differential={latency_s: 1, link: {max_age_s: 10.5}}")
    signals = linked.shared.signals
    age, time = signals.correction_age, signals.time
    assert age is not None
    # the message of 23 s comes at 24 s, the last one
    expected = np.where(time < 25.0, 1.0 + (time - 1.0) % 1.0, time - 23.0)
    np.testing.assert_allclose(age, np.where(expected > 10.5, np.inf, expected), atol=1e-9)
    bare = case(*base).shared.signals
    dead = np.isinf(age)
    for name in ("range_bias", "sigma", "fix_sigma", "source_errors", "used"):
        np.testing.assert_array_equal(getattr(signals, name)[dead], getattr(bare, name)[dead])
    for late in (1.0, 1.5):
        station = case(*base, f"pseudolites.differential={{latency_s: {late}}}").shared.signals
        same = np.abs(age - late) < 1e-9
        assert same.sum() >= 20
        for name in ("range_bias", "sigma", "source_errors"):
            np.testing.assert_allclose(getattr(signals, name)[same], getattr(station, name)[same], atol=1e-9)
    assert any(f"{dead.sum()} of {age.size} fixes have no corrections" in text for text in linked.warnings)
    (told,) = [text for text in case(*base, "pseudolites.differential={}").warnings if "add `link" in text]
    assert f"at {(time >= 25.0).sum()} of {age.size} fixes" in told
    only = case(*base, "pseudolites.differential={link: {senders: [PL1]}}").shared.signals.correction_age
    assert only is not None
    assert int(np.isinf(only).sum()) > 0
    assert only[time > 20.0].min() > 1.9


def test_messages_of_corrections_are_lost_at_their_rate() -> None:
    """The share of messages; the pattern does not depend on the rate of fixes."""
    link = CorrectionLink(("PL1",), interval=0.5, oldest=5.0, loss=0.3)
    time = np.arange(0.0, 2000.0, 0.25)

    def of(time: np.ndarray, received: bool) -> np.ndarray:
        messages = link.messages(time, np.full(time.size, received), 0.1)
        return messages.ages(time, link.lost_on_route(messages))

    ages = of(time, True)
    arrived = np.diff(np.round((time - ages) / 0.5)) > 0.0
    assert arrived.sum() / 4000.0 == pytest.approx(0.7, abs=0.03)
    np.testing.assert_allclose(of(time[::4], True), ages[::4], atol=1e-9)
    assert np.all(np.isinf(of(time, False)))


def test_each_run_loses_messages_of_its_own() -> None:
    """Its ranges are those of a station whose corrections are always as old as the run's at the epoch, or of none."""
    errors = ("signals.ephemeris={orbit_sigma_m: [0, 0, 0]}", "signals.ionosphere={}", "signals.troposphere={}")
    base = (*BASE, *errors, "duration_s=90")
    link = "link: {rate_hz: 0.05, max_age_s: 50, loss: 0.5}"
    lossy = case(*base, f"pseudolites.differential={{latency_s: 1, {link}}}")
    losses, time = lossy.shared.signals.losses, lossy.shared.signals.time
    assert losses is not None
    assert "link.loss is above 0" in lossy.why_not_linear
    analysed = case(*base, f"pseudolites.differential={{latency_s: 1, {link}}}", "method=covariance")
    assert any("one example of lost messages" in text for text in analysed.warnings)
    assert not any("one example" in text for text in lossy.warnings)
    rows = [losses.drawn(generator(7, run, "corrections")) for run in range(400)]
    assert np.mean([row[-1] == losses.messages.newest[-1] for row in rows]) == pytest.approx(0.5, abs=0.08)
    ages = [np.where(row < 0, np.inf, time - 20.0 * losses.messages.numbers[row]) for row in rows[:8]]
    for late in (8.0, 45.0, np.inf):
        station = case(*base, *(() if np.isinf(late) else (f"pseudolites.differential={{latency_s: {late}}}",))).shared
        seen, count = lossy.shared.signals.used & station.signals.used, 0
        for run, age in enumerate(ages):
            there = seen & (age == late)[:, None]
            count += there.sum()
            for mine, expected in zip(measured(lossy.shared, 7, run), measured(station, 7, run), strict=True):
                np.testing.assert_allclose(mine[there], expected[there], rtol=0.0, atol=1e-6)
        assert count > 50


def test_a_satellite_below_the_stations_horizon_is_not_used() -> None:
    """It has no correction: it is left out, rather than used without one; all numbers of those used are finite."""
    c = case(*BASE, "signals.troposphere={}", "pseudolites.differential={latency_s: 1}")
    effects = c.environment.effects
    assert effects.reference is not None
    far = replace(effects.reference, llh=effects.reference.llh + np.radians([0.0, 120.0, 0.0]))
    motion, utc = c.trajectory.motion(c.shared.signals.time), c.scenario.epoch.timestamp()
    s = build_signals(motion, utc, replace(c.environment, effects=replace(effects, reference=far)))
    lost = c.shared.signals.used & ~s.used
    assert 0.1 < lost.sum() / c.shared.signals.used.sum() < 0.9
    assert np.all(np.isnan(s.los[lost]))
    assert not s.unfinished()


@pytest.mark.parametrize("more", [(), ("signals.ephemeris={}",), ("signals.ionosphere={}",)])
def test_a_satellite_that_the_station_knows_nothing_of_is_not_used(more: tuple[str, ...]) -> None:
    """Its message begins between the time of the corrections and that of the fix: there is no correction for it."""
    c = case(*BASE, "pseudolites.differential={latency_s: 30}", "duration_s=20", *more)
    utc = c.scenario.epoch.timestamp()
    begins = float(timescales.gps_from_utc(utc))

    class Late:
        def __init__(self, constellation: Any) -> None:
            self.constellation = constellation

        def __getattr__(self, name: str) -> Any:
            return getattr(self.constellation, name)

        def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            position, velocity = self.constellation.state(gpst)
            early = np.broadcast_to(gpst[:, None] if gpst.ndim == 1 else gpst, position.shape[:2]) < begins
            position[early], velocity[early] = np.nan, np.nan
            return position, velocity

    glonass, gps = c.environment.satellites
    late = replace(c.environment, satellites=(replace(glonass, constellation=Late(glonass.constellation)), gps))
    s = build_signals(c.trajectory.motion(c.shared.signals.time), utc, late)
    is_glonass = np.array([n.startswith("R") for n in s.names])
    assert c.shared.signals.used[:, is_glonass].any()
    assert not s.used[:, is_glonass].any()
    np.testing.assert_array_equal(s.used[:, ~is_glonass], c.shared.signals.used[:, ~is_glonass])


def test_signals_without_epochs_are_whole() -> None:
    """A flight shorter than a fix interval: warned of, not refused."""
    c = case(*BASE, "duration_s=0.5")
    assert c.shared.signals.used.shape[0] == 0
    said = landing.findings(c, landing.fly_all(c, 1, 0, 1, threads(1)))[-1].text
    assert "duration_s, 0.5 s, is shorter than one fix interval, 1 s" in said


def test_a_latency_longer_than_the_flight_is_called_so() -> None:
    c = case(*BASE, "duration_s=3", "receiver.latency_s=4")
    said = landing.findings(c, landing.fly_all(c, 1, 0, 1, threads(1)))[-1].text
    assert said.startswith("receiver.latency_s: 4 s after the first fix (1 s) is not within duration_s, 3 s")


def test_corrections_of_listed_directions() -> None:
    """Sources in fixed directions are corrected too; what stays is the height between aircraft and station."""
    sky = (
        "sky={source: directions, directions: "
        + str(
            [{"azimuth_deg": a, "elevation_deg": e} for a, e in ((10, 30), (100, 50), (190, 20), (250, 70), (320, 40))]
        ).replace("'", "")
        + "}"
    )
    air = ("signals.troposphere={correction: none}", "signals.ionosphere={corrected: false}", "signals.ephemeris={}")
    alone = case(sky, "pseudolites.count=1", *air).shared.signals
    corrected = case(sky, "pseudolites.count=1", *air, "pseudolites.differential={latency_s: 0}").shared.signals
    seen = alone.used & np.array([n.startswith("X") for n in alone.names])
    assert alone.range_bias[seen].min() > 3.0
    assert np.abs(corrected.range_bias[seen]).max() < 0.3
    assert corrected.source_errors is not None
    assert not corrected.source_errors.any()


def test_time_scales() -> None:
    """An offset of GPS time is the clock unknown's business, unless the receiver takes both scales for one."""
    offset = "signals.gps_offset_ns=30"
    assert np.abs(fix_errors(case(*BASE, *QUIET, offset))).max() < 1e-3
    both = case(*BASE, *QUIET, offset, "receiver.single_clock=true")
    assert np.abs(fix_errors(both)).max() > 1.0
    assert np.all(both.shared.dop[:, 0] < case(*BASE).shared.dop[:, 0])
    assert np.abs(fix_errors(case(*BASE, *QUIET, "receiver.single_clock=true"))).max() < 1e-3


def test_noise_from_signal_strength() -> None:
    s = case(*BASE, "signals.range_law=cn0").shared.signals
    sky = s.used & np.array([not n.startswith("PL") for n in s.names])
    low, high = (
        np.nanargmin(np.where(sky[0], s.elevation[0], np.nan)),
        np.nanargmax(np.where(sky[0], s.elevation[0], np.nan)),
    )
    assert s.cn0[0, low] < s.cn0[0, high] <= 45.0
    glonass, gps = (np.array([n[0] == letter for n in s.names]) & sky[0] for letter in "RG")
    assert np.median(s.sigma[0, glonass]) > 1.5 * np.median(s.sigma[0, gps])  # chips twice as long
    near = case(*BASE, "pseudolites.cn0_reference_m=1000").shared.signals
    assert near.cn0[0, -1] == pytest.approx(45.0 - 20 * np.log10(near.range[0, -1] / 1000.0), abs=0.01)


def test_ground_multipath_of_pseudolites() -> None:
    s = case(*BASE, *QUIET, "pseudolites.height_m=5", "pseudolites.multipath={}").shared.signals
    error = s.range_bias[:, -1]
    assert np.abs(error).max() > 0.02
    assert np.abs(error).max() < 5.0
    assert not s.range_bias[:, :-1].any()
    assert np.sum(np.diff(np.sign(error)) != 0) >= 1  # it beats as the aircraft comes down


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_a_filter_knows_how_large_reflections_are(coupling: str) -> None:
    """To first order: RMS of error/sigma of every state within 0.9 and 1.1 at every 10 s, where a filter that knows
    nothing of them has more (its positions 1.13); without reflections the key is refused."""
    reflected = (
        "receiver.rate_hz=2", "pseudolites.height_m=5", "pseudolites.multipath={}", f"filter.coupling={coupling}"
    )  # fmt: skip

    def z(*more: str) -> np.ndarray:
        analysis = landing.covariance_analysis(case(*reflected, *more))
        second = np.diagonal(analysis.covariance, axis1=1, axis2=2) + analysis.mean**2
        return np.sqrt(second / np.diagonal(analysis.assumed, axis1=1, axis2=2))[20::20]

    known = z()
    assert 0.9 < known.min() < known.max() < 1.1
    assert z("filter.fix_errors=none").max() > 1.1
    with pytest.raises(InputError, match="reflections are no states"):
        case(*reflected, "filter.fix_errors=states")


def test_smoothed_code() -> None:
    """Fixes get quieter, as their stated sigma says."""
    bare, smoothed = (case(*BASE, f"receiver.smoothing_s={t}", "receiver.rate_hz=2") for t in (0, 30))
    late = slice(120, None)
    rms = [np.sqrt(np.mean([fix_errors(c, run)[late] ** 2 for run in range(20)])) for c in (bare, smoothed)]
    assert rms[1] < 0.3 * rms[0]
    predicted = [
        np.sqrt(np.mean(np.trace(c.shared.fix_covariance[late], axis1=1, axis2=2)) / 3.0) for c in (bare, smoothed)
    ]
    assert rms[1] / rms[0] == pytest.approx(predicted[1] / predicted[0], rel=0.3)


@pytest.mark.parametrize(
    ("assignments", "fragment"),
    [
        (("pseudolites.count=0", "pseudolites.differential={}"), "there is none"),
        (("pseudolites.differential={site: PL7}",), "no pseudolite is named 'PL7'"),
        (("pseudolites.differential={link: {senders: [PL7]}}",), "no pseudolite is named 'PL7'"),
        (("pseudolites.differential={latency_s: 2, link: {max_age_s: 2}}",), "arrive 2 s old"),
        (("method=covariance", "filter.kind=rts"), "rts is a smoother"),
        (
            ("method=rare", "box={lateral_m: 1}", "pseudolites.differential={link: {loss: 0.1}}"),
            "do not know of lost corrections; use method monte-carlo",
        ),
        (("signals.troposphere={}", "sky.mask_deg=-1"), "above the horizon"),
        (("signals.ionosphere={alpha: [1, 2, 3]}",), "too short"),
    ],
)
def test_what_does_not_go_together(assignments: tuple[str, ...], fragment: str) -> None:
    with pytest.raises(InputError, match=fragment):
        scenario(*BASE, *assignments)


def test_files_that_the_source_leaves_out_are_told() -> None:
    assert case("sky.almanac=no_such.agl").warnings == ["sky.almanac is not used: sky.source is nominal-glonass"]
    assert not case().warnings
