"""A landing scenario turned into models, ready to be flown."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from navsim.environment.sources import touchdown_time
from navsim.filter import states
from navsim.filter.design import FilterDesign, gate_limits
from navsim.filter.estimate import FILTER_KINDS
from navsim.filter.measurement_kinds import MAGNETIC, SOURCE
from navsim.filter.states import Block
from navsim.geodesy.earth import STANDARD_GRAVITY
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.fix_states import FIXED
from navsim.gnss.interference.horizon import behind
from navsim.gnss.signals import Pseudolites, SignalScenario
from navsim.landing.beacons import BeaconGeometry, CurvedRange, beacon_geometry, neglected, second_order
from navsim.landing.coasting import Coasting, grid
from navsim.landing.faults import watching
from navsim.landing.preflight import PreflightChecks, build_environment
from navsim.results.heights import height_m
from navsim.results.schema import HEIGHTS, RMS_WINDOW
from navsim.scenario.analysable import check_analysable
from navsim.scenario.beacons import second_order_cure, second_order_refused
from navsim.scenario.estimated_errors import about_correlated_errors, about_transmitter_errors
from navsim.scenario.landing import Landing
from navsim.scenario.requirements import ErrorRequirement, singles
from navsim.scenario.signals import ClockNoise
from navsim.scenario_files.base import DEG
from navsim.scenario_files.source import Document
from navsim.sensors.beacons import Beacons
from navsim.sensors.ground_stations import GroundStation
from navsim.sensors.imu import Triad
from navsim.simulation.aiding import aids_of
from navsim.simulation.aiding import followed_errors as followed_errors_of_aids
from navsim.simulation.correlated_errors import IGNORED, STATES, as_noise, fix_blocks, followed_errors
from navsim.simulation.first_order import FirstOrder, position_covariance
from navsim.simulation.flight import Flight, InitialErrors
from navsim.simulation.flight import prepare as prepare_flight
from navsim.simulation.inertial_states import followed, gains_that_matter
from navsim.simulation.landing import fly_runs
from navsim.simulation.run import Run
from navsim.simulation.run_inputs import Pushes
from navsim.simulation.shared_truth import SharedTruth, build_shared_truth
from navsim.simulation.transmitter_errors import TransmitterBelief
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.kinematics import Moving

PERCENTILES = (50, 95, 99)
MOVING = slice(states.POS, states.ATT)
"""States of position and velocity."""
_VERTICAL_DILUTION = 2.0
"""Vertical dilution of precision of a usual sky."""
_SMALL = 2.0
"""Vertical error of the inertial navigation, in 1 sigma of a fix, below which it is small after three fixes."""
MAX_GAP_S = 2.0
"""Longest time without fixes in which errors stay of first order, s."""
MAX_CHANCE_REJECTIONS = 0.01
"""Largest expected number of good fixes that the gate rejects in a landing with first-order errors."""


@dataclass(frozen=True)
class Case:
    """A scenario turned into models, ready to be flown any number of times."""

    scenario: Landing
    trajectory: Moving
    environment: SignalScenario
    flight: Flight
    sky_warnings: list[str] = field(default_factory=list)
    second_order_of: CurvedRange | None = None
    """The range for which the filter estimates the second order although its scenario does not say so."""

    @property
    def warnings(self) -> list[str]:
        """Warnings about the input: sky, predicted geometry, near sources, sensors that never measure."""
        idle = [aid.sensor for aid in self.shared.aids if aid.time.size and aid.missing == aid.time.size]
        beyond = "whose heights or attitudes are beyond its limits"
        why = beyond, "which is outside its sector, behind terrain, or during outages"
        near = map(str, self.flight.near_passes)
        silent = (f"{s.name}: measures nothing on this flight, {why[isinstance(s, GroundStation)]}" for s in idle)
        return [*self.sky_warnings, *self.preflight.warnings, *near, *self._bent_ranges(), *silent]

    @property
    def scenario_as_given(self) -> Landing:
        """The scenario as it was given: without the second order of ranges that navsim set itself."""
        return self.scenario if self.second_order_of is None else _with_key(self.scenario, None)

    def _bent_ranges(self) -> list[str]:
        """Warning of beacons whose ranges the filter's linearisation falsifies, or that it estimates this itself."""
        if self.second_order_of is not None:
            return [self.second_order_of.followed]
        if self.scenario.filter.beacons.second_order or (curved := self.curved) is None:
            return []
        return [curved.warning(second_order_cure(self.scenario))]

    @cached_property
    def curved(self) -> CurvedRange | None:
        """The range of a beacon that is least linear in the filter's position error; None if all are linear."""
        for aid in self.shared.aids:
            if isinstance(sensor := aid.sensor, Beacons):
                found = (self._curved_with_fixes(sensor, aid.time), self._curved_without_fixes(sensor))
                return max((one for one in found if one is not None), key=lambda one: one.ratio, default=None)
        return None

    def _curved_with_fixes(self, sensor: Beacons, asked: np.ndarray) -> CurvedRange | None:
        """`curved` of the times (m,), s, at which beacons are asked and there are fixes."""
        signals, errors = self.shared.signals, self.shared.fix_errors
        epoch = np.searchsorted(signals.time, asked, side="right") - 1
        times = (epoch >= 0) & errors.fixed[epoch]
        geometry = beacon_geometry(sensor, self.trajectory, asked[times])
        of_fix = errors.of_ranges(signals.fix_sigma)[epoch[times], :3, :3]
        return CurvedRange.of(geometry, second_order(geometry, of_fix), sensor.transmitter_at(asked[times]))

    def _curved_without_fixes(self, sensor: Beacons) -> CurvedRange | None:
        """`curved` of the times at which the last fix is more than `MAX_GAP_S` old, and the filter's sigma grows."""
        time, shared = grid(self.shared), self.shared
        epochs, fixed = shared.signals.time, shared.fix_errors.fixed
        epoch = np.searchsorted(epochs, time, side="right") - 1
        alone = (epoch < 0) | ~fixed[epoch] | (time - epochs[epoch] > MAX_GAP_S)
        geometry = beacon_geometry(sensor, self.trajectory, time)
        if not geometry.received[alone].any():
            return None
        p = Coasting(shared, self.design, self.flight.initial, geometry).covariance()
        some = geometry.at(alone)
        return CurvedRange.of(some, neglected(some, p[alone]))

    @property
    def aided(self) -> bool:
        """Whether sensors beside the receiver measure something of the position: all but a magnetometer."""
        aids = self.shared.aids
        return any(aid.sensor.kind != MAGNETIC and aid.missing < aid.time.size for aid in aids)

    @cached_property
    def beacons(self) -> BeaconGeometry | None:
        """Geometry of the ranging beacons at fix epochs, None without."""
        for aid in self.shared.aids:
            if isinstance(aid.sensor, Beacons):
                return beacon_geometry(aid.sensor, self.trajectory, self.shared.signals.time)
        return None

    @property
    def without_beacons(self) -> Case | None:
        """The same flight without its beacons, None where there are none."""
        if self.beacons is None:
            return None
        scenario = self.scenario.model_copy(update={"beacons": None})
        shared = replace(self.shared, aids=tuple(a for a in self.shared.aids if a.sensor is not self.beacons.sensor))
        return case_of(scenario, self.trajectory, self.environment, shared)

    @property
    def preflight(self) -> PreflightChecks:
        """Quantities known before a run."""
        shared = self.shared
        return PreflightChecks(self.scenario, self.trajectory, self.environment, shared.signals, shared.filter_time)

    def behind_terrain(self) -> np.ndarray:
        """At which fixes (e, s) bool terrain hides which sources: satellites that the mask lets pass, pseudolites."""
        s = self.shared.signals
        hidden = behind(self.environment.terrain, s.position, s.antenna)
        satellites = slice(0, len(s.names) - len(self.pseudolites.names))
        hidden[:, satellites] &= self.environment.in_view(s.azimuth, s.elevation, s.antenna)[:, satellites]
        return hidden

    def over(self, shared: SharedTruth) -> Case:
        """Copy of this case with another world, and its sources."""
        flight = replace(self.flight, watching=watching(self.scenario, self.environment))
        return replace(self, flight=flight.over(shared))

    @property
    def shared(self) -> SharedTruth:
        """Simulation inputs that all its runs share."""
        return self.flight.shared

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of its filter."""
        return states.names(self.design.sensors.blocks, [CLOCKS[scale] for scale in self.flight.scales])

    @property
    def state_units(self) -> tuple[str, ...]:
        """Their units."""
        return states.units(self.design.sensors.blocks, len(self.flight.scales))

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of three states for NEES."""
        return tuple(states.slices(self.design.sensors.blocks))

    @cached_property
    def uncertain(self) -> np.ndarray:
        """Which states (n,) bool have any uncertainty, in truth or in the filter: an initial sigma, process noise, or
        states that they are integrals of. Only these are degrees of freedom."""
        flight, sensors = self.flight, self.design.sensors
        triads, starts = (flight.gyro, flight.accel), (flight.start, flight.initial)
        declared = zip(sensors.blocks, sensors.sigma, strict=True)
        known = [sigma == 0.0 and block.drive == 0.0 and block.sensor != SOURCE for block, sigma in declared]
        for k, triad in enumerate(triads):  # biases come first
            known[k] &= triad.initial_sigma() == triad.drive() == 0.0 and not triad.further.there
        noisy = [
            bool(sensors.noise[k] > 0.0) or triad.white() > 0.0 or triad.scale > 0.0
            or not all(here for block, here in zip(sensors.blocks, known, strict=True) if block.sensor == k)
            for k, triad in enumerate(triads)
        ]  # fmt: skip
        fixed = flight.initial.fixed is not None and bool(np.any(flight.initial.fixed))
        attitude = fixed or any(start.attitude > 0.0 for start in starts) or noisy[states.GYROS]
        velocity = attitude or any(start.velocity > 0.0 for start in starts) or noisy[states.ACCELEROMETERS]
        position = velocity or any(start.position > 0.0 for start in starts)
        sizes = [3, 3, 3, *(block.size for block in sensors.blocks)]
        each = np.repeat([position, velocity, attitude, *np.invert(known)], sizes)
        return np.append(each, np.ones(len(self.states) - each.size, bool))  # clocks are unknown at the start

    def degrees(self, states_: slice = slice(None)) -> int:
        """Number of states, of some or of all, with any uncertainty."""
        return int(self.uncertain[states_].sum())

    @property
    def design(self) -> FilterDesign:
        """Filter model."""
        return self.flight.design

    @property
    def pseudolites(self) -> Pseudolites:
        """The pseudolites."""
        return self.environment.pseudolites

    @cached_property
    def solvable(self) -> np.ndarray:
        """At which fix epochs the geometry has a solution, clocks included (e,)."""
        return np.isfinite(self.shared.dop[:, 1])

    def fly(self, seed: int, run: int) -> Run:
        """Run number `run` of the ensemble of `seed`."""
        return next(self.fly_runs(seed, run, 1)).one(0)

    def fly_runs(
        self, seed: int, first: int, count: int, measured: bool = True, first_order: FirstOrder | None = None,
        pushes: Pushes | None = None,
    ) -> Iterator[Run]:  # fmt: skip
        """Runs first ... first + count - 1, in order, with their measurements or without, with their first-order
        errors if `first_order` is given, and their `pushes`; as many at a time as there are lanes."""
        predicts = self.first_order if self.scenario.steered else None
        return fly_runs(self.flight, seed, range(first, first + count), measured, first_order, predicts, pushes)

    @cached_property
    def why_not_linear(self) -> str:
        """Reason why its runs have no first-order error; "" if they have one."""
        try:
            # a box limits total errors, of which those of navigation are a part
            check_analysable(self.scenario.model_copy(update={"box": None, "method": "covariance"}))
        except ValueError as error:
            return str(error)
        if self.scenario.beacons is not None and (key := self.scenario.beacons.irregular):
            return f"beacons.{key} is above 0: first-order errors have neither lost answers nor outliers"
        if any(aid.sensor.clock is not None for aid in self.shared.aids):
            return "beacons.clock: first-order errors of runs do not have the clock of one-way ranges"
        if self.shared.signals.losses is not None:
            return "pseudolites.differential.link.loss is above 0: first-order errors have the losses of one flight"
        return self._rare_losses()

    def _rare_losses(self) -> str:
        """Reason why a few of its runs may be lost, so that they dominate the errors of all; "" without any.

        An ensemble without a lost run looks as if first-order errors explained it: its interval would be too narrow.
        """
        signals, gate = self.shared.signals, self.scenario.filter.gate.probability
        if gate * signals.time.size > MAX_CHANCE_REJECTIONS:
            return f"filter.gate.probability {gate:g} rejects good fixes, and a rejection depends on the error itself"
        begin, end = self.shared.imu_time[[0, -1]]
        solved = signals.time[self.solvable]
        gap = float(np.max(np.diff([begin, *solved, end])))
        if gap > max(MAX_GAP_S, 2.0 * float(np.median(np.diff([begin, *signals.time, end])))):
            return f"{gap:.1f} s without fixes: a few landings may be lost, which first-order errors do not show"
        return ""

    @cached_property
    def first_order(self) -> FirstOrder | None:
        """Computes first-order errors of its runs; None if there are none."""
        return None if self.why_not_linear else FirstOrder.of(self.flight)

    @cached_property
    def first_order_covariance(self) -> np.ndarray:
        """Exact covariance (o, 3, 3) of the first-order errors of position, NED, m2. Raises AnalysisError."""
        return position_covariance(self.flight, np.isin(self.shared.signals.names, self.pseudolites.names))


