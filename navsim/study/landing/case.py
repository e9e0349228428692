"""A landing scenario turned into models, ready to be flown."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from navsim.core import states
from navsim.core.arrays.attitude import dcm_from_rpy
from navsim.core.arrays.earth import ecef_from_llh, llh_from_ecef
from navsim.core.lanes import WIDTH
from navsim.estimation.beliefs import Beliefs
from navsim.estimation.estimate import FILTER_KINDS
from navsim.io import files
from navsim.io.recording import read_track
from navsim.io.results import ResultError, read
from navsim.io.schema import HEIGHTS, RMS_WINDOW
from navsim.io.text import FileError
from navsim.models.approach import GLIDE_START, TOUCHDOWN
from navsim.models.conventions import STANDARD_GRAVITY, TRACK_ATTITUDE
from navsim.models.events import EVERY, PSEUDOLITES
from navsim.models.go_around import GO_AROUND
from navsim.models.interference import radio_horizon
from navsim.models.jamming import LOWEST
from navsim.models.kinematics import Moving, Trajectory, touchdown_from_threshold
from navsim.models.recorded_trajectory import largest, recorded_trajectory, smoothed_path, track_trajectory
from navsim.models.retimed import SLOWEST
from navsim.models.signals import Environment, Pseudolites, Satellites, antenna_ecef
from navsim.models.systems import CLOCKS
from navsim.scenario.approach import FileApproach, TrackApproach
from navsim.scenario.base import DEG, KeyedError, hint
from navsim.scenario.box import BoxSection
from navsim.scenario.events import EventSection
from navsim.scenario.integrity import IntegritySection
from navsim.scenario.landing import Landing
from navsim.scenario.presets import IMU_SHEETS
from navsim.scenario.requirements import INTEGRITY, PresetRequirement
from navsim.scenario.signals import ClockNoise
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario.source import Document, InputError, Problem, dotted
from navsim.simulation.aiding import followed_errors as followed_heights
from navsim.simulation.landing import (
    Flight,
    InitialErrors,
    Run,
    World,
    build_world,
    fly,
)
from navsim.simulation.landing import prepare as prepare_flight
from navsim.simulation.lasting import followed_errors
from navsim.simulation.sensors import followed
from navsim.study.landing.faults import watching
from navsim.study.landing.sky import horizon_of, read_satellites
from navsim.study.statistics import gate_limits

FOOT = 0.3048
PERCENTILES = (50, 95, 99)
_ROUGH = 50
MISPRINT = 1.0
"""Difference of a published direction of a runway from that between its thresholds that is warned of, deg."""
HARDEST, FASTEST = 20.0, 1000.0
"""Largest specific force, in units of standard gravity, and rate, deg/s, of a motion that a table is taken for."""


@dataclass(frozen=True)
class Case:
    """A scenario turned into models, ready to be flown any number of times."""

    scenario: Landing
    trajectory: Moving
    environment: Environment
    flight: Flight
    sky_warnings: list[str] = field(default_factory=list)

    @property
    def warnings(self) -> list[str]:
        """What the input has to be warned of: its sky, a landing that does not end on the ground, a box before any
        fix."""
        out = [*self.sky_warnings]
        touchdown = self.trajectory.path.events.get(TOUCHDOWN, -math.inf)
        if touchdown > self.scenario.duration_s:
            out.append(
                f"touchdown would be at {touchdown:.1f} s, after the end of the simulation "
                f"(duration_s: {self.scenario.duration_s:g}); figures at touchdown are not defined"
                + (", and requirements judge the part of the glide that is flown" if self.scenario.requirements else "")
            )
        if abs(off := self.scenario.runway.misprint_deg) > MISPRINT:
            side = "right" if off > 0.0 else "left"
            out.append(
                f"runway.bearing_deg: the published direction is {abs(off):.1f} deg {side} of that between the "
                f"thresholds, {self.scenario.runway.heading_deg:.2f} deg, which is flown"
            )
        out += self._gains_of_sheet()
        if (broken_off := self.trajectory.path.events.get(GO_AROUND, math.inf)) <= self.scenario.duration_s:
            out.append(
                f"the landing is broken off at {broken_off:.1f} s (approach.go_around): there is no touchdown; figures "
                "there are not defined, and those of the last seconds before it are of the end of the simulation"
            )
        if self.scenario.box is not None and (self.world.filter_time[1:2] > (when := box_time(self))).any():
            out.append(
                f"box.height_m: {self.scenario.box.height_m:g} m above the runway are passed at {when:.2f} s, before "
                "the first fix: the errors there are those that the filter begins with"
            )
        if self.scenario.box is not None and (apart := self._route_outside(self.scenario.box)):
            out.append(f"box: the route itself is outside {' and '.join(apart)}")
        out += [
            f"{aid.sensor.name}: measures nothing on this flight, whose heights or attitudes are beyond its limits"
            for aid in self.world.aids
            if aid.time.size and aid.missing == aid.time.size
        ]
        hidden = self.behind_terrain()
        out += self._out_of_sight(hidden) + self._shadowed()
        out += hidden_throughout(self.pseudolites.names, hidden)
        if (section := self.scenario.integrity) is not None:
            out += section.unused(self.environment.systems)
            out += [
                f"requirements[{i}]: continuity and hazardously misleading information are counted by "
                f"integrity.limits, which are not those of {each.operation}: undecided; give limits: "
                f"{{operation: {each.operation}, tta_s: ...}}"
                for i, each in enumerate(self.scenario.requirements)
                if isinstance(each, PresetRequirement) and not each.counts_by(section.limits)
            ]
            out += [
                f"requirements[{i}]: levels are not those of {each.operation}, which allows a risk of {INTEGRITY:g} an "
                f"approach: {self._risk_of_levels(section)}"
                for i, each in enumerate(self.scenario.requirements)
                if isinstance(each, PresetRequirement) and not each.levels_are_its_own(section)
            ]
        out += [
            f"events[{i}]: {event.what} of {', '.join(event.sources)}: none of them is received then"
            for i, event in enumerate(self.scenario.events)
            if event.what != "silence" and not self._received(event)
        ]
        if (jamming := self.environment.jamming) is not None:
            heard = np.isfinite(self.world.signals.js).any(axis=(1, 2))
            out += [
                f"interference.jammers[{j}]: {jammer.name} is never received: it is off, or beyond the radio horizon"
                for j, jammer in enumerate(jamming.jammers)
                if not heard[j]
            ]
            stopped = [*itertools.compress(self.environment.names, ~jamming.passed(self.environment.carriers))]
            if stopped:
                text = f"no band has the carriers of {', '.join(stopped)}: they are not received"
                out.append(f"interference.front_end_mhz: {text}")
        return out

    @staticmethod
    def _risk_of_levels(section: IntegritySection) -> str:
        if section.method == "chi2":
            return "integrity.method chi2 computes them for a fault that is there (p_md); mhss does for a risk"
        risk = section.risk_of_levels()
        return f"integrity.p_hmi_v, p_hmi_h and p_unmonitored_max allow {risk:.3g}"

    def _gains_of_sheet(self) -> list[str]:
        """Gains that the data sheet of a preset brings and the filter takes for none."""
        imu, its = self.scenario.imu, self.scenario.filter
        if imu.preset not in IMU_SHEETS:
            return []
        gains = (
            ("scale_ppm", "scale factors", "scale_factors"), ("misalignment_mrad", "misalignments", "misalignments"),
        )  # fmt: skip
        there = [(name, f"filter.{key}: true") for error, name, key in gains if not getattr(its, key)
                 and (getattr(imu.gyro, error) or getattr(imu.accelerometer, error))]  # fmt: skip
        if not there:
            return []
        names, keys = (" and ".join(words) for words in zip(*there, strict=True))
        return [f"imu.preset: {imu.preset} has {names}, which the filter takes for none: give {keys}"]

    def _route_outside(self, box: BoxSection) -> list[str]:
        """The limits of the box that an error of 0 is beyond."""
        lower, upper = box.limits(box_place(self))
        keys = ("lateral_m", "along_m" if box.from_threshold_m is None else "from_threshold_m", "vertical_m")
        return [key for key, low, high in zip(keys, lower, upper, strict=True) if not low <= 0.0 <= high]

    def _out_of_sight(self, hidden: np.ndarray) -> list[str]:
        """Pseudolites that are heard although the Earth is between them and the whole flight. hidden: as of
        `behind_terrain`."""
        path = self.trajectory.motion(self.world.signals.time).position_ecef
        ground = self.scenario.runway.ellipsoidal_m
        over = np.maximum(llh_from_ecef(path)[:, 2] - ground, LOWEST) if self.pseudolites.names else path
        out = []
        for i, (name, llh) in enumerate(zip(self.pseudolites.names, self.pseudolites.llh, strict=True)):
            if hidden[:, i].all():  # and not heard
                continue
            away = np.linalg.norm(path - ecef_from_llh(llh), axis=1)
            if away.size and (away > radio_horizon(over, max(llh[2] - ground, LOWEST))).all():
                far = f"{name} is {away.min() / 1000.0:.0f} km away"
                out.append(f"pseudolites: {far}, beyond the radio horizon of the whole flight, and heard nevertheless")
        return out

    def _shadowed(self) -> list[str]:
        """Pseudolites that the aircraft is in the way of, by name."""
        antenna, signals, count = self.environment.antenna, self.world.signals, len(self.pseudolites.names)
        if antenna is None or not count:
            return []
        away = signals.position[:, -count:] - signals.antenna[:, None]
        towards = away / np.linalg.norm(away, axis=2, keepdims=True)
        c_eb = self.trajectory.motion(signals.time).c_eb
        hidden = (antenna.elevation_of(c_eb, towards) < antenna.mask).sum(axis=0)
        return [
            f"receiver.antenna: the aircraft shadows {name} at {times} of {signals.time.size} fixes"
            for name, times in zip(self.pseudolites.names, hidden.tolist(), strict=True)
            if times
        ]

    def behind_terrain(self) -> np.ndarray:
        """At which fixes (e, p) bool terrain hides which pseudolites."""
        return self.environment.behind_terrain(self.world.signals.antenna)

    def _received(self, event: EventSection) -> bool:
        """Whether any source of an event is, while it lasts."""
        signals, model = self.world.signals, event.model()
        lasting = (signals.time >= model.begin) & (signals.time < model.end)
        concerned = model.concerns(signals.names, self.environment.systems_of(signals.names))
        return bool(signals.used[np.ix_(lasting, concerned)].any())

    def over(self, world: World) -> Case:
        """The same in another world, of the sources that it has now."""
        flight = replace(self.flight, watching=watching(self.scenario, self.environment))
        return replace(self, flight=flight.over(world))

    @property
    def world(self) -> World:
        """What all its runs share."""
        return self.flight.world

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of its filter."""
        return states.names(self.beliefs.sensors.blocks, [CLOCKS[scale] for scale in self.flight.scales])

    @property
    def state_units(self) -> tuple[str, ...]:
        """Their units."""
        return states.units(self.beliefs.sensors.blocks, len(self.flight.scales))

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of three states that are judged by themselves."""
        return tuple(states.slices(self.beliefs.sensors.blocks))

    @property
    def beliefs(self) -> Beliefs:
        """What its filter believes."""
        return self.flight.beliefs

    @property
    def pseudolites(self) -> Pseudolites:
        """The pseudolites."""
        return self.environment.pseudolites

    def fly(self, seed: int, run: int) -> Run:
        """Run number `run` of the ensemble of `seed`."""
        return fly(self.flight, seed, [run]).one(0)

    def fly_runs(self, seed: int, first: int, count: int, measured: bool = True) -> Iterator[Run]:
        """Runs first ... first + count - 1, in order, with their measurements or without; as many at a time as there
        are lanes."""
        for begin in range(first, first + count, WIDTH):
            yield fly(self.flight, seed, range(begin, min(begin + WIDTH, first + count)), measured)


def hidden_throughout(names: Sequence[str], hidden: np.ndarray) -> list[str]:
    """What to warn of pseudolites that terrain hides at all fixes, (e, p) bool."""
    return [
        f"terrain: {name} is behind it during the whole flight, and never received"
        for name, times in zip(names, hidden.T, strict=True)
        if times.size and times.all()
    ]


def out_of_sight(scenario: Landing, document: Document) -> list[str]:
    """The same of a scenario that nobody has made models of yet. Raises InputError for a recording that cannot be
    used."""
    if not scenario.terrain or not scenario.pseudolites.placed():
        return []
    trajectory, scenario = trajectory_of(scenario, document)
    motion = trajectory.motion(scenario.receiver.model().epochs(scenario.duration_s, scenario.imu.rate_hz))
    sources, _, _ = environment(scenario, document, trajectory)
    return hidden_throughout(
        sources.pseudolites.names, sources.behind_terrain(antenna_ecef(motion, sources.lever_arm))
    )


def trajectory_of(scenario: Landing, document: Document) -> tuple[Moving, Landing]:
    """The motion to be flown, and the scenario with the checksum of its recording written into it.

    Raises InputError for a recording that cannot be used.
    """
    approach = scenario.approach
    if not isinstance(approach, FileApproach):
        return scenario.trajectory(), scenario
    path = document.resolve(("approach", "file"), approach.file)

    def wrong(message: str, name: str = "file") -> InputError:
        place = document.place(("approach", name))
        return InputError([Problem(place, f"approach.{name}", f"{approach.file}: {message}")])

    try:
        checksum = files.checksum(path)
        if approach.file_sha256 not in (None, checksum):
            raise wrong(f"has the checksum {checksum}, not the one of approach.file_sha256", "file_sha256")
        time, llh, attitude = (
            _read_table(path, scenario) if isinstance(approach, TrackApproach) else _read_replay(path)
        )
    except (ResultError, KeyError, FileError, ValueError) as error:
        raise wrong(str(error)) from None
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror or error}") from None
    if attitude is not None and scenario.wind.blows:
        text = "a recorded flight with its attitudes has had its wind"
        raise InputError([Problem(document.place(("wind", "speed_m_s")), "wind.speed_m_s", text)])
    start = float(time[0]) if approach.start_s is None else approach.start_s
    if not time[0] - 1e-9 <= start < time[-1]:
        raise wrong(f"the recording lasts from {time[0]:g} to {time[-1]:g} s", "start_s")
    if start + scenario.duration_s > time[-1] + 1e-9:
        raise wrong(
            f"the recording ends {time[-1] - start:.1f} s after the start; duration_s is {scenario.duration_s:g}"
        )
    threshold = scenario.runway.threshold
    assert threshold is not None
    frame = touchdown_from_threshold(
        threshold.radians, scenario.runway.ellipsoidal_m, scenario.runway.heading_deg * DEG, scenario.runway.aim_point_m
    )
    events = {} if approach.touchdown_s is None else {TOUCHDOWN: approach.touchdown_s - start}
    moving: Moving
    try:
        if isinstance(approach, TrackApproach):
            way = smoothed_path(time - start, llh, approach.sigmas, frame, events)
            if attitude is None:
                moving = scenario.trajectory_along(way, frame)
            else:
                moving = track_trajectory(way, time - start, llh, dcm_from_rpy(attitude))
            _check_flyable(moving, scenario)
        else:
            assert attitude is not None
            keep = (time >= start - 1.0) & (time <= start + scenario.duration_s + 1.0)
            moving = recorded_trajectory(time[keep] - start, llh[keep], dcm_from_rpy(attitude[keep]), frame, events)
    except ValueError as error:
        raise wrong(str(error)) from None
    pinned = approach.model_copy(update={"file_sha256": checksum})
    return moving, scenario.model_copy(update={"approach": pinned})


def _read_replay(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Times (n,), s, places (n, 3), rad, rad, m, and roll, pitch, yaw (n, 3), rad, of a replay. Raises ResultError,
    KeyError, ValueError."""
    result = read(path)
    if result.attributes["kind"] != "replay":
        raise ValueError(f"is a result of kind {result.attributes['kind']}; a replay is needed")
    time, llh, attitude = (result[f"/filter/{name}"] for name in ("time", "position_llh", "attitude_rpy"))
    if time.ndim != 1 or llh.shape != (time.size, 3) or attitude.shape != llh.shape or not time.size:
        raise ValueError("damaged: times, positions and attitudes do not belong together")
    if any(a.dtype.kind != "f" or not np.isfinite(a).all() for a in (time, llh, attitude)):
        raise ValueError("damaged: times, positions and attitudes are finite numbers in a recording")
    return time, llh, attitude


