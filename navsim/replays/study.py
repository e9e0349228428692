"""Study of a recorded flight: read, align, tune, filter, evaluate by innovations and outages.

Tuning follows one rule for every flight. Values in the LOG.yaml are kept. The others are set by `replays.tuning` so
that the innovations of the fixes in motion are most likely:

- horizontal and vertical velocity noise of the fixes;
- white noise of gyros and of accelerometers, expected within a factor of two of the sensor class's;
- latency.

The noise of positions is 2.5 s times that of velocities. Without vertical velocities, vertical noise equals horizontal
noise. Fixes closer than 0.45 s share their errors, so the filter uses one of them. Biases are those of the sensor
class, except that a standstill before the flight shows the gyros' turn-on bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from navsim.filter import states
from navsim.filter.design import Beliefs
from navsim.filter.estimate import FILTER_KINDS, is_smoother
from navsim.filter.measurement_models import FIX
from navsim.filter.records import NOT_USED, REJECTED, TFG
from navsim.formats.recorded_data import Fixes, Ranges, Samples
from navsim.formats.recording import is_nmea, read_fixes, read_imu
from navsim.formats.text import Dropped, FileError
from navsim.geodesy.attitude import dcm_from_quaternion, dcm_from_rpy, quaternion_from_dcm
from navsim.gnss.timescales import gps_from_utc
from navsim.replays import alignment as aligning
from navsim.replays import flight as replay
from navsim.replays.diagnosis import examine
from navsim.replays.mistakes import Log
from navsim.replays.recorded_ranges import read_messages, read_ranges, together
from navsim.replays.scenario import FixError, KnownSection, Outage, Replay
from navsim.replays.single_point import PositioningOptions
from navsim.replays.tuning import EVALUATIONS, FASTEST_NEEDED, LATENCY, moving_speed, tune
from navsim.results import files
from navsim.results.builder import ResultBuilder
from navsim.results.findings import CONSISTENT, Finding, kept, several
from navsim.results.result import Result
from navsim.results.schema import REPLAY
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import DOUBTED, limit, notes, of_flight
from navsim.runner.job import JobError
from navsim.runner.statistics import gate_limits
from navsim.scenario.base import DEG, DEG_H, MG
from navsim.scenario.source import Document, InputError, Place, Problem
from navsim.sensors.imu import Triad
from navsim.simulation.inertial_states import followed

POSITION_TIME = 2.5
"""1 sigma of a position over that of a velocity, s: receivers propagate positions with the velocity."""
STANDSTILL_FACTOR = 5.0
"""Drift of a gyro bias after a standstill, in multiples of its in-run instability."""
_MOST_PDOP = 30.0
"""Largest PDOP of fixes from ranges that are flown, RTKLIB's: their sigma is that of all fixes."""
MOST_DAMAGED = 0.1
"""Share of rows outside of physical limits up to which they are damage; of more, the unit may be another one."""
LARGEST_NIS = 2.0
"""Mean normalised innovation squared of a recorded flight, whose noise is tuned to 1, that is no accident."""
LEAST_SAMPLES, LEAST_FIXES = 10, 4
"""Least number of samples and fixes for an alignment."""
_BEFORE = 1.5
"""Intervals before the first sample at which a known state may be: it is of the end of its interval."""
_START = (0.3, 0.3)
"""Velocity noise where the tuning starts, and without tuning, m/s."""
NEVER = 1_000_000_000
"""Rejections in a row that are never reached."""
USUAL_HEADING = 10.0 * DEG
"""1 sigma of heading that a restart of the filter needs, if the log gives the initial heading."""
MANY_REJECTED = 0.05
"""Fraction of rejected fixes, or ranges, beyond which a finding is reported."""
PAUSE = 3.0
"""Shortest reported time without fixes, s, if it is longer than `USUAL` intervals."""
USUAL, TOLD = 5.0, 5
"""Length of a pause in usual intervals; number of pauses of one kind that are reported individually."""
UNFLOWN = 10.0
"""Shortest part of a recording that is missed when it is not flown, s."""
SIDEWAYS, OFF_COURSE = 60.0 * DEG, 10.0
"""Angle between nose and course that wind and sideslip explain, rad, and for how long more is no accident, s."""
_TUNED = ("velocity_sigma_horizontal", "velocity_sigma_vertical", "gyro_noise_density", "accelerometer_noise_density",
          "latency")  # fmt: skip
_TUNED_TIGHT = ("range_rate_sigma", "range_sigma", *_TUNED[2:])
_START_TIGHT = (0.1, 1.0)
"""Noise of range rates and ranges overhead where the tuning of a tight filter starts, and without it, m/s, m."""
_DILUTION = 3.0
"""1 sigma of a fix in that of a range, for the start of a tight filter and the innovations of fixes."""


class ReplayError(JobError):
    """A recording that can be read, but not flown."""