Ask = Callable[[Landing, SignalScenario], None]
"""Receives a scenario and its sources of signals before any large allocation; raises to stop."""


def prepare(scenario: Landing, document: Document, ask: Ask = lambda *_: None) -> Case:
    """Build everything that the runs share, after `ask` has checked it.

    Raises InputError for a file of satellites that cannot be used, and errors of `ask`.
    """
    trajectory, sources, scenario, warnings = build_environment(scenario, document)
    ask(scenario, sources)
    case = case_of(scenario, trajectory, sources, world_of(scenario, trajectory, sources), warnings)
    may = scenario.filter.beacons.second_order is None and not second_order_refused(scenario)
    if may and (curved := case.curved) is not None:
        case = _with_second_order(case, curved)
    case.preflight.check(document)
    return case


def _with_second_order(case: Case, curved: CurvedRange) -> Case:
    """The same with products of the position error as states, for ranges that are not linear in it."""
    scenario = _with_key(case.scenario, True)
    aids = aids_of(scenario.aiding(), case.trajectory, scenario.duration_s, scenario.imu.rate_hz)
    own = case_of(scenario, case.trajectory, case.environment, replace(case.shared, aids=aids), case.sky_warnings)
    return replace(own, second_order_of=curved)


def _with_key(scenario: Landing, second_order: bool | None) -> Landing:
    """The same with another `filter.beacons.second_order`."""
    its = scenario.filter
    own = its.model_copy(update={"beacons": its.beacons.model_copy(update={"second_order": second_order})})
    return scenario.model_copy(update={"filter": own})