def _read_table(path: Path, scenario: Landing) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The same of a table, heights above the ellipsoid; None without attitudes. Raises FileError, ValueError."""
    time, llh, attitude, dropped = read_track(path)
    if said := dropped.said():
        raise ValueError(f"a trajectory has each time once, in order: {'; '.join(said)}")
    if scenario.runway.height_above == "geoid":
        llh[:, 2] += scenario.runway.undulation_m
    return time, llh, attitude


def _check_flyable(moving: Moving, scenario: Landing) -> None:
    """Raise ValueError for a motion that is none of an aircraft."""
    if isinstance(moving, Trajectory):
        t = np.linspace(0.0, scenario.duration_s, 2000)
        speed = np.linalg.norm(moving.path.jet(t)[:, 1], axis=1)
        if (slowest := float(speed.min())) < SLOWEST:
            text = f"moves at {slowest:.2f} m/s {t[int(np.argmin(speed))]:.1f} s after the start"
            columns = ", ".join(TRACK_ATTITUDE)
            raise ValueError(f"{text}; below {SLOWEST:g} m/s attitudes are needed: columns {columns}")
    most = largest(moving, scenario.duration_s)
    wider = "give places with a larger sigma_m, or better ones"
    if most.force > HARDEST * STANDARD_GRAVITY:
        text = f"needs {most.force / STANDARD_GRAVITY:.1f} g {most.force_time:.2f} s after the start"
        raise ValueError(f"{text}, {HARDEST:g} are allowed; {wider}")
    if most.rate > FASTEST * DEG:
        text = f"turns at {most.rate / DEG:.0f} deg/s {most.rate_time:.2f} s after the start"
        raise ValueError(f"{text}, {FASTEST:g} are allowed; {wider}")


def files_of(scenario: Landing) -> dict[str, str]:
    """Checksums of the files of its sky by the names a scenario gives them, once they are written into it."""
    sky = scenario.sky
    around = {} if sky.horizon is None or sky.horizon_sha256 is None else {sky.horizon: sky.horizon_sha256}
    names, checksums = getattr(sky, sky.source, ()), getattr(sky, f"{sky.source}_sha256", ())
    return around | (dict(zip(names, checksums, strict=True)) if sky.source in SOURCES_FROM_FILES else {})


def environment(
    scenario: Landing, document: Document, trajectory: Moving | None = None
) -> tuple[Environment, Landing, list[str]]:
    """The sources of signals, the scenario with the checksums of its files written into it, warnings.

    Raises InputError for a file of satellites that cannot be used.
    """
    warnings: list[str] = []
    if trajectory is None:
        trajectory, scenario = trajectory_of(scenario, document)
    pseudolites = scenario.pseudolites.model(scenario.pseudolite_positions(trajectory.frame))
    satellites: tuple[Satellites, ...] = ()
    listed = scenario.sky.listed() if scenario.sky.source == "directions" else None
    if listed is None:
        satellites, scenario = read_satellites(scenario, document, warnings)
    horizon, scenario = horizon_of(scenario, document)
    warnings += scenario.sky.unused() + scenario.unused_of_flight()
    lever_arm, jammed = np.array(scenario.receiver.lever_arm_m), scenario.interference
    terrain = scenario.terrain_tops(trajectory.frame)
    sources = Environment(
        satellites,
        listed,
        scenario.sky.mask(horizon),
        pseudolites,
        scenario.signals.law(),
        lever_arm,
        scenario.effects(pseudolites),
        tuple(event.model() for event in scenario.events),
        None
        if jammed is None
        else jammed.model(scenario.threshold(trajectory.frame), scenario.signals.tracking, scenario.receiver, terrain),
        None if scenario.receiver.antenna is None else scenario.receiver.antenna.model(),
        terrain,
    )
    _check_events(scenario, document, sources)
    there = {*sources.systems, CLOCKS[pseudolites.clock] if pseudolites.names else ""}
    warnings += [
        f"signals.system_offsets_ns.{name} changes nothing: no source keeps the time of {name}"
        for name in scenario.signals.system_offsets_ns
        if name not in there
    ]
    return sources, scenario, warnings


def _check_events(scenario: Landing, document: Document, sources: Environment) -> None:
    """Raise InputError for sources of events that are none."""
    known = {EVERY, PSEUDOLITES, *sources.systems, *sources.pseudolites.names}
    known |= {name for group in sources.satellites for name in group.names}
    known |= set(() if sources.listed is None else sources.listed.names)
    problems = []
    for i, event in enumerate(scenario.events):
        for j, name in enumerate(event.sources):
            if name not in known:
                path = ("events", i, "sources", j)
                problems.append(
                    Problem(document.place(path), dotted(path), f"{name!r} is no source; {hint(name, sorted(known))}")
                )
    if problems:
        raise InputError(problems)


Ask = Callable[[Landing, Environment], None]
"""Told a scenario and its sources of signals before anything of their size is made; raises where it is not to be."""


def prepare(scenario: Landing, document: Document, ask: Ask = lambda *_: None) -> Case:
    """Build everything the runs share, once `ask` has let it pass.

    Raises InputError for a file of satellites that cannot be used, and what `ask` raises.
    """
    trajectory, scenario = trajectory_of(scenario, document)
    if isinstance(scenario.approach, FileApproach):  # of others the scenario itself knows the track
        try:
            scenario.pseudolite_sites(trajectory.frame, scenario.track(trajectory))
        except KeyedError as error:
            raise InputError([Problem(document.place(error.path), dotted(error.path), str(error))]) from None
    sources, scenario, warnings = environment(scenario, document, trajectory)
    ask(scenario, sources)
    gyro, accel = scenario.imu.triads()
    world = world_of(scenario, trajectory, sources)
    watched = watching(scenario, sources)
    flight = prepare_flight(world, _initial(scenario), gyro, accel, *_beliefs(scenario), watched)
    case = Case(scenario, trajectory, sources, flight, warnings)
    if scenario.box is not None and math.isnan(box_time(case)):
        (when,), last = _passed(case, [scenario.box.height_m]), float(world.filter_time[-1])
        height = scenario.box.height_m
        what = f"comes down through {height:g} m above the runway" if height else "touches down"
        after = f"the aircraft {what} at {when:.2f} s, after the filter's last output at {last:g} s"
        text = f"the aircraft never {what} within duration_s" if math.isnan(when) else after
        raise InputError([Problem(document.place(("box", "height_m")), "box.height_m", text)])
    _check_ground(case, document)
    return case


def _check_ground(case: Case, document: Document) -> None:
    """What the ground leaves in a range is a part of it. Raises InputError where it is more."""
    section, signals = case.scenario.integrity, case.world.signals
    station = None if section is None or section.comparison is None else section.comparison.gbas
    if station is None or not signals.used.any():
        return
    least = float(signals.fix_sigma[signals.used].min())
    if station.ground_sigma_m > least:
        path = ("integrity", "comparison", "gbas", "ground_sigma_m")
        text = f"is a part of each range's sigma, of which the least is {least:.3g} m: at most that"
        raise InputError([Problem(document.place(path), dotted(path), text)])


def world_of(scenario: Landing, trajectory: Moving, sources: Environment) -> World:
    """What all runs of a scenario share, by its duration, rates and receiver."""
    return build_world(
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


def _beliefs(scenario: Landing) -> tuple[Beliefs, InitialErrors]:
    """What the filter believes, and of the initial errors: what its section leaves out is what the truth has."""
    section = scenario.filter
    truth = scenario.initial_errors
    given = section.initial
    initial = InitialErrors(
        (truth.attitude_deg if given.attitude_deg is None else given.attitude_deg) * DEG,
        truth.position_m if given.position_m is None else given.position_m,
        truth.velocity_m_s if given.velocity_m_s is None else given.velocity_m_s,
    )
    gyro, accel = scenario.imu.triads(section.imu.gyro, section.imu.accelerometer)
    sensors, lasting = followed(gyro, accel, section.scale_factors, section.misalignments), None
    if kinds := scenario.signals.errors.models():
        interval, step = 1.0 / scenario.receiver.rate_hz, 1.0 / scenario.imu.rate_hz
        lasting, blocks = followed_errors(section.about_lasting_errors(), kinds, scenario.duration_s, interval, step)
        sensors = replace(sensors, blocks=(*sensors.blocks, *blocks), sigma=(*sensors.sigma, *(1.0 for _ in blocks)))
    of_aids = followed_heights(scenario.aiding(), 1.0 / scenario.imu.rate_hz)
    sensors = replace(
        sensors, blocks=(*sensors.blocks, *(b for b, _ in of_aids)), sigma=(*sensors.sigma, *(s for _, s in of_aids))
    )
    lever_arm = scenario.receiver.lever_arm_m if section.lever_arm_m is None else section.lever_arm_m
    beliefs = Beliefs(
        kind=FILTER_KINDS[section.kind],
        sensors=sensors,
        velocity=section.velocity,
        latency=scenario.receiver.latency_s if section.latency_s is None else section.latency_s,
        lever_arm=np.array(lever_arm),
        sigma_scale=section.fix_sigma_scale,
        gate=gate_limits(section.gate.probability),
        max_rejected=section.gate.max_rejected,
        components=section.gaussian_sum.components,
        widest=section.gaussian_sum.heading_deg * DEG,
        clock=(section.clock or scenario.receiver.clock or ClockNoise()).densities() if section.tight else None,
        lasting=lasting,
    )
    return beliefs, initial


def on_glide(scenario: Landing, trajectory: Moving, time: np.ndarray) -> np.ndarray:
    """Which times (e,), s, lie between the start of the glide and touchdown, or a go-around (e,) bool."""
    first = trajectory.path.events.get(GLIDE_START, 0.0)
    last = min(touchdown_time(scenario, trajectory), trajectory.path.events.get(GO_AROUND, math.inf))
    return (time >= first - 1e-9) & (time <= last + 1e-9)


def glide_epochs(scenario: Landing, trajectory: Moving) -> tuple[np.ndarray, np.ndarray]:
    """Fix epochs up to touchdown (e,), s, and which of them are on the glide (e,) bool; see `glide_geometry`."""
    time = scenario.receiver.model().epochs(scenario.duration_s, scenario.imu.rate_hz)
    time = time[time <= touchdown_time(scenario, trajectory) + 1e-9]
    return time, on_glide(scenario, trajectory, time)


def touchdown_time(scenario: Landing, trajectory: Moving) -> float:
    """Time of touchdown, or the end of a flight without one, s."""
    return float(min(trajectory.path.events.get(TOUCHDOWN, math.inf), scenario.duration_s))


def touches_down(case: Case) -> bool:
    """Whether the flight does within the simulation."""
    return case.trajectory.path.events.get(TOUCHDOWN, math.inf) <= case.scenario.duration_s


def rms_window(case: Case) -> np.ndarray:
    """Which filter outputs lie in the last seconds before touchdown (t,)."""
    t, end = case.world.filter_time, touchdown_time(case.scenario, case.trajectory)
    return (t >= end - RMS_WINDOW - 1e-9) & (t <= end + 1e-9)


def crossing_times(case: Case) -> list[float]:
    """Times when the true height above the runway passes the decision heights, nan where it does not."""
    return times_at_heights(case, [feet * FOOT for feet in HEIGHTS.values()])


def box_time(case: Case) -> float:
    """When the height of the scenario's box is passed, s; nan where it is not."""
    assert case.scenario.box is not None
    return times_at_heights(case, [case.scenario.box.height_m])[0]


