"""Kernels in this process, compiled before they are timed: the filter, DOPs, the analysis, the tracking filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from c_step import lines_of_c
from dense import dense_filter
from measure import SCENARIO, STEPS, Curve, Job, Line, Plan, alternate, ratios, seconds, timed

from navsim.compiler.lanes import WIDTH
from navsim.filter import states, strapdown
from navsim.filter.estimate import in_all_lanes, run_filter
from navsim.filter.measurement_kinds import FIX, Measurements
from navsim.filter.records import ESKF, TFG, ImuData, Truth, empty_error_history, start
from navsim.landing.study import Case, prepare
from navsim.scenario.load import read
from navsim.simulation.flight import exact_start
from navsim.simulation.measurement_tables import table_of_fixes

RIVAL_SECONDS = (12.0, 2.0)
"""Length of flight given to the slowest rival, s, in full and in brief; its time per step does not depend on it."""

MORE_STATES = (
    *states.SCALE_FACTORS,
    states.Block("gyro_markov", "rad/s", states.GYROS, decay=0.01, drive=1e-10),
    states.Block("accelerometer_markov", "m/s2", states.ACCELEROMETERS, decay=0.01, drive=1e-6),
)
"""Sensor states beside the biases, in the order in which a filter of 21 states, and one of 27, follows them. Scenarios
offer no 27: that one is handed to the filter's loop as any declared states are."""
VARIANCES = (1e-6, 1e-6, 1e-8, 1e-4)
"""Of each of them at the start."""


@dataclass(frozen=True)
class Flight:
    """A landing as the filter gets it, 1 Hz fixes, W runs at once."""

    case: Case

    def filter(self, kind: int = ESKF, more: int = 0) -> Job:
        """So many runs at once as there are lanes, with so many blocks of further states."""
        case, world, flight = self.case, self.case.shared, self.case.flight
        run = case.fly(1, 0)
        cov = np.tile(np.diag([16.0, 16.0, 200.0, 0.04, 0.04, 0.04]), (run.fix_llh.shape[0], 1, 1))
        table = table_of_fixes(case.design, run.fix_llh, run.fix_velocity, cov)
        measured = Measurements.of({FIX: table}).each(in_all_lanes)
        imu = ImuData(world.imu_time, in_all_lanes(world.dtheta), in_all_lanes(world.dv))
        blocks = (*case.design.sensors.blocks, *MORE_STATES[:more])
        n = states.SENSORS + 3 * len(blocks)
        begin = np.diag(np.repeat(VARIANCES[:more], 3)) if more else np.empty((0, 0))
        covariance = np.zeros((n, n))
        covariance[: states.N_BASE, : states.N_BASE] = flight.covariance[: states.N_BASE, : states.N_BASE]
        covariance[states.N_BASE :, states.N_BASE :] = begin
        model = flight.model._replace(
            kind=kind,
            gate=np.full(states.MAX_MEASUREMENT_SIZE + 1, np.inf),
            max_rejected=0,
            declared=states.declared(blocks),
        )
        nav = exact_start(world.at_filter)

        at = world.at_filter
        sensors = np.zeros((at.time.size, n - states.SENSORS, WIDTH))
        truth = Truth(at.llh, at.velocity_ned, at.quaternion, sensors)
        account = empty_error_history(truth, n, flight.events.time.size, WIDTH)

        def once() -> None:
            run_filter(imu, measured, flight.events, start(in_all_lanes(nav), in_all_lanes(covariance)), model, account)

        return timed(once)


def landing(*settings: str) -> Case:
    """The main scenario with keys set, ready to be flown."""
    return prepare(*read(SCENARIO, settings))


def warmed(*jobs: Job) -> tuple[Job, ...]:
    """Jobs done once, so that they are compiled."""
    for job in jobs:
        job()
    return jobs


def each(taken: list[float]) -> list[float]:
    """Seconds of one run of those at once."""
    return [s / WIDTH for s in taken]


