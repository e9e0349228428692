"""Where steady flight ends: alarms give back what was left out, weak gusts cost nothing, outages are honest."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.filter import error_parametrisation, estimate
from navsim.filter.measurement_kinds import Measurements
from navsim.filter.records import (
    STEADY_AGE,
    STEADY_COUNT,
    STEADY_IS,
    STEADY_ROUGHNESS,
    STEADY_SLOPE,
    FilterModel,
    ImuData,
    State,
    Truth,
    empty_error_history,
)
from navsim.filter.states import PHI_D
from navsim.geodesy.attitude import dcm_from_quaternion
from navsim.landing.case import Case
from navsim.landing.study import fly_all
from navsim.runner.executor import threads
from navsim.simulation.flight import initial_estimate, initial_state, with_clock
from navsim.simulation.measurement_tables import measurements, table_of_all_fixes, table_of_ranges
from navsim.simulation.measurements import receiver_fixes
from navsim.simulation.run_inputs import draw_inputs
from tests.helpers import case, in_brief

SEED = 3821
"""A seed by which nothing was chosen."""


class Batch:
    """`WIDTH` runs that are ready to fly: what is measured, and the filter's start."""

    def __init__(self, flown: Case, first: int = 0) -> None:
        self.flight = flight = flown.flight
        self.inputs = draw_inputs(flight, SEED, range(first, first + WIDTH))

    @property
    def tables(self) -> Measurements:
        flight, inputs = self.flight, self.inputs
        if flight.design.tight:
            return measurements(flight, table_of_ranges(flight, inputs.ranges, inputs.rates), ())
        llh, velocity, _, covariance = receiver_fixes(flight.shared, inputs.ranges, inputs.rates)
        return measurements(flight, table_of_all_fixes(flight, llh, velocity, covariance), ())

    @property
    def state(self) -> State:
        flight, inputs = self.flight, self.inputs
        nav = with_clock(flight, initial_estimate(flight, inputs.initial), inputs.clock)
        return initial_state(flight, nav, estimate.in_all_lanes(flight.covariance))

    @property
    def imu(self) -> ImuData:
        return ImuData(self.flight.shared.imu_time, self.inputs.dtheta, self.inputs.dv)

    def pieces(self, state: State, model: FilterModel) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Navigation and covariance at each output; the filter may be changed between them."""
        pieces = estimate.fly_in_pieces(self.imu, self.tables, self.flight.events, state, model)
        for _, _, history in pieces:
            yield history.navigation.copy(), history.covariance.copy()


BRIEF = ("duration_s=16", "imu.rate_hz=20")


def flown_with_alarms(batch: Batch, model: FilterModel, alarms: bool) -> tuple[np.ndarray, np.ndarray, int]:
    """Navigation and covariance at the outputs, and how often flight was found steady. alarms: as soon as it is, the
    velocity leaves the line by 100 m/s before the next fix."""
    state, found, out = batch.state, 0, []
    for piece in batch.pieces(state, model):
        out.append(piece)
        found += int((state.steady[STEADY_IS] > 0.5).sum())
        if alarms:
            # an old line and no gusts: steady flight begins after each fix that confirms the velocity
            state.steady[STEADY_AGE], state.steady[STEADY_COUNT], state.steady[STEADY_ROUGHNESS] = 1e3, 1e3, 1.0
            state.steady[STEADY_SLOPE : STEADY_SLOPE + 3] = 1e3
    return (*(np.concatenate(parts) for parts in zip(*out, strict=True)), found)


@pytest.mark.parametrize(
    ("kind", "coupling"),
    [("eskf", "loose"), ("gaussian-sum", "tight"),
     *(pytest.param(*other, marks=pytest.mark.long)
       for other in [("left-invariant", "loose"), ("tfg", "loose"), ("gaussian-sum", "loose"), ("eskf", "tight")])],
)  # fmt: skip
def test_an_alarm_at_every_fix_is_a_filter_without_the_rule(
    kind: str, coupling: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, in the chart of positions and velocities that the rule asks for."""
    monkeypatch.setattr(estimate, "_PIECE", 1)
    batch = Batch(case(*BRIEF, f"filter.kind={kind}", f"filter.coupling={coupling}"))
    model = batch.flight.model
    assert model.steady_force
    alarmed = flown_with_alarms(batch, model, True)
    free = flown_with_alarms(batch, model, False)
    chart = error_parametrisation.chart_of(model)
    monkeypatch.setattr(estimate, "chart_of", lambda _: chart)
    without = flown_with_alarms(batch, model._replace(steady_force=False), False)
    assert free[2] > 100
    assert not alarmed[2]
    assert not without[2]
    for mine, usual, ruled in zip(alarmed[:2], without[:2], free[:2], strict=True):
        np.testing.assert_array_equal(mine, usual)
        assert not np.array_equal(ruled, usual)