@dataclass(frozen=True)
class Recording:
    """A recording ready for the filter: data, alignment, filter model, and remarks."""

    scenario: Replay
    samples: Samples
    fixes: Fixes
    alignment: aligning.Alignment
    settings: np.ndarray
    free: np.ndarray
    gyro: Triad
    accel: Triad
    longest_gap: float
    has_vertical: bool
    ranges: Ranges | None
    recorded: tuple[float, float]
    search: aligning.Search
    known: replay.KnownStart | None
    not_judged: tuple[str, ...] = ()
    warnings: list[str] = field(default_factory=list)

    @property
    def tight(self) -> bool:
        """Whether the filter takes ranges."""
        return self.scenario.filter.coupling == "tight"

    @cached_property
    def has_velocity(self) -> bool:
        """Whether any fix has a velocity, or of a tightly coupled filter any source a range rate."""
        if self.tight and self.ranges is not None:
            return bool(np.isfinite(self.ranges.range_rate).any())
        return bool(np.isfinite(self.fixes.velocity).any())

    @property
    def tuned(self) -> tuple[str, ...]:
        """Names of the settings."""
        return _TUNED_TIGHT if self.tight else _TUNED

    def beliefs(self, settings: np.ndarray, kind: int) -> Beliefs:
        """Model of a filter of `kind` for values of `tuned` (5,)."""
        _, _, gyro, accel, latency = settings
        section = self.scenario.filter
        gate = section.gate
        sensors = followed(replace(self.gyro, noise_density=gyro), replace(self.accel, noise_density=accel))
        blocks = _lasting(self.scenario.gnss.errors, self.interval)
        sensors = replace(
            sensors, blocks=(*sensors.blocks, *blocks), sigma=(*sensors.sigma, *(1.0 for _ in blocks))
        )
        return Beliefs(
            kind=kind,
            sensors=sensors,
            velocity=True,
            latency=max(0.0, float(latency)),  # an early fix waits until it is valid, and then is of now
            lever_arm=np.array(self.scenario.gnss.lever_arm_m),
            sigma_scale=1.0,
            gate=gate_limits(gate.probability),
            max_rejected=NEVER if gate.max_rejected is None else gate.max_rejected,
            components=section.gaussian_sum.components,
            widest=section.gaussian_sum.heading_deg * DEG,
            # without velocities nothing confirms those of the filter
            steady_force=section.steady_force and self.has_velocity,
            clock=self.scenario.gnss.clock.densities() if self.tight else None,
        )

    @cached_property
    def interval(self) -> float:
        """Usual interval of the samples, s."""
        return float(np.median(np.diff(self.samples.time)))

    def fix_sigma(self, settings: np.ndarray) -> np.ndarray:
        """1 sigma of the fixes' position and velocity (6,), north, east, down, m, m/s, for values of `tuned` (5,)."""
        if self.tight:
            return _DILUTION * np.repeat(settings[[1, 0]], 3)
        horizontal, vertical = settings[:2]
        velocity = np.array([horizontal, horizontal, vertical if self.has_vertical else horizontal])
        given = self.scenario.gnss.position_sigma_m
        position = POSITION_TIME * velocity if given is None else np.array(given)[[0, 0, 1]]
        return np.concatenate([position, velocity])

    def range_sigma(self, settings: np.ndarray) -> tuple[float, float]:
        """1 sigma of pseudoranges, m, and range rates, m/s, overhead, for values of `tuned` (5,) of a tight filter."""
        return float(settings[1]), float(settings[0])

    def with_error(self, time: float, sigma: tuple[float, float]) -> Recording:
        """Copy whose fixes also have an estimated position error of this correlation time, s, and 1 sigma, horizontal
        and vertical, m."""
        error = FixError(time_s=time, position_sigma_m=sigma)
        gnss = self.scenario.gnss.model_copy(update={"errors": [error]})
        scenario = self.scenario.model_copy(update={"gnss": gnss})
        return replace(self, scenario=scenario, fixes=_with_effects(self.fixes, [error]))

    def flight(self, latency: float) -> replay.RecordedFlight:
        """The increments and fixes after the alignment."""
        ranges = self.ranges if self.tight else None
        patience = self.scenario.filter.gate.restart_s
        return replay.prepare(
            self._sensed, self.fixes, self.alignment, latency, ranges, self._realigned, patience, self.known
        )

    def of_rejected(self, settings: np.ndarray, flight: replay.RecordedFlight) -> np.ndarray:
        """Contribution of each rejected fix of a flight (m,), or of any range (), to the tuning.

        It equals that of a fix at the limit of the gate, with its own noise or, without one, that of `settings`.
        Noise that makes the gate reject fixes thus gains nothing.
        """
        limits = gate_limits(self.scenario.filter.gate.probability)
        if self.tight:
            sigma = settings[:2]
        else:
            own = replay.own_or_usual(flight.covariance, self.fix_sigma(settings))
            sigma = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
        limit = float(limits[sigma.shape[-1]])
        counts = 0.5 * limit + np.sum(np.log(sigma), axis=-1)
        return np.asarray(counts if np.isfinite(limit) else np.zeros_like(counts))

    def _realigned(self, time: float) -> aligning.Alignment | None:
        """The next alignment at or after `time`, s, under way or at a standstill; no setting changes it."""
        if time not in self._alignments:
            self._alignments[time] = aligning.find(self.samples, self._valid_fixes, time, self.search)
        return self._alignments[time]

    @cached_property
    def _alignments(self) -> dict[float, aligning.Alignment | None]:
        return {}

    @cached_property
    def _valid_fixes(self) -> Fixes:
        return self.fixes.earlier(self.settings[LATENCY])

    @cached_property
    def moving_speed(self) -> float:
        """Speed, m/s, from which on a fix of the flight is in motion."""
        flight = self.flight(float(self.settings[LATENCY]))
        return moving_speed(flight.speed, not np.isfinite(flight.velocity[:, :2]).any())

    @cached_property
    def _sensed(self) -> replay.Sensed:
        """The increments, which no setting changes: a tuning flies them hundreds of times."""
        averaged = self.scenario.imu.samples != "instantaneous"
        return replay.increments(self.samples, self.alignment.time, self.longest_gap, averaged)


@dataclass(frozen=True)
class ReadLog:
    """Files of a log: data, scenario with their checksums, remarks."""

    scenario: Replay
    samples: Samples
    fixes: Fixes
    ranges: Ranges | None
    warnings: list[str]
    not_judged: tuple[str, ...]