def filters(plan: Plan) -> list[Line]:
    """The filter's step against the dense kernel, against pyins, against C."""
    case = landing("receiver.rate_hz=1")
    world, declared, flight = case.shared, case.flight.model.declared, Flight(case)
    dt, begin = world.imu_time[1], exact_start(world.at_filter)
    ends = np.empty((2, states.NAV_N))

    def alone() -> None:
        strapdown.navigate(begin.copy(), declared, world.dtheta, world.dv, dt, STEPS, ends)

    def dense() -> None:
        dense_filter(begin.copy(), declared, world.dtheta, world.dv, dt, np.eye(15), np.eye(15) * 1e-9, 100)

    eskf, tfg, without, thick = warmed(flight.filter(), flight.filter(TFG), timed(alone), timed(dense))
    many, group, one = alternate(plan.rounds(15), eskf, tfg, thick)
    step = seconds("filter", each(many), STEPS)
    at_once = f"{WIDTH} runs at once, 1 Hz fixes"
    return [
        Line(
            f"filter step with covariance (`eskf`, {at_once}) against the dense kernel",
            ratios(one, each(many)),
            f"{step}, {seconds('dense', one, STEPS, ' a step')}",
            8.0,
            15.0,
        ),
        Line("`tfg` against `eskf`", ratios(group, many), seconds("tfg", each(group), STEPS, " a step"), 1.4,
             at_most=True),
        *_pyins(plan, world, eskf, without),
        *lines_of_c(plan, case.flight),
    ]  # fmt: skip


def _pyins(plan: Plan, world: Any, eskf: Job, without: Job) -> list[Line]:
    """pyins on the same increments."""
    try:
        import pandas as pd
        from pyins import filters, inertial_sensor, measurements, strapdown
    except ImportError:
        return [Line("against pyins", (), "pyins is not installed")]
    dt, truth = float(world.imu_time[1]), world.truth
    increments = pd.DataFrame(
        np.concatenate([np.full((STEPS, 1), dt), world.dtheta, world.dv], axis=1),
        index=pd.Index(world.imu_time[1:], name="time"),
        columns=["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"],
    )
    values = np.concatenate(
        [np.degrees(truth.llh[:, :2]), truth.llh[:, 2:], truth.velocity_ned, np.degrees(truth.rpy)], axis=1
    )
    columns = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    trajectory = pd.DataFrame(values, index=pd.Index(world.imu_time, name="time"), columns=columns)

    def free() -> None:
        strapdown.Integrator(trajectory.iloc[0]).integrate(increments)

    (free_job,) = warmed(timed(free))
    theirs, ours = alternate(plan.rounds(9), free_job, without)
    beside = f"{seconds('navsim', ours, STEPS)}, {seconds('pyins', theirs, STEPS, ' a step')}"
    lines = [Line("strapdown alone, one run, against pyins", ratios(theirs, ours), beside, 5.0, 10.0)]
    gyro = inertial_sensor.EstimationModel(bias_sd=1e-3, noise=1e-5)
    accel = inertial_sensor.EstimationModel(bias_sd=1e-2, noise=1e-2)
    n = int(RIVAL_SECONDS[plan.quick] / dt)
    part, at = increments.iloc[:n], trajectory.iloc[100 : n + 1 : 100]
    sources = [
        measurements.Position(at[["lat", "lon", "alt"]], 4.0),
        measurements.NedVelocity(at[["VN", "VE", "VD"]], 0.2),
    ]
    for label, step, must, aim in (
        ("every step", dt, 20_000.0, 45_000.0),
        ("every 0.1 s, its default", 0.1, 500.0, 1500.0),
        ("every 1 s", 1.0, None, None),
    ):

        def feedback(step: float = step) -> None:
            filters.run_feedback_filter(
                trajectory.iloc[0], 10.0, 1.0, 5.0, 5.0, part, gyro, accel, measurements=sources, time_step=step
            )

        theirs, ours = alternate(plan.rounds(3), timed(feedback), eskf)
        by_step = ratios([s / n for s in theirs], [s / STEPS for s in each(ours)])
        beside = f"{seconds('navsim', each(ours), STEPS)}, {seconds('pyins', theirs, n, ' a step')}"
        lines.append(Line(f"the same filter step against pyins, its covariance {label}", by_step, beside, must, aim))
    return lines


def by_states(plan: Plan) -> tuple[list[Line], Curve]:
    """The filter by the number of its states."""
    flight = Flight(landing("receiver.rate_hz=1"))
    blocks = {15: 0, 21: 2, 27: 4}
    took = alternate(plan.rounds(9), *warmed(*(flight.filter(more=more) for more in blocks.values())))
    curve = Curve("states of the filter", "", dict(zip(blocks, map(each, took), strict=True)), "step",
                  dict.fromkeys(blocks, STEPS))  # fmt: skip
    beside = ", ".join(seconds(f"{n}:", taken, STEPS) for n, taken in curve.seconds.items())
    return [Line("27 states against 15", curve.against_first(27), f"{beside} a step", 4.0, 3.0, at_most=True)], curve


