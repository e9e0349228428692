"""Covariance of the filter against the Cramer-Rao bound: the inverse of prior and Fisher information, by numpy alone.

Inertial sensors are exact and the initial velocity is known, so the error of position is a constant, like all errors of
transmitters and beacons here, but for gravity that falls with height: 0.06 % in 20 s. The information of a constant is
a sum over measurements, whatever the filter does.
"""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing.case import Case
from navsim.landing.study import covariance_analysis
from tests.conftest import Within
from tests.helpers import case

EXACT = (
    "duration_s=20", "receiver.rate_hz=2", "imu.rate_hz=20", "filter.kind=eskf", "filter.velocity=false",
    "imu.gyro={drift_deg_h: 0, noise_deg_h: 0}", "imu.accelerometer={bias_mg: 0, noise_mg: 0}",
    "initial_errors={attitude_deg: 1e-6, position_m: 10, velocity_m_s: 1e-6}",
    "receiver.clock={h0: 0, h_minus2: 0}", "sky.source=nominal-gps", "pseudolites.clock=gps",
    "pseudolites.frame=runway",
)  # fmt: skip
CONSTANT = (
    "pseudolites.survey_sigma_m=0.5", "pseudolites.clock_sigma_ns=15", "pseudolites.clock_drift_sigma_ppb=5",
    "pseudolites.clock_age_s=3", "pseudolites.range_bias_sigma_m=0.5",
)  # fmt: skip
BIAS, GROWN, GROWTH, SPREAD, SURVEY, NOISE = 0.3, 300.0, 0.4, 0.2, 0.2, 0.1
BEACONS = (
    "beacons={rate_hz: 10, range_limit_m: 5000, sites: [{s_m: 120, l1_m: 300, height_m: 10}, {s_m: -120, l1_m: 300}, "
    "{s_m: 150, l1_m: -400}], "
    f"sigma_m: {NOISE}, bias_sigma_m: {BIAS}, growth_m: {GROWTH}, growth_sigma_m: {SPREAD}, "
    f"growth_distance_m: {GROWN}, survey_sigma_m: {SURVEY}}}"
)
NS = 0.299792458
"""Light's way in a nanosecond, m; in a second of a clock that is off by one ppb."""


def axes(ecef: np.ndarray, lat: float, lon: float) -> np.ndarray:
    """Vectors (..., 3) along north, east, down."""
    a, b, c, d = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return ecef @ np.array([[-a * d, -a * c, b], [-c, d, 0.0], [-b * d, -b * c, -a]]).T


def of_ranges(flown: Case, tight: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fisher information of position, receiver clock and errors of pseudolites by all pseudoranges; prior sigmas; which
    unknowns are compared.

    In fixes each epoch has its own receiver clock, and pseudolites have no errors that last.
    """
    s, ground = flown.shared.signals, flown.pseudolites.names
    q = 6 if tight else 0
    information = np.zeros((5 + q * len(ground),) * 2)
    llh = flown.trajectory.motion(s.time).llh
    for e, time in enumerate(s.time):
        rows, weights = [], []
        for i in np.flatnonzero(s.used[e]):
            u = axes(s.position[e, i] - s.antenna[e], *llh[e, :2])
            row = np.concatenate([-u / np.linalg.norm(u), [1.0, time], np.zeros(q * len(ground))])
            if tight and s.names[i] in ground:
                k = 5 + q * ground.index(s.names[i])
                row[k : k + 3] = -row[:3]
                row[k + 3 : k + 6] = 1.0, 1.0, time + 3.0
            rows.append(row)
            weights.append(s.sigma[e, i] ** -2.0)
        h, w = np.array(rows), np.array(weights)
        if not tight:  # the clock takes the weighted mean
            h -= np.sum(w[:, None] * h, axis=0) / w.sum()
        information += h.T @ (w[:, None] * h)
    own = [0.5, 0.5, 0.5, 0.5, 15.0 * NS, 5.0 * NS][:q] * len(ground)
    return information, np.array([10.0, 10.0, 10.0, 1e4, 1e2, *own]), np.r_[0:3, 5 : len(information)]


def of_beacons(flown: Case) -> np.ndarray:
    """Fisher information of position and of five errors of each beacon."""
    (aid,) = flown.shared.aids
    beacons = aid.sensor
    count = len(beacons.names)
    out = np.zeros((3 + 5 * count,) * 2)
    llh = flown.trajectory.motion(aid.time).llh
    away, _ = beacons.away(flown.trajectory, aid.time)
    for m in range(aid.time.size):
        i = m % count
        u = axes(away[m, i], *llh[m, :2])
        distance = np.linalg.norm(u)
        left = np.exp(-distance / GROWN)
        steeper = 1.0 + GROWTH * left / GROWN
        row = np.zeros(len(out))
        row[:3] = -steeper * u / distance
        row[3 + 5 * i : 8 + 5 * i] = 1.0, 1.0 - left, *(steeper * u / distance)
        out += np.outer(row, row) / NOISE**2
    return out


@pytest.mark.validates("Covariance of position, clocks, survey errors and biases of pseudolites and beacons",
                       "Cramér-Rao bound in numpy: inverse of prior and Fisher information", "(relative)",
                       sigma="2e-3")  # fmt: skip
@pytest.mark.parametrize(
    ("coupling", "more"), [("tight", (*CONSTANT, BEACONS)), ("loose", (BEACONS,)), ("tight", CONSTANT)]
)
def test_covariance_is_the_bound(coupling: str, more: tuple[str, ...], within: Within) -> None:
    """Sigma of every state and all correlations at the end."""
    flown = case(*EXACT, "method=covariance", f"filter.coupling={coupling}", *more)
    information, prior, kept = of_ranges(flown, coupling == "tight")
    information += np.diag(prior**-2.0)
    if coupling == "loose":
        information = information[np.ix_(kept, kept)]
        kept = np.arange(3)
    n, count = len(information), 5 * 3 * (BEACONS in more)
    if count:
        whole = np.zeros((n + count,) * 2)
        whole[:n, :n] = information
        at = np.r_[0:3, n : n + count]
        whole[np.ix_(at, at)] += of_beacons(flown)
        own = np.array([BIAS, SPREAD, SURVEY, SURVEY, SURVEY] * 3)
        whole[range(n, n + count), range(n, n + count)] += own**-2.0
        information, kept = whole, np.r_[kept, n : n + count]
    bound = np.linalg.inv(information)[np.ix_(kept, kept)]

    analysis, names = covariance_analysis(flown), list(flown.states)
    mine = [0, 1, 2]
    for name in flown.pseudolites.names if coupling == "tight" else ():
        mine += [names.index(f"transmitter_position_{name}_{axis}") for axis in ("north", "east", "down")]
        mine += [names.index(f"transmitter_{error}_{name}") for error in ("range_bias", "clock", "clock_rate")]
    mine += [i for i, name in enumerate(names) if name.startswith("beacons_")]
    sigma = np.sqrt(np.diag(bound))
    for covariance in (analysis.assumed[-1], analysis.covariance[-1]):
        found = covariance[np.ix_(mine, mine)]
        own = np.sqrt(np.diag(found))
        np.testing.assert_allclose(own, sigma, rtol=within["sigma"])
        np.testing.assert_allclose(found / np.outer(own, own), bound / np.outer(sigma, sigma), atol=within["sigma"])