def read(scenario: Replay, document: Document) -> ReadLog:
    """Read and check. Raises InputError for files that cannot be used or do not seem to match the log."""
    motion, place, fewest = scenario.imu.convention(), scenario.gnss.convention(), scenario.gnss.min_satellites
    tables = [_table(document, scenario, "imu", lambda path, *how: read_imu(path, how[0], motion, how[1]))]
    ranges = None
    if scenario.gnss.navigation is None:
        simulated = scenario.gnss.simulator_fixes

        def fixes_of(path: Path, lenient: bool, limited: bool) -> Any:
            return read_fixes(path, fewest, lenient, place, limited, simulated)

        tables.append(_table(document, scenario, "gnss", fixes_of))
    else:
        of_ranges, ranges = _observed(document, scenario)
        tables.append(of_ranges)
    scenario = _pinned(scenario, document)
    warnings, not_judged = _checked(scenario, document, *(table.judged for table in tables))
    for table in tables:
        if table.refusal is not None:
            raise table.refusal
        warnings += table.lost.said()
    samples, fixes = (table.rows for table in tables)
    return ReadLog(scenario, samples, fixes, ranges, warnings, tuple(not_judged))


def prepare(scenario: Replay, document: Document) -> Recording:
    """Read, check and align. Raises InputError as `read`, ReplayError where no alignment is found."""
    log = read(scenario, document)
    scenario, ranges, warnings = log.scenario, log.ranges, log.warnings
    samples, fixes, first = _wanted(scenario, document, log.samples, log.fixes)
    fixes = _with_effects(fixes, scenario.gnss.errors)
    if ranges is not None:
        apart = _spaced(ranges.time, scenario.gnss.spacing_s)
        apart = apart[ranges.time[apart] <= samples.time[-1]]
        ranges = ranges.take(apart)
        fixes = fixes.take(np.isin(fixes.time, ranges.time))
    interval = float(np.median(np.diff(samples.time)))
    longest_gap = 5.0 * interval if scenario.imu.longest_gap_s is None else scenario.imu.longest_gap_s
    gyro_section, accel_section = scenario.imu.resolved()
    gyro, accel = gyro_section.triad(1.0 / interval), accel_section.triad(1.0 / interval)
    gnss = scenario.gnss
    velocity: tuple[float, ...] = _START if gnss.velocity_sigma_m_s is None else gnss.velocity_sigma_m_s
    latency = 0.0 if gnss.latency_s is None else gnss.latency_s  # untuned, and where the alignment starts
    open_noise = [gnss.velocity_sigma_m_s is None and not fixes.has_own_noise] * 2
    tight = scenario.filter.coupling == "tight"
    if tight:
        given = (gnss.range_rate_sigma_m_s, gnss.range_sigma_m)
        velocity = tuple(start if v is None else v for v, start in zip(given, _START_TIGHT, strict=True))
        open_noise = [v is None for v in given]
    settings = np.array([*velocity, gyro.noise_density, accel.noise_density, latency])
    given_noise = (scenario.imu.gyro.arw_deg_sqrt_h, scenario.imu.accelerometer.vrw_m_s_sqrt_h)
    free = np.array([*open_noise, *(v is None for v in given_noise), gnss.latency_s is None])
    free &= scenario.tuning == "likelihood"
    if gnss.navigation is not None:
        free[LATENCY] = False  # observations are stamped with the time they are valid
    has_vertical = bool(np.isfinite(fixes.velocity[:, 2]).any())
    if not tight and gnss.velocity_sigma_m_s is None and not has_vertical:
        free[1] = False  # the data do not show it; `beliefs` ties it to the horizontal one
    search = _search(scenario, gyro, accel)
    known = None if scenario.alignment.known is None else _known_start(scenario.alignment.known)
    aligned = _align(search, samples, fixes.earlier(settings[LATENCY]), first) if known is None else known.alignment
    # a heading that is known is that of the start
    again = search if search.heading is None else replace(search, heading=None, heading_sigma=USUAL_HEADING)
    if np.sum(samples.time > aligned.time) < 2 or not np.any(fixes.time > aligned.time):
        raise ReplayError(f"the recording ends with its alignment, at {aligned.time:g} s")
    warnings += _not_flown(scenario, log, first, aligned)
    warnings += _outages_elsewhere(scenario, aligned.time, float(samples.time[-1]))
    return Recording(
        scenario,
        samples,
        fixes,
        aligned,
        settings,
        np.flatnonzero(free),
        gyro,
        accel,
        longest_gap,
        tight or has_vertical or gnss.velocity_sigma_m_s is not None,
        ranges,
        (float(min(log.samples.time[0], log.fixes.time[0])), float(max(log.samples.time[-1], log.fixes.time[-1]))),
        again,
        known,
        log.not_judged,
        warnings,
    )


def _checked(scenario: Replay, document: Document, samples: Samples, fixes: Fixes) -> tuple[list[str], list[str]]:
    """Warnings about probable mistakes in how the recording is written, and about unchecked quantities.

    Raises InputError if it cannot be used.
    """
    if scenario.checks == "off":
        return [], ["everything: checks are off"]
    log = Log(
        samples,
        fixes,
        scenario.imu.convention(),
        scenario.gnss.convention(),
        latency=scenario.gnss.latency_s,
        first=-np.inf if scenario.begin is None else scenario.begin,
        last=np.inf if scenario.end_s is None else scenario.end_s,
        sentences=is_nmea(document.resolve(("gnss", "file"), scenario.gnss.file), scenario.lenient),
    )
    examined = examine(log)
    found = examined.mistakes
    if found and scenario.checks == "refuse":
        way_out = "(`checks: warn` flies it nevertheless)"
        raise InputError(
            [Problem(document.place((m.section, "file")), f"{m.section}.file", f"{m} {way_out}") for m in found]
        )
    return [str(mistake) for mistake in found], examined.not_judged


@dataclass(frozen=True)
class _Table:
    """Rows of a file."""

    judged: Any
    """Rows for the checks."""
    rows: Any
    """Rows for the filter."""
    lost: Dropped
    """Rows that were left out."""
    refusal: InputError | None = None
    """Why the rows are unusable, unless the checks find a better reason."""