def case_of(
    scenario: Landing, trajectory: Moving, sources: SignalScenario, shared: SharedTruth, warnings: Sequence[str] = ()
) -> Case:
    """The case of a scenario over its simulation inputs."""
    gyro, accel = scenario.imu.triads()
    watched = watching(scenario, sources)
    design = _filter_design(scenario, shared)
    flight = prepare_flight(shared, _initial(scenario), gyro, accel, *design, watched, _transmitters(scenario))
    return Case(scenario, trajectory, sources, flight, [*warnings])


def world_of(scenario: Landing, trajectory: Moving, sources: SignalScenario) -> SharedTruth:
    """Simulation inputs that all runs of a scenario share, from its duration, rates and receiver."""
    return build_shared_truth(
        trajectory,
        sources,
        scenario.receiver_model(),
        utc=scenario.epoch.timestamp(),
        duration=scenario.duration_s,
        imu_rate=scenario.imu.rate_hz,
        aiding=scenario.aiding(),
        air=None if (air := scenario.air()) is None else air[0],
    )


def _initial(scenario: Landing) -> InitialErrors:
    section = scenario.initial_errors
    fixed = None
    if section.fixed is not None:
        f = section.fixed
        fixed = np.array([*f.position_m, *f.velocity_m_s, *(a * DEG for a in f.attitude_deg)])
    return InitialErrors(section.attitude_deg * DEG, section.position_m, section.velocity_m_s, fixed)


