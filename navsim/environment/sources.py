"""Models of a landing scenario and its files: trajectory and sources of signals.

It neither compiles nor loads kernels, so that `navsim validate` reads files in the same way.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from navsim.environment.satellites import horizon_of, read_satellites
from navsim.environment.terrain import check_ground, with_heights
from navsim.formats.conventions import TRACK_ATTITUDE
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import STANDARD_GRAVITY
from navsim.gnss.constellations.systems import CLOCKS, SYSTEMS
from navsim.gnss.events import BEACONS, EVERY, PSEUDOLITES
from navsim.gnss.ground_accuracy import TABLES
from navsim.gnss.signals import Satellites, SignalScenario, time_scales
from navsim.results import files
from navsim.scenario.approach import FileApproach, TrackApproach
from navsim.scenario.events import RangeSection
from navsim.scenario.flyable import check_airspeed
from navsim.scenario.landing import Landing
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario_files.base import DEG, KeyedError, hint
from navsim.scenario_files.source import Document, InputError, Problem, dotted
from navsim.trajectory.airspeed_path import SLOWEST
from navsim.trajectory.approach import GLIDE_START, TOUCHDOWN
from navsim.trajectory.go_around import GO_AROUND
from navsim.trajectory.kinematics import Moving, Trajectory, touchdown_from_threshold
from navsim.trajectory.recorded import largest, recorded_trajectory, smoothed_path, track_trajectory

HARDEST, FASTEST = 20.0, 1000.0
"""Largest specific force, in units of standard gravity, and rate, deg/s, of a motion that a table is taken for."""

_SPEED_STEP = 0.1
"""Step in which the slowest of a long recorded flight is sought, s."""


def trajectory_of(scenario: Landing, document: Document) -> tuple[Moving, Landing]:
    """The motion to be flown, and the scenario with the checksum of its recording written into it.

    Raises InputError for a recording that cannot be used.
    """
    approach = scenario.approach
    if not isinstance(approach, FileApproach):
        return scenario.trajectory(), scenario
    from navsim.formats.text import FileError
    from navsim.results.result import ResultError

    path = document.resolve(("approach", "file"), approach.file)

    def wrong(message: str, name: str = "file") -> InputError:
        place = document.place(("approach", name))
        return InputError([Problem(place, f"approach.{name}", f"{approach.file}: {message}")])

    try:
        checksum = files.checksum(path)
        if approach.file_sha256 not in (None, checksum):
            raise wrong(f"has the checksum {checksum}, not the one of approach.file_sha256", "file_sha256")
        time, llh, attitude = _read_table(path, scenario) if isinstance(approach, TrackApproach) else _read_replay(path)
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
    if approach.touchdown_s is not None and approach.touchdown_s <= start:
        raise wrong(f"touchdown is no later than the flight begins, {start:g} s", "touchdown_s")
    threshold = scenario.runway.threshold
    assert threshold is not None
    frame = touchdown_from_threshold(
        threshold.radians, scenario.runway.ellipsoidal_m, scenario.runway.heading_deg * DEG,
        scenario.runway.aim_point_m, scenario.runway.rise_m,
    )  # fmt: skip
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
            begin, end = start - 1.0, start + scenario.duration_s + 1.0
            _refuse_unusable(path, begin, end)
            keep = (time >= begin) & (time <= end)
            moving = recorded_trajectory(time[keep] - start, llh[keep], dcm_from_rpy(attitude[keep]), frame, events)
    except ValueError as error:
        raise wrong(str(error)) from None
    if isinstance(moving, Trajectory):
        try:
            check_airspeed(scenario, moving)
        except KeyedError as error:
            raise InputError([Problem(document.place(error.path), dotted(error.path), str(error))]) from None
    pinned = approach.model_copy(update={"file_sha256": checksum})
    return moving, scenario.model_copy(update={"approach": pinned})


def _read_replay(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Times (n,), s, places (n, 3), rad, rad, m, and roll, pitch, yaw (n, 3), rad, of a replay. Raises ResultError,
    KeyError, ValueError."""
    from navsim.results.result import read

    result = read(path)
    if result.attributes["kind"] != "replay":
        raise ValueError(f"is a result of kind {result.attributes['kind']}; a replay is needed")
    time, llh, attitude = (result[f"/filter/{name}"] for name in ("time", "position_llh", "attitude_rpy"))
    if time.ndim != 1 or llh.shape != (time.size, 3) or attitude.shape != llh.shape or not time.size:
        raise ValueError("damaged: times, positions and attitudes do not belong together")
    if any(a.dtype.kind != "f" or not np.isfinite(a).all() for a in (time, llh, attitude)):
        raise ValueError("damaged: times, positions and attitudes are finite numbers in a recording")
    return time, llh, attitude