def _table(
    document: Document, scenario: Replay, section: Literal["imu", "gnss"], reader: Callable[[Path, bool, bool], Any]
) -> _Table:
    """Read a file with a reader of (path, lenient, limited). Raises InputError.

    Values outside of physical limits are damage, or a wrong unit. If there are many, the checks include them, so that
    the wrong unit is found.
    """
    rows, lost = _read(document, scenario, section, lambda path: reader(path, scenario.lenient, False))
    if lost.outside is None:
        return _Table(rows, rows, lost)
    try:
        within, left = _read(document, scenario, section, lambda path: reader(path, True, True))
    except InputError as too_few:
        lost.outside.salvageable = False
        refusal = too_few if scenario.lenient else _refused(document, scenario, section, lost.outside)
        return _Table(rows, rows, lost, refusal)
    judged = within if within.time.size >= (1.0 - MOST_DAMAGED) * rows.time.size else rows
    if scenario.lenient:
        return _Table(judged, within, left)
    return _Table(judged, rows, lost, _refused(document, scenario, section, lost.outside))


def _observed(document: Document, scenario: Replay) -> tuple[_Table, Ranges]:
    """The fixes of RINEX observations, and their ranges. Raises InputError."""
    gnss, dropped = scenario.gnss, Dropped(scenario.lenient)
    several = []
    for i, name in enumerate(gnss.navigation or ()):
        path = document.resolve(("gnss", "navigation"), name)
        place = document.place(("gnss", "navigation"))
        try:
            several.append(read_messages(path, scenario.lenient, dropped, gnss.wanted()))
        except FileError as error:
            at = Place(str(path), error.line, 1) if error.line else place
            raise InputError([Problem(at, f"gnss.navigation[{i}]", f"{name}: {error.message}")]) from None
        except OSError as error:
            message = f"{name}: cannot be read: {error.strerror or error} ({path})"
            raise InputError([Problem(place, f"gnss.navigation[{i}]", message)]) from None
    shift = gnss.time_offset_s - float(gps_from_utc(scenario.epoch.timestamp()))
    messages = together(several)
    options = PositioningOptions(mask=gnss.mask_deg * DEG, troposphere=gnss.atmosphere, most_pdop=_MOST_PDOP)
    fixes, ranges = _read(
        document, scenario, "gnss",
        lambda path: read_ranges(path, messages, options, gnss.min_satellites, shift, dropped),
    )  # fmt: skip
    return _Table(fixes, fixes, dropped), ranges


def _read(document: Document, scenario: Replay, section: Literal["imu", "gnss"], reader: Callable[[Path], Any]) -> Any:
    name = getattr(scenario, section).file
    path = document.resolve((section, "file"), name)
    where = document.place((section, "file"))
    key = f"{section}.file"
    try:
        return reader(path)
    except FileError as error:
        raise _refused(document, scenario, section, error) from None
    except OSError as error:
        message = f"{name}: cannot be read: {error.strerror or error} ({path})"
        raise InputError([Problem(where, key, message)]) from None


def _refused(document: Document, scenario: Replay, section: str, error: FileError) -> InputError:
    """A file that cannot be used, at its line."""
    where = document.place((section, "file"))
    path = document.resolve((section, "file"), getattr(scenario, section).file)
    place = Place(str(path), error.line, 1) if error.line else where
    cure = "; `lenient: true` takes the intact part" if error.salvageable else ""
    return InputError([Problem(place, f"{section}.file", f"{error.message} (named at {where}){cure}")])


def _pinned(scenario: Replay, document: Document) -> Replay:
    """The log with its files' checksums, which must be those given. Raises InputError."""
    update = {}
    for name in ("imu", "gnss"):
        section = getattr(scenario, name)
        checksum = files.checksum(document.resolve((name, "file"), section.file))
        if section.file_sha256 not in (None, checksum):
            place = document.place((name, "file_sha256"))
            message = f"{section.file} has the checksum {checksum}, not this one"
            raise InputError([Problem(place, f"{name}.file_sha256", message)])
        update[name] = section.model_copy(update={"file_sha256": checksum})
    if scenario.gnss.navigation is not None:
        key = ("gnss", "navigation")
        sums = tuple(files.checksum(document.resolve(key, name)) for name in scenario.gnss.navigation)
        if scenario.gnss.navigation_sha256 not in (None, sums):
            place = document.place(("gnss", "navigation_sha256"))
            message = f"the files have the checksums {', '.join(sums)}, not these"
            raise InputError([Problem(place, "gnss.navigation_sha256", message)])
        update["gnss"] = update["gnss"].model_copy(update={"navigation_sha256": sums})
    return scenario.model_copy(update=update)


def _search(scenario: Replay, gyro: Triad, accel: Triad) -> aligning.Search:
    """Requirements and assumptions of the initial alignment."""
    wanted = scenario.alignment
    return aligning.Search(
        None if wanted.heading_deg is None else wanted.heading_deg * DEG, wanted.heading_sigma_deg * DEG,
        wanted.longest_s, gyro.initial_sigma(), STANDSTILL_FACTOR * gyro.markov, accel.initial_sigma(),
    )  # fmt: skip


def _lasting(errors: Sequence[FixError], step: float) -> list[states.Block]:
    """States for time-correlated errors of fixes, in groups of three; step: of the filter, s."""
    out: list[states.Block] = []
    for error in errors:
        for _ in range(0, error.states or 3, 3):
            name, numbered = f"fix_error_{len(out) + 1}", error.states is not None
            out.append(states.lasting(name, FIX, error.time_s, step, 3 * len(out), numbered))
    return out