def _gains(scenario: Landing, shared: SharedTruth, gyro: Triad, accel: Triad) -> tuple[Block, ...]:
    """Gains of inertial sensors in the filter model: requested ones, and by default those that matter on this
    flight."""
    dt = float(shared.imu_time[1] - shared.imu_time[0])
    large = gains_that_matter(gyro, accel, shared.dtheta, shared.dv, dt)
    its = scenario.filter
    asked = ((its.scale_factors, states.SCALE_FACTORS), (its.misalignments, states.MISALIGNMENTS))
    return tuple(b for wanted, blocks in asked for b in blocks if (b in large if wanted is None else wanted))


def _transmitters(scenario: Landing) -> TransmitterBelief | None:
    """Filter model of the errors of pseudolites, None without."""
    how = about_transmitter_errors(scenario)
    if not scenario.pseudolites.drawn or how == IGNORED:
        return None
    errors = scenario.pseudolites.errors(scenario.filter.pseudolites)
    factor = as_noise(np.array(np.inf), scenario.duration_s, 1.0 / scenario.receiver.rate_hz)
    return TransmitterBelief(how == STATES, errors, float(factor))


def _filter_design(scenario: Landing, shared: SharedTruth) -> tuple[FilterDesign, InitialErrors]:
    """Filter model, including the initial errors; keys missing in its section equal the truth."""
    section = scenario.filter
    truth = scenario.initial_errors
    given = section.initial
    initial = InitialErrors(
        (truth.attitude_deg if given.attitude_deg is None else given.attitude_deg) * DEG,
        truth.position_m if given.position_m is None else given.position_m,
        truth.velocity_m_s if given.velocity_m_s is None else given.velocity_m_s,
    )
    gyro, accel = scenario.imu.triads(section.imu.gyro, section.imu.accelerometer)
    sensors, correlated = followed(gyro, accel, _gains(scenario, shared, gyro, accel)), None
    if kinds := scenario.signals.errors.models():
        interval, step = 1.0 / scenario.receiver.rate_hz, 1.0 / scenario.imu.rate_hz
        correlated = followed_errors(about_correlated_errors(scenario), kinds, scenario.duration_s, interval)
        # those of ranges go by the sources that are received: `simulation.flight.prepare` adds them
        blocks = () if section.tight else fix_blocks(correlated, kinds, step)
        sensors = replace(sensors, blocks=(*sensors.blocks, *blocks), sigma=(*sensors.sigma, *(1.0 for _ in blocks)))
    of_aids = followed_errors_of_aids(scenario.aiding(), 1.0 / scenario.imu.rate_hz)
    sensors = replace(
        sensors, blocks=(*sensors.blocks, *(b for b, _ in of_aids)), sigma=(*sensors.sigma, *(s for _, s in of_aids))
    )
    lever_arm = scenario.receiver.lever_arm_m if section.lever_arm_m is None else section.lever_arm_m
    design = FilterDesign(
        kind=FILTER_KINDS[section.kind],
        sensors=sensors,
        velocity=section.velocity,
        latency=scenario.receiver.latency_s if section.latency_s is None else section.latency_s,
        lever_arm=np.array(lever_arm),
        sigma_scale=section.fix_sigma_scale,
        gate=gate_limits(section.gate.probability),
        max_rejected=section.gate.max_rejected,
        components=section.gaussian_sum.components,
        split_heading_sigma=section.gaussian_sum.split_heading_sigma_deg * DEG,
        steady_force=section.steady_force,
        clock=(section.clock or scenario.receiver.clock or ClockNoise()).densities() if section.tight else None,
        correlated=correlated,
        reflections=section.fix_errors != "none",
        tilt_time=_tilt_time(scenario, initial.attitude),
        flag_sigma=_flag_sigma(scenario),
    )
    return design, initial


