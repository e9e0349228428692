"""Study of a recorded flight: read, align, tune, filter, evaluate by innovations and outages.

Tuning follows one rule for every flight. Values in the LOG.yaml are kept. The others are set by `replays.tuning` so
that the innovations of the fixes in motion are most likely:

- horizontal and vertical velocity noise of the fixes;
- white noise of gyros and of accelerometers, expected within a factor of two of the sensor class's;
- latency, and that of velocities where another one is clearly likelier;
- size and correlation time of an error of the positions, where such an error is clearly likelier;
- white noise of the positions, where the receiver claims accuracies. The rest of a claim is an error that lasts;
- without claims, at last, white noise and lasting error of the positions, unless the gate then rejects more fixes.

Otherwise the noise of positions is 2.5 s times that of velocities. Without vertical velocities, vertical noise equals
horizontal noise. Fixes closer than 0.45 s share their errors, so the filter uses one of them. Biases are those of the
sensor class, except that a standstill before the flight shows the gyros' turn-on bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign, gate_limits
from navsim.filter.estimate import FILTER_KINDS
from navsim.filter.measurement_kinds import FIX, VehicleTable
from navsim.formats.conventions import FIX_ACCURACIES
from navsim.formats.recorded_data import Fixes, Headings, Ranges, Samples
from navsim.geodesy.attitude import dcm_from_rpy, quaternion_from_dcm
from navsim.ranging.recording import RangeLog
from navsim.recording_checks.fix_checks import lag_of_velocities
from navsim.replays import alignment as aligning
from navsim.replays import flight as replay
from navsim.replays import recorded_flight
from navsim.replays.aids import (
    RecordedAid,
    beacon_errors,
    heading_aid,
    heading_blocks,
    own_noise,
    pieces_at_rest,
    range_aids,
    rest_aids,
    side_slip_aid,
    side_slip_blocks,
)
from navsim.replays.findings import findings, outage_spans, warn_of_headings, warn_of_outages, warn_of_unflown
from navsim.replays.flight_tables import fix_covariance
from navsim.replays.motion import moving_speed
from navsim.replays.one_way import range_clock_blocks, write_clocks
from navsim.replays.reading import LEAST_FIXES, LEAST_SAMPLES, ReplayError, read, thin_times
from navsim.replays.recorded_flight import InertialLog, KnownStart, RecordedFlight
from navsim.replays.result_groups import (
    DILUTION,
    write_aids,
    write_filter,
    write_fixes,
    write_innovations,
    write_lost_spans,
    write_outages,
    write_reference,
    write_summary,
    write_tuning,
    write_white_noise,
)
from navsim.replays.scenario import FixError, KnownSection, Replay
from navsim.replays.tuning import (
    ERROR_SIZE,
    ERROR_TIME,
    HEADING_RATIO,
    LASTING_TIME,
    LATENCY,
    LEVER_ARM,
    POSITION_RATIO,
    SETTINGS,
    VELOCITY_LAG,
    Tuning,
    tune,
)
from navsim.replays.white_noise import standstills
from navsim.results.builder import ResultBuilder
from navsim.results.findings import kept, several
from navsim.results.result import Result
from navsim.results.schema import REPLAY
from navsim.runner.attributes import root_attributes
from navsim.scenario_files.base import DEG, DEG_H, MG
from navsim.scenario_files.source import Document, InputError, Problem
from navsim.sensors.beacons import blocks_of
from navsim.sensors.imu import Triad
from navsim.simulation.inertial_states import followed
from navsim.statistics.rounding import digits

POSITION_TIME = 2.5
"""1 sigma of a position over that of a velocity, s: receivers propagate positions with the velocity."""
UNTOLD = "errors of the positions that last for {}: {}. The position's sigma is without them"
"""What a recording does not show, and why."""
LEAST_LASTING = 0.05
"""Least part of a claimed accuracy that lasts."""
TUNING_INTERVAL = 0.02
"""Interval of the increments that a tuning flies, s."""
STANDSTILL_FACTOR = 5.0
"""Drift of a gyro bias after a standstill, in multiples of its in-run instability."""
_BEFORE = 1.5
"""Intervals before the first sample at which a known state may be: it is of the end of its interval."""
_START = (0.3, 0.3)
"""Velocity noise where the tuning starts, and without tuning, m/s."""
NEVER = 1_000_000_000
"""Rejections in a row that are never reached."""
USUAL_HEADING = 10.0 * DEG
"""1 sigma of heading that a restart of the filter needs, if the log gives the initial heading."""
_TUNED = ("velocity_sigma_horizontal", "velocity_sigma_vertical", "gyro_noise_density", "accelerometer_noise_density",
          "latency", "velocity_lag", "position_sigma_ratio", "error_sigma_ratio", "error_correlation_time",
          "lever_arm_forward", "lever_arm_right", "lever_arm_down", "heading_sigma_ratio")  # fmt: skip
_TUNED_TIGHT = ("range_rate_sigma", "range_sigma", *_TUNED[2:])
_START_TIGHT = (0.1, 1.0)
"""Noise of range rates and ranges overhead where the tuning of a tight filter starts, and without it, m/s, m."""


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
    known: KnownStart | None
    not_judged: tuple[str, ...] = ()
    warnings: list[str] = field(default_factory=list)
    reference: tuple[np.ndarray, np.ndarray] | None = None
    headings: Headings | None = None
    aids: tuple[RecordedAid, ...] = ()
    """Measurements that no setting changes: all but headings."""
    beacons: RangeLog | None = None

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

    def design(self, settings: np.ndarray, kind: int) -> FilterDesign:
        """Model of a filter of `kind` for values of `tuned`."""
        _, _, gyro, accel, latency = settings[:VELOCITY_LAG]
        lag = self.velocity_lag(settings)
        section = self.scenario.filter
        gate = section.gate
        sensors = followed(replace(self.gyro, noise_density=gyro), replace(self.accel, noise_density=accel))
        further = [(block, 1.0) for block in _correlated_blocks(self.errors(settings), self.interval)]
        if self.scenario.side_slip is not None:
            further += side_slip_blocks(self.scenario.side_slip)
        if self.scenario.ranges is not None and self.beacons is not None:
            further += blocks_of(self.beacons.sources.names, beacon_errors(self.scenario.ranges))
            if self.scenario.clocks is not None:
                further += range_clock_blocks(self.beacons.sources.names, self.scenario.clocks)
        if self.scenario.heading is not None and self.headings is not None:
            further += heading_blocks(self.headings, self.scenario.heading, self.interval)
        blocks, sigma = [block for block, _ in further], [sigma for _, sigma in further]
        sensors = replace(sensors, blocks=(*sensors.blocks, *blocks), sigma=(*sensors.sigma, *sigma))
        return FilterDesign(
            kind=kind,
            sensors=sensors,
            velocity=True,
            latency=float(latency) + recorded_flight.fix_delay(float(latency), lag),
            lever_arm=settings[LEVER_ARM],
            sigma_scale=1.0,
            gate=gate_limits(gate.probability),
            max_rejected=NEVER if gate.max_rejected is None else gate.max_rejected,
            components=section.gaussian_sum.components,
            split_heading_sigma=section.gaussian_sum.split_heading_sigma_deg * DEG,
            # without velocities nothing confirms those of the filter
            steady_force=section.steady_force and self.has_velocity,
            clock=self.scenario.gnss.clock.densities() if self.tight else None,
        )

    @cached_property
    def interval(self) -> float:
        """Usual interval of the samples, s."""
        return float(np.median(np.diff(self.samples.time)))

    def fix_sigma(self, settings: np.ndarray) -> np.ndarray:
        """1 sigma of the fixes' position and velocity (6,), north, east, down, m, m/s, for values of `tuned`.

        Of fixes with claimed accuracies, those of a usual one.
        """
        if self.tight:
            return DILUTION * np.repeat(settings[[1, 0]], 3)
        horizontal, vertical = settings[:2]
        velocity = np.array([horizontal, horizontal, vertical if self.has_vertical else horizontal])
        given = self.scenario.gnss.position_sigma_m
        position = settings[POSITION_RATIO] * velocity if given is None else np.array(given)[[0, 0, 1]]
        claimed = self.fixes.usual_accuracy
        if given is None and np.isfinite(claimed[:2]).all():
            position[2] = position[0] * claimed[1] / claimed[0]
        return np.concatenate([position, velocity])

    def range_sigma(self, settings: np.ndarray) -> tuple[float, float]:
        """1 sigma of pseudoranges, m, and range rates, m/s, overhead, for values of `tuned` of a tight filter."""
        return float(settings[1]), float(settings[0])

    def errors(self, settings: np.ndarray) -> Sequence[FixError]:
        """Time-correlated errors of the fixes: those of the log, or the one of these values of `tuned`."""
        if not settings[ERROR_SIZE] > 0.0:
            return self.scenario.gnss.errors
        white = self.fix_sigma(settings)[[0, 2]]
        horizontal, vertical = settings[ERROR_SIZE] * white
        if self.claimed:
            whole = settings[ERROR_SIZE] * self.fixes.usual_accuracy[:2]
            horizontal, vertical = np.sqrt(np.maximum(whole**2 - white**2, (LEAST_LASTING * whole) ** 2))
        return [FixError(correlation_time_s=settings[ERROR_TIME], position_sigma_m=(horizontal, vertical))]

    @property
    def claimed(self) -> bool:
        """Whether the accuracies that the receiver claims tell how large the lasting part of its errors is."""
        return bool(self.settings[ERROR_SIZE] > 0.0)

    def unknown_errors(self, settings: np.ndarray) -> tuple[str, ...]:
        """Errors of the fixes that neither the recording nor the log tells, for values of `tuned`."""
        if self.tight or self.claimed or self.scenario.gnss.errors or self.fixes.has_own_noise:
            return ()
        claims = zip(FIX_ACCURACIES[:2], self.fixes.usual_accuracy, strict=False)
        if missing := [name for name, usual in claims if np.isnan(usual)]:
            why = f"the fixes have no {' and no '.join(missing)}, and no innovation shows them"
            shorter = settings[ERROR_SIZE] > 0.0
            long = f"much longer than the {settings[ERROR_TIME]:.0f} s of the tuned error" if shorter else "minutes"
            return (UNTOLD.format(long, why),)
        why = "the accuracies of the fixes count as white noise, since nothing tunes the rest"
        return (UNTOLD.format("minutes", why),)

    def velocity_lag(self, settings: np.ndarray) -> float:
        """How much older velocities are than positions, s, for values of `tuned`."""
        given = self.scenario.gnss.velocity_latency_s
        return float(settings[VELOCITY_LAG] if given is None else given - settings[LATENCY])

    def flight(self, settings: np.ndarray, coarse: bool = False) -> RecordedFlight:
        """The increments and fixes after the alignment, for values of `tuned`; coarse: for the tuning."""
        ranges = self.ranges if self.tight else None
        patience = self.scenario.filter.gate.restart_s
        fixes = self.fixes
        if settings[ERROR_SIZE] > 0.0:
            fixes = _with_effects(fixes, self.errors(settings))
            if self.claimed and fixes.effect is not None:
                fixes = replace(fixes, effect=fixes.weight[:, :, None] * fixes.effect)
        # what is at rest or on wheels says nothing of the noise of fixes and sensors
        aids = () if coarse else self.aids
        if self.scenario.heading is not None and self.headings is not None:
            aids = (*aids, heading_aid(self.headings, self.scenario.heading, settings[HEADING_RATIO]))
        flight = recorded_flight.prepare(
            self._coarse if coarse else self._sensed, fixes, self.alignment, settings[LATENCY], ranges,
            self._realigned, patience, self.known, self.velocity_lag(settings),
        )  # fmt: skip
        return replace(flight, aids=aids)

    def of_rejected(self, settings: np.ndarray, flight: RecordedFlight) -> np.ndarray:
        """Contribution of each rejected fix of a flight (m,), or of any range (), to the tuning.

        It equals that of a fix at the limit of the gate, with its own noise or, without one, that of `settings`.
        Noise that makes the gate reject fixes thus gains nothing.
        """
        limits = gate_limits(self.scenario.filter.gate.probability)
        if self.tight:
            sigma = settings[:2]
        else:
            own = fix_covariance(flight.covariance, self.fix_sigma(settings) * flight.weight)
            sigma = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
        limit = float(limits[sigma.shape[-1]])
        counts = 0.5 * limit + np.sum(np.log(sigma), axis=-1)
        return np.asarray(counts if np.isfinite(limit) else np.zeros_like(counts))

    def _realigned(self, time: float) -> aligning.Alignment | None:
        """The next alignment at or after `time`, s, under way or at a standstill; no setting changes it."""
        if time not in self._alignments:
            self._alignments[time] = aligning.find_alignment(self.samples, self.valid_fixes, time, self.search)
        return self._alignments[time]

    @cached_property
    def _alignments(self) -> dict[float, aligning.Alignment | None]:
        return {}

    @cached_property
    def valid_fixes(self) -> Fixes:
        """The fixes at their times of validity, untuned."""
        return self.fixes.earlier(self.settings[LATENCY] + self.velocity_lag(self.settings))

    @cached_property
    def moving_speed(self) -> float:
        """Speed, m/s, from which on a fix of the flight is in motion."""
        flight = self.flight(self.settings)
        return moving_speed(flight.speed, not np.isfinite(flight.velocity[:, :2]).any())

    @cached_property
    def _coarse(self) -> InertialLog:
        """The increments that a tuning flies hundreds of times: by fewer of them it finds the same within its
        tolerance."""
        return recorded_flight.sum_intervals(self._sensed, TUNING_INTERVAL)

    @cached_property
    def _sensed(self) -> InertialLog:
        """The increments, which no setting changes."""
        averaged = self.scenario.imu.samples != "instantaneous"
        return recorded_flight.increments(self.samples, self.alignment.time, self.longest_gap, averaged)


def prepare(scenario: Replay, document: Document) -> Recording:
    """Read, check and align. Raises InputError as `read`, ReplayError where no alignment is found."""
    log = read(scenario, document)
    scenario, ranges, warnings = log.scenario, log.ranges, log.warnings
    samples, fixes, first = _wanted(scenario, document, log.samples, log.fixes)
    fixes = _with_effects(fixes, scenario.gnss.errors)
    if ranges is not None:
        apart = thin_times(ranges.time, scenario.gnss.spacing_s)
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
    ratio, claimed = POSITION_TIME, fixes.usual_accuracy
    if not tight and np.isfinite(claimed[2]) and gnss.velocity_sigma_m_s is None:
        velocity = (claimed[2], claimed[2])
    if np.isfinite(claimed[:2]).all():
        ratio = claimed[0] / velocity[0]
    settings = np.array(
        [*velocity, gyro.noise_density, accel.noise_density, latency, 0.0, ratio, 0.0, LASTING_TIME,
         *gnss.lever_arm_m, 1.0]
    )  # fmt: skip
    aligned_by = latency if gnss.velocity_latency_s is None else gnss.velocity_latency_s
    given_noise = (scenario.imu.gyro.arw_deg_sqrt_h, scenario.imu.accelerometer.vrw_m_s_sqrt_h)
    free = np.zeros(SETTINGS, bool)
    free[: LATENCY + 1] = *open_noise, *(v is None for v in given_noise), gnss.latency_s is None
    free[POSITION_RATIO] = not tight and gnss.position_sigma_m is None and np.isfinite(claimed[:2]).all()
    free[HEADING_RATIO] = scenario.heading is not None and scenario.heading.sigma_deg is None
    free &= scenario.tuning == "likelihood"
    if free[POSITION_RATIO] and not gnss.errors:
        settings[ERROR_SIZE] = 1.0
        free[[ERROR_SIZE, ERROR_TIME]] = True
    if gnss.navigation is not None:
        free[LATENCY] = False  # observations are stamped with the time they are valid
    has_vertical = bool(np.isfinite(fixes.velocity[:, 2]).any())
    if not tight and gnss.velocity_sigma_m_s is None and not has_vertical:
        free[1] = False  # the data do not show it; `design` ties it to the horizontal one
    search = replace(_search(scenario, gyro, accel), headings=log.headings)
    known = None if scenario.alignment.known is None else _known_start(scenario.alignment.known)
    aligned = _align(search, samples, fixes.earlier(aligned_by), first) if known is None else known.alignment
    # a heading that is known is that of the start
    again = search if search.heading is None else replace(search, heading=None, heading_sigma=USUAL_HEADING)
    if np.sum(samples.time > aligned.time) < 2 or not np.any(fixes.time > aligned.time):
        raise ReplayError(f"the recording ends with its alignment, at {aligned.time:.12g} s")
    warnings += warn_of_unflown(scenario, log, first, aligned)
    warnings += warn_of_outages(scenario, aligned.time, float(samples.time[-1]))
    warnings += warn_of_headings(log.headings, aligned.time, float(samples.time[-1]))
    density = gyro.noise_density, accel.noise_density
    aids = _aids(scenario, samples, fixes.earlier(aligned_by), search, density, max(velocity))
    if scenario.ranges is not None and log.beacons is not None:
        aids = (*aids, *range_aids(log.beacons, scenario.ranges))
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
        log.reference,
        log.headings,
        aids,
        log.beacons,
    )


def _aids(
    scenario: Replay,
    samples: Samples,
    fixes: Fixes,
    search: aligning.Search,
    density: tuple[float, float],
    speed_sigma: float,
) -> tuple[RecordedAid, ...]:
    """Measurements of a vehicle at rest and on wheels. Fixes' times are those of validity; density: of the white noise
    of gyros and accelerometers of the class; speed_sigma: of a fix, m/s."""
    if scenario.standstill is None and scenario.side_slip is None:
        return ()
    filled = fixes.with_velocity()[0]
    own = own_noise(standstills(samples, filled, search), density, float(np.median(np.diff(samples.time))), search)
    rests = pieces_at_rest(samples, filled, own, speed_sigma) if scenario.standstill is not None else np.empty((0, 2))
    out, like = [], VehicleTable.none()
    if scenario.side_slip is not None:
        out.append(side_slip_aid(samples, rests, scenario.side_slip))
        assert isinstance(out[0].table, VehicleTable)
        like = out[0].table
    if scenario.standstill is not None:
        out += rest_aids(samples, rests, own, scenario.standstill, like)
    return tuple(out)


def _search(scenario: Replay, gyro: Triad, accel: Triad) -> aligning.Search:
    """Requirements and assumptions of the initial alignment."""
    wanted = scenario.alignment
    return aligning.Search(
        None if wanted.heading_deg is None else wanted.heading_deg * DEG, wanted.heading_sigma_deg * DEG,
        wanted.longest_s, gyro.initial_sigma(), STANDSTILL_FACTOR * gyro.markov, accel.initial_sigma(),
    )  # fmt: skip


def _correlated_blocks(errors: Sequence[FixError], step: float) -> list[states.Block]:
    """States for time-correlated errors of fixes, in groups of three; step: of the filter, s."""
    out: list[states.Block] = []
    for error in errors:
        for _ in range(0, error.states or 3, 3):
            name, numbered = f"fix_error_{len(out) + 1}", error.states is not None
            out.append(states.correlated_triple(name, FIX, error.correlation_time_s, step, 3 * len(out), numbered))
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


def _known_start(section: KnownSection) -> KnownStart:
    """The state of the navigation that a log gives."""
    navigation = np.zeros(states.NAV_N)
    navigation[states.NAV_LLH : states.NAV_VEL] = section.lat_deg * DEG, section.lon_deg * DEG, section.height_m
    navigation[states.NAV_VEL : states.NAV_QUAT] = section.velocity_m_s
    attitude = dcm_from_rpy(np.array(section.attitude_deg) * DEG)
    navigation[states.NAV_QUAT : states.NAV_BIAS_FRAME] = quaternion_from_dcm(attitude)
    navigation[states.NAV_GYRO : states.NAV_ACCEL] = np.array(section.gyro_bias_deg_h) * DEG_H
    navigation[states.NAV_ACCEL : states.NAV_N] = np.array(section.accelerometer_bias_mg) * MG
    attitude_sigma = np.array(section.attitude_sigma_deg) * DEG
    sigma = np.concatenate([section.position_sigma_m, section.velocity_sigma_m_s, attitude_sigma])
    return KnownStart(section.time_s, navigation, sigma)


def _align(search: aligning.Search, samples: Samples, fixes: Fixes, first: float) -> aligning.Alignment:
    """Earliest alignment: at the end of a standstill, or under way. Raises ReplayError if there is none."""
    found = aligning.find_alignment(samples, fixes, first, search)
    if found is not None:
        return found
    if search.heading is not None:
        raise ReplayError(
            f"alignment.heading_deg needs a standstill at the start, and there is none in the {aligning.LONGEST:g} s "
            f"from {first:.12g} s on; leave it out, or let start_s begin where the aircraft is at rest"
        )
    lasts = min(search.longest, float(samples.time[-1]) - first)
    text = f"no alignment: nowhere after {first:.12g} s do {digits(lasts)} s of motion give the heading to "
    text += f"{np.degrees(search.heading_sigma):g} degrees"
    lag = lag_of_velocities(fixes)
    if np.isfinite(lag):
        older = "older" if lag > 0.0 else "newer"
        text += f", and the velocities of the fixes are {abs(lag):.1f} s {older} than their positions. Give "
        raise ReplayError(f"{text}gnss.velocity_latency_s, which is that much {'more' if lag > 0.0 else 'less'} than "
                          "gnss.latency_s, or leave out the columns of velocity")  # fmt: skip
    raise ReplayError(f"{text}; allow more with alignment.heading_sigma_deg, give alignment.heading_deg, "
                      "a table of headings (`heading`), or gnss.latency_s where fixes come seconds late")  # fmt: skip


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
        text = f"the recordings have in common only {too_few}" if overlap else "the recordings have no common time"
        raise InputError([refused(key, f"{text} ({spans})")])
    start, end = scenario.begin, scenario.end_s
    begins = "start_s" if known is None else "alignment.known.time_s"
    of_samples, of_fixes, first, too_few = part(start, end)
    if too_few:
        given = {key: value for key, value in ((begins, start), ("end_s", end)) if value is not None}
        alone = {begins: part(start, None)[-1], "end_s": part(None, end)[-1]}
        to_blame = [key for key in given if alone[key]] or list(given)
        message = f"leaves {too_few} ({spans})"
        raise InputError([refused(key, f"{given[key]:.12g} {message}") for key in to_blame])
    interval = float(np.median(np.diff(samples.time)))
    if known is not None and first < s_begin - _BEFORE * interval:
        late = f"give the state at a time from {s_begin:.12g} s on"
        message = f"{first:.12g} s is before the first sample ({spans}); {late}"
        raise InputError([refused(begins, message)])
    apart = of_fixes.take(thin_times(of_fixes.time, scenario.gnss.spacing_s))
    common = int(np.sum(apart.time >= first))
    if common < LEAST_FIXES:
        message = f"{scenario.gnss.spacing_s:g} leaves {several(common, 'fix')}; needed are {LEAST_FIXES} ({spans})"
        raise InputError([refused("gnss.spacing_s", message)])
    return of_samples, apart, first


def compute(
    recording: Recording,
    done: Callable[[int], None] = lambda _: None,
    tuning: Tuning | None = None,
    write_more: Callable[[ResultBuilder], None] = lambda _: None,
) -> Result:
    """Tune unless that was done, fly, impose the outages, write more groups. Raises ReplayError where a smoother
    fails."""
    scenario = recording.scenario
    tuning = tune(recording, done) if tuning is None else tuning
    settings = tuning.settings
    kind = FILTER_KINDS[scenario.filter.kind]
    flight, design = recording.flight(settings), recording.design(settings, kind)
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
            for first, last in outage_spans(outage):
                withheld |= (flight.arrival >= first) & (flight.arrival <= last)
    try:
        flown = replay.fly(
            flight, design, fix_sigma, times, withheld=withheld, range_sigma=recording.range_sigma(settings)
        )
    except ArithmeticError as error:
        raise ReplayError(str(error)) from None
    scales = [] if flight.ranges is None else [flight.ranges.scales[clock] for clock in flight.ranges.clocks]
    blocks = design.sensors.blocks
    names = states.names(blocks, scales), states.units(blocks, len(scales))
    draft = ResultBuilder(REPLAY, {"mixed": ", ".join(dict.fromkeys(names[1]))})
    write_filter(draft, flown, np.isin(flown.time, times), *names, tuning.latency_sigma)
    write_innovations(draft, flight, flown)
    write_outages(draft, recording, flight, settings)
    write_lost_spans(draft, flown)
    if recording.reference is not None:
        write_reference(draft, flown, *recording.reference)
    write_fixes(draft, flight)
    write_tuning(draft, recording, tuning)
    write_white_noise(draft, recording)
    write_summary(draft, flight, flown, recording.moving_speed)
    beacons = () if recording.beacons is None else recording.beacons.sources.names
    write_aids(draft, flight, flown, recording.moving_speed, beacons)
    if beacons and scenario.clocks is not None:
        write_clocks(draft, flown, np.isin(flown.time, times), design.sensors, beacons, scenario.clocks)
    write_more(draft)
    alignment = recording.alignment
    out = draft.result(
        root_attributes(
            "replay", 0, scenario, alignment_time=alignment.time, alignment_until=alignment.until,
            alignment_sigma_deg=np.degrees(np.sqrt(np.diag(alignment.covariance))),
            recorded_s=recording.recorded, flown_s=(flight.imu_time[0], flight.imu_time[-1]),
            not_judged="; ".join([*recording.not_judged, *recording.unknown_errors(settings)]),
        )
    )  # fmt: skip
    out.variables.update(kept([*tuning.findings, *findings(recording, out, withheld, flight, flown)]))
    return out