def _with_effects(fixes: Fixes, errors: Sequence[FixError]) -> Fixes:
    """The fixes with the effect of all time-correlated errors: from the table, or 1 sigma along each position axis."""
    if not errors:
        return fixes
    parts, first = [], 0
    for error in errors:
        if error.position_sigma_m is not None:
            of_sigma = np.zeros((6, 3))
            of_sigma[:3] = np.diag(np.array(error.position_sigma_m)[[0, 0, 1]])
            parts.append(np.tile(of_sigma, (fixes.time.size, 1, 1)))
        elif fixes.effect is not None and error.states is not None:
            parts.append(fixes.effect[..., first : first + error.states])
            first += error.states
    return replace(fixes, effect=np.concatenate(parts, axis=2))


def _known_start(section: KnownSection) -> replay.KnownStart:
    """The state of the navigation that a log gives."""
    navigation = np.zeros(states.NAV_N)
    navigation[states.NAV_LLH : states.NAV_VEL] = section.lat_deg * DEG, section.lon_deg * DEG, section.height_m
    navigation[states.NAV_VEL : states.NAV_QUAT] = section.velocity_m_s
    attitude = dcm_from_rpy(np.array(section.attitude_deg) * DEG)
    navigation[states.NAV_QUAT : states.NAV_HELD] = quaternion_from_dcm(attitude)
    navigation[states.NAV_GYRO : states.NAV_ACCEL] = np.array(section.gyro_bias_deg_h) * DEG_H
    navigation[states.NAV_ACCEL : states.NAV_N] = np.array(section.accelerometer_bias_mg) * MG
    attitude_sigma = np.array(section.attitude_sigma_deg) * DEG
    sigma = np.concatenate([section.position_sigma_m, section.velocity_sigma_m_s, attitude_sigma])
    return replay.KnownStart(section.time_s, navigation, sigma)


def _align(search: aligning.Search, samples: Samples, fixes: Fixes, first: float) -> aligning.Alignment:
    """Earliest alignment: at the end of a standstill, or under way. Raises ReplayError if there is none."""
    found = aligning.find(samples, fixes, first, search)
    if found is not None:
        return found
    if search.heading is not None:
        raise ReplayError(
            f"alignment.heading_deg needs a standstill at the start, and there is none in the {aligning.LONGEST:g} s "
            f"from {first:g} s on; leave it out, or let start_s begin where the aircraft stands"
        )
    raise ReplayError(
        f"no alignment: nowhere after {first:g} s do {search.longest:g} s of motion give the heading to "
        f"{np.degrees(search.heading_sigma):g} degrees; allow more with alignment.heading_sigma_deg, or give "
        "alignment.heading_deg"
    )


def _wanted(scenario: Replay, document: Document, samples: Samples, fixes: Fixes) -> tuple[Samples, Fixes, float]:
    """The samples and fixes to be flown, spaced, and the time from which on both are there. Raises InputError, at the
    key that leaves too few of them."""

    def part(start: float | None, end: float | None) -> tuple[Samples, Fixes, float, str]:
        """The part from `start` to `end`, and which data it has too few of."""
        first = float(max(samples.time[0], fixes.time[0], -np.inf if start is None else start))
        if known is not None and start is not None:
            first = start  # a sample may end later than its interval begins, and fixes come later
        last = min(samples.time[-1], np.inf if end is None else end)
        of_samples, of_fixes = samples.between(first - 1.0, last), fixes.take(fixes.time <= last)
        common = int(np.sum(of_fixes.time >= first))
        enough = of_samples.time.size >= LEAST_SAMPLES and common >= LEAST_FIXES
        counted = f"{several(of_samples.time.size, 'sample')} and {several(common, 'fix')}"
        return of_samples, of_fixes, first, "" if enough else f"{counted}; needed are {LEAST_SAMPLES} and {LEAST_FIXES}"

    def refused(key: str, message: str) -> Problem:
        return Problem(document.place(tuple(key.split("."))), key, message)

    known = scenario.alignment.known
    (s_begin, s_end), (f_begin, f_end) = samples.time[[0, -1]], fixes.time[[0, -1]]
    spans = f"samples {s_begin:.1f} to {s_end:.1f} s, fixes {f_begin:.1f} to {f_end:.1f} s"
    too_few = part(None, None)[-1]
    if too_few:
        key = "gnss.time_offset_s" if scenario.gnss.time_offset_s else "gnss.file"
        overlap = s_begin <= f_end and f_begin <= s_end
        said = f"the recordings have in common only {too_few}" if overlap else "the recordings have no common time"
        raise InputError([refused(key, f"{said} ({spans})")])
    start, end = scenario.begin, scenario.end_s
    begins = "start_s" if known is None else "alignment.known.time_s"
    of_samples, of_fixes, first, too_few = part(start, end)
    if too_few:
        given = {key: value for key, value in ((begins, start), ("end_s", end)) if value is not None}
        alone = {begins: part(start, None)[-1], "end_s": part(None, end)[-1]}
        to_blame = [key for key in given if alone[key]] or list(given)
        message = f"leaves {too_few} ({spans})"
        raise InputError([refused(key, f"{given[key]:g} {message}") for key in to_blame])
    interval = float(np.median(np.diff(samples.time)))
    if known is not None and first < s_begin - _BEFORE * interval:
        message = f"{first:g} s is before the first sample ({spans}); give the state at a time from {s_begin:g} s on"
        raise InputError([refused(begins, message)])
    spaced = of_fixes.take(_spaced(of_fixes.time, scenario.gnss.spacing_s))
    common = int(np.sum(spaced.time >= first))
    if common < LEAST_FIXES:
        message = f"{scenario.gnss.spacing_s:g} leaves {several(common, 'fix')}; needed are {LEAST_FIXES} ({spans})"
        raise InputError([refused("gnss.spacing_s", message)])
    return of_samples, spaced, first


def _spaced(times: np.ndarray, spacing: float) -> np.ndarray:
    """Times (m,) at least `spacing` seconds after the last one kept (k,)."""
    kept: list[int] = []
    for index, time in enumerate(times):
        if not kept or time - times[kept[-1]] >= spacing:
            kept.append(index)
    return np.array(kept, dtype=np.int64)


