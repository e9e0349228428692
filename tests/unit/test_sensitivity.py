"""Slopes of an error by all that is drawn: against flights with inputs a little off, against the covariance analysis,
and against drawn inputs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.gnss.dll import smooth, smoothed_variance, smoothing_slopes
from navsim.landing.study import Case
from navsim.simulation.along_truth import AlongTruth, along_truth
from navsim.simulation.flight import Flight
from navsim.simulation.landing import fly_inputs
from navsim.simulation.landing_covariance import analyse
from navsim.simulation.measurements import expected_measurements
from navsim.simulation.run_inputs import Inputs, draw_inputs
from navsim.simulation.sensitivity import Slopes, carried, deviations, sensitivity
from tests.helpers import case, in_brief

AT = 30.0
"""When errors are looked at, s: behind the first turn."""
NAMES = ("initial", "dtheta", "dv", "ranges", "rates", "phases", "aided")
CASES = {
    "as shipped": (),
    "altimeter": ("altimeter.sigma_m=1.0",),
    "lever arm": ("receiver.lever_arm_m=[1, 0.5, -0.7]",),
    "late fixes": ("receiver.latency_s=0.253", "receiver.rate_hz=2", "altimeter.sigma_m=1.0"),
    "smoothed": ("receiver.smoothing_s=20", "signals.ephemeris={}", "receiver.rate_hz=2"),
    "late fixes and lever arm": (
        "receiver.latency_s=0.253", "receiver.rate_hz=2", "receiver.lever_arm_m=[1, 0.5, -0.7]",
    ),
    "Markov alone": (
        "imu.gyro.drift_deg_h=0", "imu.gyro.markov_deg_h=300", "imu.gyro.markov_time_s=15", "imu.gyro.noise_deg_h=0",
        "receiver.rate_hz=1",
    ),
    "offsets": (
        "sky.source=nominal", "sky.systems=[glonass, gps, galileo]", "receiver.single_clock=true",
        "signals.system_offset_sigma_ns=10", "receiver.smoothing_s=20", "receiver.rate_hz=2",
    ),
    "errors that last": ("signals.preset=open-sky", "receiver.rate_hz=2"),
    "clocks that wander": (
        "pseudolites.clock_noise={h0: 2e-20, h_minus2: 1e-22}", "pseudolites.clock_age_s=20", "receiver.rate_hz=2",
    ),
    "free clocks": (
        "pseudolites.clock_noise={oscillator: tcxo}", "pseudolites.clock_age_s=3",
        "pseudolites.clock_drift_sigma_ppb=5", "pseudolites.clock_sigma_ns=15", "pseudolites.survey_sigma_m=0.5",
        "receiver.rate_hz=2",
    ),
    "heights whose errors last": (
        "barometric_altimeter={sigma_m: 0.5, rate_hz: 2, qnh_sigma_hpa: 0.2, drift_m: 1, drift_time_s: 20}",
        "filter.barometric_altimeter.errors=states", "runway.geoid_undulation_m=15.5", "receiver.rate_hz=2",
    ),
    "magnetic field": (
        "magnetometer={rate_hz: 2, noise_ut: 1, hard_iron_ut: 1, scale_percent: 1, disturbance_ut: 1, "
        "mounting_deg: [5, 10, 90], declination_deg: 11, dip_deg: 71, intensity_ut: 52.5}", "receiver.rate_hz=2",
        "initial_errors.attitude_deg=1",
    ),
    "few fixes": ("receiver.rate_hz=0.5",),
    "tight": ("filter.coupling=tight", "receiver.rate_hz=2", "receiver.clock={}"),
    "sensors": (
        "imu.gyro.markov_deg_h=100", "imu.gyro.markov_time_s=40", "imu.accelerometer.scale_ppm=3000",
        "imu.gyro.scale_ppm=3000", "receiver.rate_hz=2",
    ),
}  # fmt: skip


def ready(name: str) -> tuple[Case, AlongTruth, Slopes, int]:
    """A case of `CASES`, its filter along the truth, the slopes of NED position at `AT`, and the output that is."""
    flown = case("filter.kind=eskf", "duration_s=35", *CASES[name])
    along = along_truth(flown.flight)
    time = flown.shared.filter_time
    at = int(np.argmin(np.abs(time - AT)))
    weights = np.zeros((3, time.size, 3))
    weights[:, at] = np.eye(3)
    return flown, along, sensitivity(flown.flight, along, weights), at


def without_noise(flight: Flight, like: Inputs) -> Inputs:
    """Inputs where nothing is drawn."""

    def lanes(values: np.ndarray) -> np.ndarray:
        return np.repeat(values[..., None], WIDTH, axis=-1)

    ranges, rates, phases = expected_measurements(flight.shared)
    return replace(
        like, initial=np.zeros_like(like.initial), dtheta=lanes(flight.shared.dtheta), dv=lanes(flight.shared.dv),
        ranges=lanes(ranges), rates=lanes(rates), phases=None if phases is None else lanes(phases),
        aided=tuple(lanes(aid.exact) for aid in flight.shared.aids),
    )  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_flight_with_inputs_a_little_off(name: str) -> None:
    """Each kind of input by itself, a hundredth of what is drawn of it: within 3 % of the largest error it makes, or
    0.4 % of that of all inputs together: where fixes lie off the antenna by rounding or by a lever arm that turns,
    gains differ a little from those along the truth."""
    flown, _, slopes, at = ready(name)
    flight = flown.flight
    drawn = draw_inputs(flight, 5, range(WIDTH))
    exact = without_noise(flight, drawn)
    still = fly_inputs(flight, exact, WIDTH).error[:, at, :3]
    share = 0.01
    most = np.abs(slopes.times(deviations(flight, drawn))).max()
    for kind in NAMES:
        full, none = getattr(drawn, kind), getattr(exact, kind)
        if full is None or (kind == "aided" and not full):
            continue
        little = (
            tuple(b + share * (a - b) for a, b in zip(full, none, strict=True))
            if kind == "aided"
            else none + share * (full - none)
        )
        inputs = replace(exact, **{kind: little})
        found = (fly_inputs(flight, inputs, WIDTH).error[:, at, :3] - still) / share
        expected = slopes.times(deviations(flight, inputs)).T / share
        assert np.abs(found).max() > 1e-5, kind
        within = 0.03 * np.abs(found).max() + 0.004 * most
        np.testing.assert_allclose(expected, found, atol=within, rtol=0.0, err_msg=kind)


@pytest.mark.parametrize("name", CASES)
def test_the_variance_is_that_of_the_covariance_analysis(name: str) -> None:
    """Two ways through the same matrices, forward and backward; the analysis leaves out that the noise of the gyros is
    in the velocity of a lever arm."""
    flown, along, slopes, at = ready(name)
    shifts = carried(flown.flight, slopes)
    pairs = zip(slopes.members(), shifts.members(), strict=True)
    variance = sum(np.einsum("ki,ki->k", a.reshape(3, -1), b.reshape(3, -1)) for a, b in pairs)
    of_pseudolites = np.isin(flown.shared.signals.names, flown.pseudolites.names)
    expected = np.diagonal(analyse(flown.flight, of_pseudolites, along).covariance[at])[:3]
    np.testing.assert_allclose(np.sqrt(variance), np.sqrt(expected), rtol=5e-3)


@pytest.mark.parametrize("name", in_brief(["altimeter", "smoothed", "sensors", "Markov alone", "offsets"], 1))
def test_the_variance_is_that_of_drawn_inputs(name: str) -> None:
    """2000 draws: variances of the sum over each kind of input, and of all, within 4.5 sigma of the sampling; means
    too."""
    flown, _, slopes, _ = ready(name)
    kinds = [kind for kind in NAMES if getattr(slopes, kind) is not None and len(getattr(slopes, kind))]
    parts = [slopes, *(alone(slopes, kind) for kind in kinds)]
    variances = []
    for part in parts:
        pairs = zip(part.members(), carried(flown.flight, part).members(), strict=True)
        variances.append(sum(np.einsum("ki,ki->k", a.reshape(3, -1), b.reshape(3, -1)) for a, b in pairs))
    runs = 2000
    sums = np.empty((len(parts), runs, 3))
    for first in range(0, runs, WIDTH):
        off = deviations(flown.flight, draw_inputs(flown.flight, 9, range(first, first + WIDTH)))
        for part, found in zip(parts, sums, strict=True):
            found[first : first + WIDTH] = part.times(off).T
    for kind, variance, found in zip(["all", *kinds], variances, sums, strict=True):
        assert np.all(variance > 0.0), kind
        assert np.all(np.abs(found.mean(axis=0)) < 4.5 * np.sqrt(variance / runs)), kind
        assert np.all(np.abs(np.mean(found**2, axis=0) / variance - 1.0) < 4.5 * np.sqrt(2.0 / runs)), kind


def alone(slopes: Slopes, kind: str) -> Slopes:
    """The slopes by one kind of input, none by the others."""

    def none(values: Any) -> Any:
        if values is None:
            return None
        return tuple(map(np.zeros_like, values)) if isinstance(values, tuple) else np.zeros_like(values)

    return replace(slopes, **{name: none(getattr(slopes, name)) for name in NAMES if name != kind})


def test_smoothing_transposed() -> None:
    rng = np.random.default_rng(3)
    used = rng.random((40, 5)) < 0.8
    _, count = smoothed_variance(np.ones(used.shape), used, 7)
    code, carrier = (np.where(used, rng.standard_normal(used.shape), np.nan) for _ in range(2))
    slopes = np.where(used, rng.standard_normal((3, *used.shape)), 0.0)
    by_code, by_carrier = smoothing_slopes(slopes, count)
    smoothed = np.where(used, smooth(code, carrier, count), 0.0)
    direct = np.einsum("kes,es->k", slopes, smoothed)
    transposed = sum(
        np.einsum("kes,es->k", by, np.where(used, values, 0.0))
        for by, values in ((by_code, code), (by_carrier, carrier))
    )
    np.testing.assert_allclose(transposed, direct, rtol=1e-12)