def placements(plan: Plan) -> list[Line]:
    """DOPs of 200 x 200 placements of two pseudolites at 121 epochs, 12 sources: 4.84 million solutions."""
    from navsim.environment.sources import environment
    from navsim.optimization.placement import RunwayPlane
    from navsim.simulation.placement_geometry import glide_geometry

    scenario, document = read(SCENARIO, ["pseudolites.frame=runway", "pseudolites.count=0", "sky.mask_deg=0"])
    sources, scenario, _ = environment(scenario, document)
    trajectory = scenario.trajectory()
    epochs = np.linspace(0.0, 60.0, 121)
    here = glide_geometry(trajectory, sources, np.array([scenario.epoch.timestamp()]), epochs, np.ones(121, dtype=bool))
    plane = RunwayPlane(scenario.threshold(trajectory.frame), 0.0, 0.0)
    s, l1 = np.meshgrid(np.linspace(50.0, 2000.0, 200), np.linspace(0.0, 5000.0, 200), indexing="ij")
    pairs = np.stack([np.stack([s, l1], axis=-1), np.stack([-s, l1], axis=-1)], axis=-2).reshape(-1, 2, 2)
    sites = plane.ecef(pairs)
    sky = np.random.default_rng(1).standard_normal((121, 10, 3))
    sky /= np.linalg.norm(sky, axis=2)[:, :, None]
    part = sites[:: len(sites) // 400][:400]
    lines = part[:, None] - here.receiver[None, :, None]
    lines /= np.linalg.norm(lines, axis=3)[..., None]
    units = np.concatenate([np.broadcast_to(sky, (len(part), *sky.shape)), lines], axis=2)

    def numpy_on_part() -> None:
        h = np.concatenate([-units, np.ones((*units.shape[:3], 1))], axis=3)
        q = np.linalg.inv(np.swapaxes(h, 2, 3) @ h)
        np.sqrt(np.trace(q[..., :3, :3], axis1=2, axis2=3))
        np.sqrt(q[..., 2, 2])

    jobs = warmed(timed(lambda: here.dops(sites)), timed(lambda: here.dops(sites, 2)), timed(numpy_on_part))
    one, both, taken = alternate(plan.rounds(9), *jobs)
    theirs = [t * len(sites) / len(part) for t in taken]
    numpy_ = seconds("numpy", theirs)
    what = "4.84 million DOP solutions against numpy (H, H'H, inverse)"
    return [
        Line(f"{what}, one thread", ratios(theirs, one), f"{seconds('navsim', one)}, {numpy_}", 100.0, 140.0),
        Line(f"{what}, both cores", ratios(theirs, both), f"{seconds('navsim', both)}, {numpy_}", 180.0, 280.0),
    ]


def analysis(plan: Plan) -> list[Line]:
    """Linear covariance analysis against runs of the same landing."""
    from navsim.landing.study import covariance_analysis, fly_all
    from navsim.runner.executor import threads

    case, count = landing("receiver.rate_hz=1"), plan.size(2000, 64)
    (linear,) = warmed(timed(lambda: covariance_analysis(case)))
    flown, direct = alternate(plan.rounds(1), timed(lambda: fly_all(case, 1, 0, count, threads(), keep="none")), linear)
    beside = f"{seconds('analysis', direct)}, {seconds('runs', flown)}"
    return [Line(f"{count} runs against a covariance analysis with budget, 1 Hz fixes", ratios(flown, direct), beside)]


def tracking(plan: Plan) -> list[Line]:
    """The 13-state tracking filter against its six decoupled groups, per scan."""
    from navsim.companions.atc.filter import ADAPT, FULL, MEASURED, N, track
    from navsim.companions.atc.scenario import Atc
    from navsim.companions.atc.study import settings, truth
    from navsim.companions.circuit import at, fly

    scenario = Atc(kind="atc-tracking", version=1)
    case = settings(scenario, 1.0, False)
    time_ = np.arange(407.0)
    true = truth(at(fly(scenario.circuit.circuit()), time_))
    noise = np.random.default_rng(1).standard_normal((time_.size, MEASURED)) * np.sqrt(case.variance)
    measured = true[:, [0, 3, 5, 7, 9, 11, 4, 6, 8]] + noise
    error, deviation = np.empty((time_.size, N)), np.empty((time_.size, N))

    def job(kind: int) -> Callable[[], None]:
        return lambda: track(
            kind, 1.0, measured, case.variance, False, 0.0, case.decay, case.rate_variance, 0.3,
            np.array([5.0, 2.0]), true, error, deviation,
        )  # fmt: skip

    full, groups = alternate(plan.rounds(15), *warmed(*(timed(job(kind)) for kind in (FULL, ADAPT))))
    beside = f"{seconds('full', full, time_.size)}, {seconds('groups', groups, time_.size, ' a scan')}"
    return [Line("ATC filter of 13 states against its six groups (31 by count)", ratios(full, groups), beside)]