def compute(recording: Recording, done: Callable[[int], None] = lambda _: None) -> Result:
    """Tune, fly, impose the outages. Raises ReplayError where a smoother fails."""
    scenario = recording.scenario
    tuning = tune(recording, done)
    settings = tuning.settings
    kind = FILTER_KINDS[scenario.filter.kind]
    flight, beliefs = recording.flight(settings[LATENCY]), recording.beliefs(settings, kind)
    fix_sigma = recording.fix_sigma(settings)
    begin, end = flight.imu_time[0], flight.imu_time[-1]
    rate = scenario.filter.output_rate_hz
    if rate == "fixes":
        times = np.concatenate([[begin], flight.arrival])
    else:
        times = np.arange(np.ceil(begin * rate), np.floor(end * rate) + 1) / rate
    withheld = np.zeros(flight.arrival.size, dtype=bool)
    for outage in scenario.outages:
        if outage.withhold:
            for first, last in _spans(outage):
                withheld |= (flight.arrival >= first) & (flight.arrival <= last)
    try:
        flown = replay.fly(
            flight, beliefs, fix_sigma, times, withheld=withheld, range_sigma=recording.range_sigma(settings)
        )
    except ArithmeticError as error:
        raise ReplayError(str(error)) from None
    scales = [] if flight.ranges is None else [flight.ranges.scales[clock] for clock in flight.ranges.clocks]
    blocks = beliefs.sensors.blocks
    names = states.names(blocks, scales), states.units(blocks, len(scales))
    draft = ResultBuilder(REPLAY, {"mixed": ", ".join(dict.fromkeys(names[1]))})
    _filter(draft, flown, np.isin(flown.time, times), *names)
    _innovations(draft, flight, flown)
    _outages(draft, recording, flight, settings)
    _lost(draft, flown)
    _fixes(draft, flight)
    for name, value, was_free in zip(recording.tuned, settings, tuning.tuned, strict=True):
        of_fixes = name in _TUNED[:2] and recording.fixes.has_own_noise
        origin = "not used: each fix has its own" if of_fixes else "tuned to the innovations" if was_free else "given"
        draft.put(f"/tuning/{name}", value, {"origin": origin})
    _summary(draft, flight, flown, recording.moving_speed)
    alignment = recording.alignment
    out = draft.result(
        root_attributes(
            "replay", 0, scenario, alignment_time=alignment.time, alignment_until=alignment.until,
            alignment_sigma_deg=np.degrees(np.sqrt(np.diag(alignment.covariance))),
            recorded_s=recording.recorded, flown_s=(flight.imu_time[0], flight.imu_time[-1]),
            not_judged="; ".join(recording.not_judged),
        )
    )  # fmt: skip
    out.variables.update(kept([*tuning.findings, *findings(recording, out, withheld, flight, flown)]))
    return out


def findings(
    recording: Recording, result: Result, withheld: np.ndarray, flight: replay.RecordedFlight, flown: replay.Replayed
) -> list[Finding]:
    """Findings for the user; withheld: (e,) bool, fixes withheld by outages."""
    out = notes(recording.warnings)
    broken = {begin for begin, _ in flight.breaks}
    for first, length in flight.gaps:
        begin = float(flight.imu_time[first])
        if begin not in broken:
            text = f"no samples for {length:.3g} s from {begin:.3f} s on; the covariance was widened"
            out.append(Finding("gap", text, (), 1, 1, 1, begin))
    out += _pauses(flight) + [_of_lost(one) for one in flown.lost] + _outliers(flight, flown)
    if recording.scenario.checks != "off":
        out += _off_course(flight, flown)
    return out + of_flight(result, None, withheld | ~flown.flown) + _inconsistent(result)


def _inconsistent(result: Result) -> list[Finding]:
    """Finding of innovations whose squares exceed `LARGEST_NIS`, in the group of fixes with the largest ones.

    `of_flight` reports larger ones for their size alone.
    """
    degrees = result["/innovations/degrees"]
    nis = dict(zip(result["/summary/fixes"], result["/summary/nis"], strict=True))
    group = max((name for name in nis if np.isfinite(nis[name])), key=lambda name: float(nis[name]), default="all")
    most = LARGEST_NIS * limit(float(degrees.sum())) / DOUBTED
    if not nis[group] > most or nis["all"] > limit(float(degrees.sum())):
        return []
    text = (
        f"the innovations of {group} fixes have a NIS of {nis[group]:.2f} per degree of freedom where 1 is due. The "
        "filter trusts its fixes and sensors too much, and its sigmas are too small. Give "
        "gnss.velocity_sigma_m_s, or leave it out so that it is tuned"
    )
    return [Finding("innovations", text, (CONSISTENT,), int(degrees.astype(bool).sum()), degrees.size)]


def _pauses(flight: replay.RecordedFlight) -> list[Finding]:
    """The finding of times without fixes."""
    solved = Fixes(flight.arrival, flight.llh, flight.velocity).take(np.isfinite(flight.llh[:, 0]))
    if solved.time.size < 2:
        return []
    pauses = solved.pauses(max(PAUSE, USUAL * float(np.median(np.diff(solved.time)))))
    if not pauses.size:
        return []
    each = [f"{end - begin:.1f} s from {begin:.1f} s on" for begin, end in pauses]
    text = f"no fixes for {_few(each)}: the filter goes by its inertial sensors alone"
    return [Finding("pauses", text, (), len(each), len(each), 1, float(pauses[0, 0]))]


def _few(each: list[str]) -> str:
    """Some texts as one, and how many more there are."""
    more = f", and {len(each) - TOLD} more" if len(each) > TOLD else ""
    return ", ".join(each[:TOLD]) + more