def gusty(time: np.ndarray, strength: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """How far gusts take `WIDTH` aircraft from their route, m, and how much faster, m/s (t, 3, W): accelerations of
    this strength, m/s2, that last for 1 s, which the aircraft recovers from within 5 s."""
    step, rng = time[1], np.random.default_rng([77, seed])
    faster = np.zeros((time.size, 3, WIDTH))
    push = strength * rng.standard_normal((3, WIDTH))
    for k in range(time.size - 1):
        faster[k + 1] = faster[k] * (1.0 - step / 5.0) + push * step
        push = push * (1.0 - step) + strength * np.sqrt(2.0 * step) * rng.standard_normal((3, WIDTH))
    return np.concatenate([np.zeros((1, 3, WIDTH)), step * np.cumsum(0.5 * (faster[1:] + faster[:-1]), axis=0)]), faster


def shaken(kind: str, steady: bool, gusts: float, runs: int) -> tuple[float, float]:
    """Heading in `landing.yaml` at 59 s, shaken by `gusty` air: RMS of the error, deg, and of error / sigma."""
    flown = case("duration_s=59", f"filter.kind={kind}", f"filter.steady_force={str(steady).lower()}")
    found = []
    for first in range(0, runs, WIDTH):
        batch = Batch(flown, first)
        flight, inputs, world = batch.flight, batch.inputs, flown.shared
        moved, faster = gusty(world.imu_time, gusts, first)
        to_level = dcm_from_quaternion(world.truth.quaternion[:-1])
        inputs.dv[...] += np.einsum("kji,kjw->kiw", to_level, np.diff(faster, axis=0))
        at_fix, at_output = (np.searchsorted(world.imu_time, t - 1e-6) for t in (world.signals.time, world.filter_time))
        metre = 1.0 / np.array([[6.38e6], [6.38e6 * np.cos(world.truth.llh[0, 0])], [-1.0]])
        tables, route = batch.tables, world.at_filter
        tables.fixes.llh[...] += metre * moved[at_fix]
        tables.fixes.velocity[...] += faster[at_fix]
        llh, velocity, quaternion = (
            estimate.in_all_lanes(m) for m in (route.llh, route.velocity_ned, route.quaternion)
        )
        truth = Truth(llh + metre * moved[at_output], velocity + faster[at_output], quaternion, inputs.sensors)
        account = empty_error_history(truth, flight.model.states, flight.events.time.size, WIDTH)
        estimate.run_filter(batch.imu, tables, flight.events, batch.state, flight.model, account)
        found.append([account.errors.error[-1, PHI_D], account.sigma[-1, PHI_D]])
    error, sigma = np.concatenate(found, axis=1)
    return float(np.degrees(np.sqrt(np.mean(error**2)))), float(np.sqrt(np.mean((error / sigma) ** 2)))


def compared(kind: str, gusts: float, runs: int) -> tuple[float, float]:
    """RMS and z of heading with the rule, in those without it."""
    without, with_it = (shaken(kind, steady, gusts, runs) for steady in (False, True))
    return with_it[0] / without[0], with_it[1] / without[1]


def test_gusts_that_show_heading_are_used() -> None:
    rms, z = compared("eskf", 0.03, 64)
    assert rms < 1.03
    assert z < 1.03


@pytest.mark.long
@pytest.mark.parametrize("kind", ["eskf", "gaussian-sum"])
def test_gusts(kind: str) -> None:
    """Weaker ones are hardly seen beside the noise: some of what they tell is given up, but sigma says so."""
    rms, z = compared(kind, 0.03, 400)
    assert rms < 1.03
    assert z < 1.03
    rms, z = compared(kind, 0.01, 400)
    assert rms < 1.08
    assert z < 1.0


class Hole:
    """A straight glide of 120 s whose sources are silent from 40 s on: z of heading at 39.9 s, half-way through the
    hole, at its end, and 1, 10 and 19 s after it."""

    def __init__(self, kind: str, coupling: str, length: float, runs: int, steady: bool = True) -> None:
        settings = ("approach.start_height_m=340", "duration_s=120", f"filter.kind={kind}",
                    f"filter.coupling={coupling}", f"filter.steady_force={str(steady).lower()}")  # fmt: skip
        names = case(*settings).shared.signals.names
        silence = {"what": "silence", "sources": list(names), "at_s": 40.0, "until_s": 40.0 + length}
        flown = case(*settings, f"events={json.dumps([silence])}")
        ensemble = fly_all(flown, SEED, 0, runs, threads(), keep="errors")
        times = 40.0 + np.array([-0.1, 0.5 * length, length - 0.1, length + 1.0, length + 10.0, length + 19.0])
        at = np.searchsorted(flown.shared.filter_time, times - 1e-6)
        error, sigma = (np.asarray(ensemble[name])[:, at, PHI_D] for name in ("error", "sigma"))
        self.z = np.sqrt(((error / sigma) ** 2).mean(axis=0))
        self.band = 0.07 + 2.5 * np.sqrt(0.5 / runs)


@pytest.mark.parametrize("coupling", in_brief(["loose", "tight"], 0))
def test_heading_is_true_before_in_and_after_an_outage(coupling: str) -> None:
    hole = Hole("gaussian-sum", coupling, 60.0, 48)
    assert np.all(np.abs(hole.z - 1.0) < hole.band), hole.z


@pytest.mark.long
@pytest.mark.parametrize("coupling", ["loose", "tight"])
@pytest.mark.parametrize("length", [20.0, 60.0])
def test_outages(coupling: str, length: float) -> None:
    """A sum is true all along; one Gaussian is truer than without the rule."""
    hole = Hole("gaussian-sum", coupling, length, 200)
    assert np.all(np.abs(hole.z - 1.0) < hole.band), hole.z
    ruled, usual = (Hole("eskf", coupling, length, 200, steady) for steady in (True, False))
    assert np.all(ruled.z < usual.z), (ruled.z, usual.z)