def box_place(case: Case) -> float:
    """Where the route is then, along the runway from the threshold, m."""
    along = case.trajectory.path.jet(np.array([box_time(case)]))[0, 0, 0]
    return float(along) + case.scenario.runway.aim_point_m


def times_at_heights(case: Case, heights: Sequence[float]) -> list[float]:
    """Times when the true height above the runway last comes down through these, m, 0 for touchdown; nan where it does
    not before the filter's last output."""
    last = case.world.filter_time[-1] + 1e-9
    return [when if when <= last else math.nan for when in _passed(case, heights)]


def _passed(case: Case, heights: Sequence[float]) -> list[float]:
    """`times_at_heights` whether or not there are outputs; nan where heights are not passed within the flight."""
    path = case.trajectory.path
    touchdown = path.events.get(TOUCHDOWN, math.inf)
    fine = np.arange(0.0, min(touchdown, case.scenario.duration_s), 1e-3)
    climbing = fine >= path.events.get(GO_AROUND, math.inf)
    if climbing.any():  # to the bottom of the pull-up: what comes after is not passed coming down
        fine = fine[: int(np.argmax(climbing)) + int(np.argmin(-path.jet(fine[climbing])[:, 0, 2])) + 1]
    # the last moment above a height is sought among every 50th, then among those that follow it
    rough = -path.jet(fine[::_ROUGH])[:, 0, 2]
    times = []
    for height in heights:
        last = np.flatnonzero(rough >= height)[-1:] * _ROUGH
        near = fine[int(last[0]) : int(last[0]) + _ROUGH + 1] if last.size else fine[:0]
        above = near[-path.jet(near)[:, 0, 2] >= height]
        if height == 0.0 or (above.size and above[-1] == fine[-1]):
            # on the ground, or between the last of the times and it, unless the flight ends before
            when = touchdown
        else:
            when = float(above[-1]) if above.size else math.nan
        times.append(when if when <= case.scenario.duration_s + 1e-9 else math.nan)
    return times