def _of_lost(lost: replay.LostSpan) -> Finding:
    """The finding of a time at which the output is worthless."""
    if lost.why == replay.GAP:
        text = f"no samples for {lost.end - lost.begin:.1f} s, longer than the attitude survives: there is no output"
    else:
        jump = float(np.linalg.norm(lost.jump))
        apart = f", {jump:.3g} m apart at the end" if np.isfinite(jump) else " twice, and the fixes came back"
        text = f"the filter contradicted its fixes{apart}: its output is worthless"
    after = "nothing after it is flown, since no alignment was found" if lost.ended else "then the filter starts anew"
    text += f" from {lost.begin:.1f} to {lost.end:.1f} s; {after}"
    return Finding("lost", text, (CONSISTENT,), 1, 1, 1, lost.begin)


def _outliers(flight: replay.RecordedFlight, flown: replay.Replayed) -> list[Finding]:
    """The finding of fixes, or ranges, that the gate rejected, but those of times at which the filter was lost."""
    when = flight.arrival[: flown.rejected.size]
    away = np.zeros(when.size, bool)
    for one in flown.lost:
        away |= (when >= one.begin) & (when <= one.end)
    rejected = np.where(away, 0, flown.rejected)
    count = int(rejected.sum())
    if not count:
        return []
    tight = flown.range_status.size > 0
    of = int((flown.range_status != NOT_USED).sum() if tight else (flown.status != NOT_USED).sum())
    rows = np.flatnonzero(rejected)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    spans = [f"{when[r[0]]:.1f} s" if r.size == 1 else f"{when[r[0]]:.1f} to {when[r[-1]]:.1f} s" for r in runs]
    lost = int(flown.rejected.sum()) - count
    text = f"{count} of {of} {'ranges' if tight else 'fixes'} were rejected by the innovation gate, at {_few(spans)}"
    if lost:
        text += f"; {lost} more were rejected while the filter was lost"
    against = (CONSISTENT,) if count > MANY_REJECTED * of else ()
    name = "rejected_ranges" if tight else "rejected_fixes"
    return [Finding(name, text, against, count, of, 1, float(when[rows[0]]))]


def _not_flown(scenario: Replay, log: ReadLog, first: float, aligned: aligning.Alignment) -> list[str]:
    """Warnings about parts of a recording, longer than `UNFLOWN`, that the filter does not process without being asked
    to.

    They are before the first fix or sample, before the alignment, and after the last sample.
    """
    samples, fixes = log.samples.time, log.fixes.time
    away = f"no {scenario.alignment.longest_s:g} s of motion give the heading to "
    away += f"{scenario.alignment.heading_sigma_deg:g} degrees"
    parts = [(first, aligned.since, away)]
    if scenario.begin is None:
        parts.insert(0, (float(samples[0]), first, "there are samples and no fixes"))
        parts.insert(0, (float(fixes[0]), first, "there are fixes and no samples"))
    if scenario.end_s is None:
        parts.append((float(samples[-1]), float(fixes[-1]), "there are fixes and no samples"))
    return [
        f"{begin:.1f} to {end:.1f} s of the recording ({end - begin:.0f} s) are not flown: {why}"
        for begin, end, why in parts
        if end - begin > UNFLOWN
    ]


def _off_course(flight: replay.RecordedFlight, flown: replay.Replayed) -> list[Finding]:
    """The findings of the times at which the nose points far from the course: `SIDEWAYS` and three sigma, for
    `OFF_COURSE` seconds of motion on end."""
    at = np.minimum(np.searchsorted(flown.time, flight.arrival), flown.time.size - 1)
    nose = dcm_from_quaternion(flown.navigation[at, states.NAV_QUAT : states.NAV_HELD])[:, :2, 0]
    angle = np.angle(np.exp(1j * (np.arctan2(nose[:, 1], nose[:, 0]) - flight.course)))
    moving = np.flatnonzero((flight.speed > FASTEST_NEEDED) & flown.flown & (flown.status != REJECTED))
    off = np.abs(angle[moving]) > SIDEWAYS + 3.0 * flown.sigma[at[moving], states.A_D]
    edges = np.flatnonzero(np.diff(off, prepend=False, append=False)).reshape(-1, 2)
    out = []
    for begin, end in edges:
        rows = moving[begin:end]
        first, last = (float(t) for t in flight.arrival[rows[[0, -1]]])
        if last - first < OFF_COURSE:
            continue
        text = (
            f"heading {np.degrees(np.median(np.abs(angle[rows]))):.0f} degrees off the course from {first:.1f} to "
            f"{last:.1f} s (median of {rows.size} fixes faster than {FASTEST_NEEDED:g} m/s, 1 sigma of the heading "
            f"{np.degrees(np.median(flown.sigma[at[rows], states.A_D])):.1f} degrees). The attitude is wrong, unless "
            "the aircraft flies sideways. Align elsewhere with start_s, or silence this with `checks: off`"
        )
        out.append(Finding("off_course", text, (CONSISTENT,), rows.size, moving.size, 1, first))
    return out


def _outages_elsewhere(scenario: Replay, first: float, last: float) -> list[str]:
    """Warnings about outages outside the flight, from first to last, s: they have no effect."""
    out = []
    for i, outage in enumerate(scenario.outages):
        spans = _spans(outage)
        away = [f"{begin:g} to {end:g} s" for begin, end in spans if begin <= first or end > last]
        if away:
            flown = f"the replayed part, {first:.1f} to {last:.1f} s"
            out.append(f"outages.{i}: {len(away)} of {len(spans)} are not within {flown}, and not judged: {away[0]}")
    return out


def _spans(outage: Outage) -> list[tuple[float, float]]:
    return [(start, start + length) for length in outage.duration_s for start in outage.start_s]


