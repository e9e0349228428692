"""What the covariance analysis stands on: errors carried in lanes against dense products, and the slopes of the
receiver's fixes against differences of fixes."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.error_propagation.sensitivity_propagation import LinearisedHistory, propagate_columns, propagate_covariances
from navsim.filter.states import MAX_MEASUREMENT_SIZE, SENSORS
from navsim.gnss.clock_noise import step_covariance
from navsim.simulation.along_truth import along_truth
from navsim.simulation.measurements import receiver_fixes, without_noise
from tests.helpers import case

N, SIZE = 15, 21
AHEAD = np.array([0, 0, 1, 1, 0, 0, 1], bool)
OUTPUT = np.array([0, -1, -1, 1, -1, 2, 3])
INTERVAL = np.array([-1, 0, 1, -1, 2, 3, 4])
WEIGHED = np.array([-1, 0, 1, -1, 2, -1, -1])


def a_route(rng: np.random.Generator, scales: int) -> LinearisedHistory:
    """Seven events, three of them on copies that run ahead; a sensor state of the truth for each of the filter, but for
    the last ones, which are those of a clock against so many time scales."""
    h = np.zeros((3, MAX_MEASUREMENT_SIZE, SIZE))
    h[:, :, :N] = rng.standard_normal((3, MAX_MEASUREMENT_SIZE, N)) * (rng.random((3, MAX_MEASUREMENT_SIZE, N)) < 0.3)
    same = np.hstack([np.eye(N), np.vstack([np.zeros((SENSORS, SIZE - N)), np.eye(SIZE - N)])])
    phi = np.eye(SENSORS, SIZE) + 0.3 * rng.standard_normal((5, SENSORS, SIZE))
    rest = 0.5 + 0.5 * rng.random((5, SIZE - SENSORS))
    gain = 0.2 * rng.standard_normal((3, N, MAX_MEASUREMENT_SIZE))
    clock = N - scales - 1, scales
    if scales:
        rest[:, clock[0] - SENSORS : N - SENSORS] = 1.0
    length = 0.1 + rng.random(5)
    return LinearisedHistory(
        AHEAD,
        OUTPUT,
        INTERVAL,
        WEIGHED,
        phi,
        rest,
        length,
        h[:, :, :N] @ same,
        gain,
        same,
        clock,
        np.empty(0, np.int64),
    )


def dense(route: LinearisedHistory, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Phi of an interval and I - K H of a measurement (S, S)."""
    phi, keep = np.eye(SIZE), np.eye(SIZE)
    if at < route.phi.shape[0]:
        phi[:SENSORS] = route.phi[at]
        phi[SENSORS:] *= route.rest[at][:, None]
        first, scales = route.clock
        phi[first : first + scales, first + scales] = route.length[at]
    if at < route.h.shape[0]:
        keep[:N] -= route.gain[at] @ route.h[at]
    return phi, keep


@pytest.mark.parametrize("scales", [0, 2])
def test_columns(scales: int) -> None:
    rng = np.random.default_rng(4)
    route = a_route(rng, scales)
    start, off = rng.standard_normal((SIZE, WIDTH)), rng.standard_normal((3, MAX_MEASUREMENT_SIZE, WIDTH))
    x, seen, error = (
        np.zeros((2, 1, SIZE, WIDTH)),
        np.empty((3, 1, MAX_MEASUREMENT_SIZE, WIDTH)),
        np.empty((4, 1, N, WIDTH)),
    )
    x[0, 0] = start
    propagate_columns(route, in_lanes(x), in_lanes(off[:, None].copy()), in_lanes(seen), in_lanes(error))
    own = copy = start
    for i in range(AHEAD.size):
        copy = own if AHEAD[i] and not AHEAD[i - 1] else copy
        one = copy if AHEAD[i] else own
        if INTERVAL[i] >= 0:
            one = dense(route, INTERVAL[i])[0] @ one
        if OUTPUT[i] >= 0:
            np.testing.assert_allclose(error[OUTPUT[i], 0], route.to_error @ one, atol=1e-12)
        if (w := WEIGHED[i]) >= 0:
            np.testing.assert_allclose(seen[w, 0], route.h[w] @ one + off[w], atol=1e-12)
            one = dense(route, w)[1] @ one
            one[:N] -= route.gain[w] @ off[w]
        own, copy = (own, one) if AHEAD[i] else (one, copy)