def _tilt_time(scenario: Landing, sigma: float) -> float:
    """`FilterModel.tilt_time`, s, of a filter that starts with this 1 sigma of tilt, rad.

    Three fixes show a tilt error. 0 if the second order of a tilt error of 1 sigma is until then small beside the
    errors of a fix."""
    time, its, flagged = 3.0 / scenario.receiver.rate_hz, scenario.signals, _flag_sigma(scenario)
    height, speed = _VERTICAL_DILUTION * its.range_sigma_m, _VERTICAL_DILUTION * its.range_rate_sigma_m_s
    if flagged is not None:
        _, height, speed = np.nanmin(flagged, axis=0)
    force = STANDARD_GRAVITY * sigma**2
    most = _SMALL * scenario.filter.fix_sigma_scale
    small = 0.5 * force * time**2 < most * height
    if scenario.filter.velocity:
        small &= force * time < most * speed
    return 0.0 if small else time


def _flag_sigma(scenario: Landing) -> np.ndarray | None:
    """1 sigma (5, 3) that the filter assumes of fixes by their flag; None if they have no state."""
    model = scenario.receiver.model().states
    if model is None:
        return None
    sigma = model.sigma
    if scenario.filter.fix_flag == "ignore":
        return np.broadcast_to(np.sqrt(model.shares @ sigma**2), sigma.shape)
    if scenario.filter.fix_flag == "fixed-only":
        sigma[FIXED + 1 :] = np.nan
    return sigma