def _refuse_unusable(path: Path, begin: float, end: float) -> None:
    """Raise ValueError where the output of a replay is unusable at some time within begin .. end, s."""
    from navsim.results.result import read

    result = read(path)
    if "/lost/start" not in result:  # results of earlier versions lack it
        return
    spans = zip(*(result[f"/lost/{name}"] for name in ("start", "end", "cause")), strict=True)
    each = [f"{a:.1f} to {b:.1f} s ({why})" for a, b, why in spans if b > begin and a < end]
    if each:
        raise ValueError(
            f"its output is unusable at {', '.join(each)}, within the {begin:.1f} to {end:.1f} s that the flight "
            "needs. Choose approach.start_s and duration_s so that the flight, with a second before and after it, is "
            "beside these times"
        )


def _read_table(path: Path, scenario: Landing) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Trajectory from a table, heights above the ellipsoid; None without attitudes. Raises FileError, ValueError."""
    from navsim.formats.recording import read_track

    time, llh, attitude, dropped = read_track(path)
    if text := dropped.reasons():
        raise ValueError(f"a trajectory has each time once, in order: {'; '.join(text)}")
    if scenario.runway.height_above == "geoid":
        llh[:, 2] += scenario.runway.undulation_m
    return time, llh, attitude


def _check_flyable(moving: Moving, scenario: Landing) -> None:
    """Raise ValueError for a motion that is none of an aircraft."""
    if isinstance(moving, Trajectory):
        t = np.linspace(0.0, scenario.duration_s, max(2000, math.ceil(scenario.duration_s / _SPEED_STEP) + 1))
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
    """Checksums of the files of its sky and terrain by their names in a scenario, once they are written into it."""
    sky = scenario.sky
    around = {} if sky.horizon is None or sky.horizon_sha256 is None else {sky.horizon: sky.horizon_sha256}
    around |= {its.file: its.file_sha256 for its in scenario.terrain if its.file and its.file_sha256}
    names, checksums = getattr(sky, sky.source, ()), getattr(sky, f"{sky.source}_sha256", ())
    return around | (dict(zip(names, checksums, strict=True)) if sky.source in SOURCES_FROM_FILES else {})


def environment(
    scenario: Landing, document: Document, trajectory: Moving | None = None
) -> tuple[SignalScenario, Landing, list[str]]:
    """The sources of signals, the scenario with the checksums of its files and the time scale of its pseudolites
    written into it, warnings.

    Raises InputError for a file of satellites that cannot be used.
    """
    warnings: list[str] = []
    if trajectory is None:
        trajectory, scenario = trajectory_of(scenario, document)
    satellites: tuple[Satellites, ...] = ()
    listed = scenario.sky.listed() if scenario.sky.source == "directions" else None
    if listed is None:
        satellites, scenario = read_satellites(scenario, document, warnings)
    kept = scenario.pseudolites.with_clock(time_scales(satellites, listed))
    scenario = scenario.model_copy(update={"pseudolites": kept})
    pseudolites = scenario.pseudolites.model(scenario.pseudolite_positions(trajectory.frame))
    horizon, scenario = horizon_of(scenario, document)
    warnings += scenario.sky.unused() + scenario.unused_of_flight()
    lever_arm, jammed = np.array(scenario.receiver.lever_arm_m), scenario.interference
    scenario, about_heights = with_heights(scenario, document, trajectory.frame)
    terrain = scenario.terrain_around(trajectory.frame)
    ground = scenario.signals.errors.ground_station
    receivers = 1 if ground is None else ground.receivers
    warnings += about_heights + check_ground(scenario, document, trajectory, terrain)
    sources = SignalScenario(
        satellites,
        listed,
        scenario.sky.mask(horizon),
        pseudolites,
        scenario.signals.law(),
        lever_arm,
        scenario.effects(pseudolites),
        tuple(replace(one, receivers=receivers if one.receiver else 1) for one in (e.model() for e in scenario.events)),
        None
        if jammed is None
        else jammed.model(scenario.threshold(trajectory.frame), scenario.signals.tracking, scenario.receiver, terrain),
        None if scenario.receiver.antenna is None else scenario.receiver.antenna.model(),
        terrain,
        scenario.runway.ellipsoidal_m,
    )
    _check_events(scenario, document, sources)
    warnings += _excluded_elsewhere(scenario, document, sources)
    there = {*sources.systems, CLOCKS[pseudolites.time_scale] if pseudolites.names else ""}
    if not scenario.receiver.single_clock and there & set(scenario.signals.system_offsets_ns):
        warnings.append(
            "signals.system_offsets_ns changes no position: a receiver with a clock unknown for each system does not "
            "notice; it is for `receiver.single_clock: true`"
        )
    warnings += [
        f"signals.system_offsets_ns.{name} changes nothing: no source keeps the time of {name}"
        for name in scenario.signals.system_offsets_ns
        if name not in there
    ]
    return sources, scenario, warnings


def _check_events(scenario: Landing, document: Document, sources: SignalScenario) -> None:
    """Raise InputError for sources of events that are none, and for satellites that a ground station corrects and has
    no table of errors for."""
    known = {EVERY, PSEUDOLITES, *sources.systems, *sources.pseudolites.names}
    known |= {name for group in sources.satellites for name in group.names}
    known |= set(() if sources.listed is None else sources.listed.names)
    known |= set() if scenario.beacons is None else {BEACONS, *scenario.beacons.names()}
    unserved = {EVERY, PSEUDOLITES, *sources.pseudolites.names}
    unserved |= set() if scenario.beacons is None else {BEACONS, *scenario.beacons.names()}
    problems = []
    for i, event in enumerate(scenario.events):
        for j, name in enumerate(event.sources):
            if name not in known:
                path = ("events", i, "sources", j)
                text = f"{name!r} is not a source; {hint(name, sorted(known))}"
                problems.append(Problem(document.place(path), dotted(path), text))
            elif name in unserved and isinstance(event, RangeSection) and event.reference_receiver is not None:
                path = ("events", i, "sources", j)
                text = f"reference receivers measure satellites: name some, or their system, not {name!r}"
                problems.append(Problem(document.place(path), dotted(path), text))
    if scenario.signals.errors.ground_station is not None:
        section = ("signals", "errors", "ground_station")
        others = sorted({*sources.systems} - {PSEUDOLITES, *TABLES})
        text = f"is for {' and '.join(TABLES)}, and the sky has {', '.join(others)}: leave that out of sky.systems"
        problems += [Problem(document.place(section), dotted(section), text)] if others else []
    if problems:
        raise InputError(problems)


def _excluded_elsewhere(scenario: Landing, document: Document, sources: SignalScenario) -> list[str]:
    """Warning about excluded satellites of unused systems. Raises InputError for those that the sky's source does not
    have."""
    sky, problems, elsewhere = scenario.sky, [], []
    known = [name for group in sources.satellites for name in group.names]
    known += [] if sources.listed is None else sources.listed.names
    # sources of several systems, some of them unused
    mixed = sky.source in ("nominal", *SOURCES_FROM_FILES)
    passed_over = [s for s in SYSTEMS if mixed and s not in sky.wanted()]
    for i, name in enumerate(sky.exclude):
        if name in known:
            continue
        if system := next((s.name for s in passed_over if s.has(name)), None):
            elsewhere.append(f"{name} ({system})")
            continue
        path = ("sky", "exclude", i)
        text = f"`source: {sky.source}` has no '{name}'; {hint(name, sorted(known))}"
        problems.append(Problem(document.place(path), dotted(path), text))
    if problems:
        raise InputError(problems)
    used = ", ".join(s.name for s in sky.wanted())
    return [f"sky.exclude: {', '.join(elsewhere)}: not used anyway, systems are {used}"] if elsewhere else []


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