@pytest.mark.parametrize("scales", [0, 2])
def test_covariances(scales: int) -> None:
    """Each lane by itself, and what they add up to."""
    rng = np.random.default_rng(5)
    route = a_route(rng, scales)

    def positive(*shape: int) -> np.ndarray:
        root = rng.standard_normal(shape)
        return root @ np.swapaxes(root, -1, -2)

    start = np.stack([positive(SIZE, SIZE) for _ in range(WIDTH)], axis=-1)
    noise = np.stack([positive(3, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE) for _ in range(WIDTH)], axis=-1)
    added, density = positive(5, 4, 15, 15), np.zeros((6, WIDTH))
    density[1, 0], density[3, 2], density[4, 1], density[5, 1:3] = 0.7, 0.4, 0.2, 0.9
    place = np.append(np.arange(SENSORS), np.arange(N, SIZE))
    p, variance = np.zeros((2, SIZE, SIZE, WIDTH)), np.empty((4, N, WIDTH))
    p[0] = start
    second, sums = np.zeros((3, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)), np.zeros((4, N, N))
    propagate_covariances(
        route, added, place, in_lanes(density), in_lanes(p), in_lanes(noise), in_lanes(variance), second, sums
    )
    own = copy = np.moveaxis(start, -1, 0)
    r = np.moveaxis(noise, -1, 0)
    for i in range(AHEAD.size):
        copy = own if AHEAD[i] and not AHEAD[i - 1] else copy
        one = copy if AHEAD[i] else own
        if (at := INTERVAL[i]) >= 0:
            phi = dense(route, at)[0]
            one = phi @ one @ phi.T
            one[:, place[:, None], place] += np.einsum("kl,kij->lij", density[:4], added[at])
            if scales:
                bias, both, drift = step_covariance(density[4:], route.length[at])
                first = route.clock[0]
                one[:, first : first + 2, first : first + 2] += bias[:, None, None]
                one[:, first : first + 2, first + 2] += both[:, None]
                one[:, first + 2, first : first + 2] += both[:, None]
                one[:, first + 2, first + 2] += drift
        if (o := OUTPUT[i]) >= 0:
            error = route.to_error @ one @ route.to_error.T
            np.testing.assert_allclose(variance[o].T, np.diagonal(error, axis1=1, axis2=2), rtol=1e-12)
            np.testing.assert_allclose(sums[o], error.sum(axis=0), atol=1e-12 * np.abs(sums[o]).max())
        if (w := WEIGHED[i]) >= 0:
            h, gain, keep = route.h[w], np.zeros((SIZE, MAX_MEASUREMENT_SIZE)), dense(route, w)[1]
            gain[:N] = route.gain[w]
            expected = (h @ one @ h.T + r[:, w]).sum(axis=0)
            np.testing.assert_allclose(second[w], expected, atol=1e-12 * np.abs(expected).max())
            one = keep @ one @ keep.T + gain @ r[:, w] @ gain.T
        own, copy = (own, one) if AHEAD[i] else (one, copy)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("pseudolites.survey_error_m=[15, -10, 3]", "pseudolites.clock_offset_ns=30"),
        ("sky.source=nominal", "pseudolites.clock=own"),
        ("sky.mask_deg=60", "pseudolites.count=0"),
    ],
    ids=["as shipped", "large residuals", "three clocks", "no fix"],
)
def test_slopes_of_fixes(settings: tuple[str, ...]) -> None:
    """Within 1e-6 of the largest, where a difference of fixes 0.1 m apart is rounded to 1e-7."""
    flight = case("duration_s=62", "receiver.rate_hz=1", *settings).flight
    world, along = flight.shared, along_truth(flight)
    step = 0.05
    for part, slopes in enumerate((along.by_range, along.by_rate)):
        within = 1e-6 * np.abs(slopes).max()
        for source in range(0, slopes.shape[2], 3):
            moved = []
            for sign in (1.0, -1.0):
                measured = without_noise(world)
                measured[part][:, source] += sign * step
                moved.append(receiver_fixes(world, *measured))
            (llh, velocity, *_), (before, velocity_before, *_) = moved
            fixed = np.isfinite(llh[:, 0]) & world.signals.used[:, source]
            metres = (llh - before)[:, :2] * np.array([6.40e6, 6.39e6 * np.cos(np.radians(56.0))])
            slope = np.hstack([-(llh - before)[:, 2:], velocity - velocity_before]) / (2.0 * step)
            np.testing.assert_allclose(slopes[fixed, 2:, source], slope[fixed], atol=within)
            # radii of curvature to a few thousandths
            np.testing.assert_allclose(
                slopes[fixed, :2, source], metres[fixed] / (2.0 * step), rtol=5e-3, atol=1e2 * within
            )
            assert not slopes[~fixed, :, source].any()