def touches_down(case: Case) -> bool:
    """Whether the flight does within the simulation."""
    return case.trajectory.path.events.get(TOUCHDOWN, math.inf) <= case.scenario.duration_s


def rms_window(case: Case) -> np.ndarray:
    """Filter outputs in the last seconds before touchdown (t,)."""
    t, end = case.shared.filter_time, touchdown_time(case.scenario, case.trajectory)
    return (t >= end - RMS_WINDOW - 1e-9) & (t <= end + 1e-9)


def crossing_times(case: Case) -> list[float]:
    """Times when the true height above the runway passes the evaluated heights, nan where it does not."""
    return times_at_heights(case, list(evaluated_heights(case.scenario).values()))


def evaluated_heights(scenario: Landing) -> dict[str, float]:
    """Heights at which errors are evaluated, m, by name: `HEIGHTS`, then those that requirements add."""
    asked = [one.at for _, one in singles(scenario.requirements) if isinstance(one, ErrorRequirement)]
    return {name: height_m(name) for name in (*HEIGHTS, *asked)}


def times_at_heights(case: Case, heights: Sequence[float]) -> list[float]:
    """Last times of descent through these heights above the runway, m, 0 for touchdown; nan if not before the last
    output."""
    return case.preflight.times_at_heights(heights)