def _filter(
    draft: ResultBuilder, flown: replay.Replayed, wanted: np.ndarray, names: Sequence[str], units: Sequence[str]
) -> None:
    draft["/filter/time"] = flown.time[wanted]
    draft.put("/filter/state", np.array(names, dtype=object), {"state_units": ", ".join(units)})
    draft["/filter/position_llh"] = flown.navigation[wanted, states.NAV_LLH : states.NAV_VEL]
    draft["/filter/velocity_ned"] = flown.navigation[wanted, states.NAV_VEL : states.NAV_QUAT]
    draft["/filter/attitude_rpy"] = flown.rpy[wanted]
    draft["/filter/sigma"] = flown.sigma[wanted]
    draft["/filter/gyro_bias"] = flown.navigation[wanted, states.NAV_GYRO : states.NAV_ACCEL]
    draft["/filter/accelerometer_bias"] = flown.navigation[wanted, states.NAV_ACCEL : states.NAV_N]


def _innovations(draft: ResultBuilder, flight: replay.RecordedFlight, flown: replay.Replayed) -> None:
    draft["/innovations/time"] = flight.arrival
    for name, part in (("position_ned", slice(0, 3)), ("velocity_ned", slice(3, 6))):
        draft[f"/innovations/{name}"] = flown.innovation[:, part]
        draft[f"/innovations/{name}_sigma"] = flown.innovation_sigma[:, part]
    draft["/innovations/normalized_squared"] = flown.innovation_squared
    draft["/innovations/degrees"] = flown.degrees
    draft["/innovations/status"] = flown.status
    if flight.ranges is None:
        return
    draft["/innovations/source"] = np.array(flight.ranges.names, dtype=object)
    for i, name in enumerate(("range", "range_rate")):
        draft[f"/innovations/{name}"] = flown.range_innovation[..., i]
    draft["/innovations/range_status"] = flown.range_status


def _lost(draft: ResultBuilder, flown: replay.Replayed) -> None:
    draft["/lost/span"] = np.arange(len(flown.lost))
    draft["/lost/start"] = np.array([one.begin for one in flown.lost], dtype=float)
    draft["/lost/end"] = np.array([one.end for one in flown.lost], dtype=float)
    draft["/lost/cause"] = np.array([one.why for one in flown.lost], dtype=object)


def _fixes(draft: ResultBuilder, flight: replay.RecordedFlight) -> None:
    draft["/receiver/time"] = flight.arrival
    draft["/receiver/position_llh"] = flight.llh
    draft["/receiver/velocity_ned"] = flight.velocity


def _outages(draft: ResultBuilder, recording: Recording, flight: replay.RecordedFlight, settings: np.ndarray) -> None:
    beliefs = of_outages(recording.beliefs(settings, FILTER_KINDS[recording.scenario.filter.kind]))
    fix_sigma, range_sigma = recording.fix_sigma(settings), recording.range_sigma(settings)
    rows = []
    for first, last in sorted({span for outage in recording.scenario.outages for span in _spans(outage)}):
        inside = (flight.arrival >= first) & (flight.arrival <= last + 1e-9)
        solved = inside & np.isfinite(flight.llh[:, 0])
        if not solved.any() or first <= flight.imu_time[0] or last > flight.imu_time[-1]:
            rows.append((first, last, np.nan, np.nan))
            continue
        final = int(np.flatnonzero(solved)[-1])
        inside[final] = False  # the innovation of this one is the drift
        flown = replay.fly(flight, beliefs, fix_sigma, np.empty(0), flight.arrival[final], inside, range_sigma)
        north, east, down = flown.innovation[final, :3]
        rows.append((first, last, float(np.hypot(north, east)), float(abs(down))))
    table = np.array(rows).reshape(-1, 4)
    for index, name in enumerate(("start", "end", "horizontal_error", "vertical_error")):
        draft[f"/outages/{name}"] = table[:, index]
    draft["/outages/outage"] = np.arange(table.shape[0])


def of_outages(beliefs: Beliefs) -> Beliefs:
    """The filter model for outages, in which the filter may not know what comes after an outage."""
    return replace(beliefs, kind=TFG if is_smoother(beliefs.kind) else beliefs.kind)


def _summary(draft: ResultBuilder, flight: replay.RecordedFlight, flown: replay.Replayed, moving: float) -> None:
    used = (flown.degrees > 0) & (flown.status != REJECTED)
    groups = {"all": used, "moving": used & (flight.speed > moving)}
    draft.put("/summary/fixes", np.array(list(groups)), moving=f"{moving:.2g} m/s")
    rms = np.array([[_rms(flown.innovation[m][:, i]) for i in range(6)] for m in groups.values()])
    draft["/summary/innovation_position"] = rms[:, :3]
    draft["/summary/innovation_velocity"] = rms[:, 3:]
    nis = [
        float(np.sum(flown.innovation_squared[m]) / np.sum(flown.degrees[m])) if m.any() else np.nan
        for m in groups.values()
    ]
    draft["/summary/nis"] = np.array(nis)
    for name, count in (
        ("samples", flight.imu_time.size),
        ("fixes", flight.arrival.size),
        ("rejected", np.sum(flown.rejected)),
        ("gaps", len(flight.gaps)),
    ):
        draft[f"/summary/count/{name}"] = np.int64(count)
    of = np.round(draft["/outages/end"] - draft["/outages/start"], 9)
    lengths, error = np.unique(of), draft["/outages/horizontal_error"]
    draft["/summary/duration"] = lengths
    for name, function in (("median", np.nanmedian), ("max", np.nanmax)):
        values = np.array([function(error[of == length]) if np.isfinite(error[of == length]).any() else np.nan
                           for length in lengths], dtype=float)  # fmt: skip
        draft[f"/summary/drift_{name}"] = values


def _rms(x: np.ndarray) -> float:
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x**2))) if x.size else np.nan


def extent(recording: Recording) -> int:
    """Steps of progress: flights of the tuning."""
    return EVALUATIONS if recording.free.size else 1
