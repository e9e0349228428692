"""The monitor's filter without a ground station against a Kalman filter in numpy that is never given the station."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.filter.measurement_kinds import FIX
from navsim.filter.records import OUTPUT
from navsim.simulation.along_truth import along_truth, noise_densities
from navsim.simulation.measurements import filter_fixes, without_noise
from tests.conftest import Within
from tests.helpers import case


@pytest.mark.validates("Estimate without an excluded ground station, and its sigma", "Kalman filter in numpy",
                       estimate="1e-9 m", sigma="1e-9 (relative)")  # fmt: skip
def test_filter_without_a_station(within: Within) -> None:
    """Any measurements of the errors, drawn: the estimate of the filter that has all, plus the difference that the
    monitor propagates from that filter's innovations, is the estimate of the other. The numpy filter shares transition
    matrices and derivatives of measurements; noise, gains and covariances are its own."""
    flown = case(
        "imu.rate_hz=20", "receiver.rate_hz=1", "duration_s=8", "wind={}", "events=[]", "elevation_station.bends_deg=0",
        "azimuth_station.bends_m=0", "integrity={method: filter, p_satellite: 0, p_constellation: 0}",
        name="landing_ils",
    )  # fmt: skip
    flight: Any = flown.flight
    bank, along = flight.bank, along_truth(flight)
    lin, steps, events, density = along.lin, along.steps, flight.events, noise_densities(flight)
    of_fixes = filter_fixes(flown.shared, *without_noise(flown.shared))[3]
    noise = {aid.sensor.kind: aid.sensor.noise**2 * np.eye(1) for aid in flown.shared.aids}
    drawn = np.random.default_rng(3).normal(0.0, 1.0, lin.z.shape)

    def estimates(without: int | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (o, 3), their sigmas, and innovations (k, MOST), without a kind of measurement."""
        x, p, seen = np.zeros(len(flight.covariance)), flight.covariance, np.full((events.time.size, 6), np.nan)
        places, sigmas = [], []
        for k, kind in enumerate(events.kind):
            if (at := steps.interval[k]) >= 0:
                x, p = lin.transition[at] @ x, lin.transition[at] @ p @ lin.transition[at].T
                p[:15, :15] += np.einsum("a,aij->ij", density, lin.added[at])
            w = steps.measurement[k]
            if kind == OUTPUT:
                places.append(x[:3])
                sigmas.append(np.sqrt(np.diag(p)[:3]))
            elif kind != without and (rows := np.flatnonzero(lin.have[w] > 0.0)).size:
                h, r = lin.h[w, rows], of_fixes[events.row[k]] if kind == FIX else noise[kind]
                seen[k, rows] = drawn[w, rows] - h @ x
                gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
                x, p = x + gain @ seen[k, rows], p - gain @ h @ p
        return np.array(places), np.array(sigmas), seen

    whole, _, innovations = estimates(None)
    given = np.repeat(innovations[..., None], WIDTH, axis=2), None, None, None
    shared_fixes = replace(bank, fix=np.full_like(bank.fix, -1))
    for k, (fault, aid) in enumerate(zip(flight.expected, flown.shared.aids, strict=True)):
        assert fault.sources == (aid.sensor.name,)
        other, sigmas, _ = estimates(aid.sensor.kind)
        held = bank.found.spread.separate_sigma[k][:, [1, 0, 2]]
        np.testing.assert_allclose(held, sigmas[1:], rtol=within["sigma"])
        apart = np.abs(other - whole)[1:]
        for axis in range(3):
            scale = np.zeros_like(bank.scale)
            scale[1:, k, axis] = 1.0
            found = replace(shared_fixes, scale=scale).statistic(*given)[:, 0]
            np.testing.assert_allclose(found, apart[:, axis], rtol=0.0, atol=within["estimate"])
        assert apart.max() > 0.01
