"""Groups of the result of a replay: filter, innovations, lost spans, fixes, outages, summary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign
from navsim.filter.estimate import FILTER_KINDS, is_smoother
from navsim.filter.measurement_kinds import HEADING
from navsim.filter.records import REJECTED, TFG, USED
from navsim.replays import flight as replay
from navsim.replays.findings import VELOCITY_SIGMA, outage_spans
from navsim.replays.motion import in_motion, lag1_correlation, turn_rate
from navsim.replays.recorded_flight import RecordedFlight
from navsim.replays.tuning import (
    ERROR_SIZE,
    HEADING_RATIO,
    LATENCY,
    POSITION_RATIO,
    TIMES,
    VELOCITY_LAG,
    Tuning,
)
from navsim.replays.white_noise import standstills, white_noise
from navsim.results.builder import ResultBuilder
from navsim.sensors.beacons import Beacons
from navsim.statistics.importance_sampling import TWO_SIDED
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.replays.study import Recording

DILUTION = 3.0
"""1 sigma of a fix in that of a range, for the start of a tight filter and the innovations of fixes."""
DETERMINED = 1.5
"""Factor beyond which the 95 % interval of a tuned number is told."""
UNDETERMINED = 100.0
"""Factor of that interval beyond which the flight does not show a number at all."""
TURNING = np.radians(5.0)
"""Rate of rotation, rad/s, above which an aircraft turns."""


def write_filter(
    draft: ResultBuilder,
    flown: replay.Replayed,
    wanted: np.ndarray,
    names: Sequence[str],
    units: Sequence[str],
    latency_sigma: float,
) -> None:
    """The outputs. An error of the latency, of this 1 sigma, s, moves all positions along the flight, and no innovation
    shows it; the sigma of position includes it."""
    draft["/filter/time"] = flown.time[wanted]
    draft.put("/filter/state", np.array(names, dtype=object), {"state_units": ", ".join(units)})
    draft["/filter/position_llh"] = flown.navigation[wanted, states.NAV_LLH : states.NAV_VEL]
    draft["/filter/velocity_ned"] = flown.navigation[wanted, states.NAV_VEL : states.NAV_QUAT]
    draft["/filter/attitude_rpy"] = flown.rpy[wanted]
    sigma = flown.sigma[wanted]
    position = slice(states.POS, states.VEL)
    sigma[:, position] = np.hypot(sigma[:, position], latency_sigma * draft["/filter/velocity_ned"])
    draft["/filter/sigma"] = sigma
    draft["/filter/gyro_bias"] = flown.navigation[wanted, states.NAV_GYRO : states.NAV_ACCEL]
    draft["/filter/accelerometer_bias"] = flown.navigation[wanted, states.NAV_ACCEL : states.NAV_N]


def write_innovations(draft: ResultBuilder, flight: RecordedFlight, flown: replay.Replayed) -> None:
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


def write_aids(
    draft: ResultBuilder, flight: RecordedFlight, flown: replay.Replayed, moving: float, beacons: tuple[str, ...]
) -> None:
    """Innovations of the measurements beside the fixes, by the motion at the next fix, and biases of these beacons."""
    if not flight.aids:
        return
    groups = _by_motion(flight, moving)
    draft["/summary/aid"] = np.array([aid.name for aid in flight.aids], dtype=object)
    nis = np.full((len(flight.aids), len(groups)), np.nan)
    for i, (aid, own) in enumerate(zip(flight.aids, flown.aids, strict=True)):
        at = np.searchsorted(flight.arrival, aid.time).clip(max=flight.arrival.size - 1)
        for k, group in enumerate(groups.values()):
            counted = (own.status == USED) & group[at]
            if counted.any():
                nis[i, k] = np.sum(own.innovation_squared[counted]) / np.sum(own.degrees[counted])
        if aid.kind == HEADING:
            draft["/heading/time"] = aid.time
            draft["/heading/innovation"] = own.innovation[:, 0]
            draft["/heading/innovation_sigma"] = own.innovation_sigma[:, 0]
            draft["/heading/status"] = own.status
    for name, status in (("used", USED), ("rejected", REJECTED)):
        draft[f"/summary/aid_{name}"] = np.array([np.sum(own.status == status) for own in flown.aids], dtype=np.int64)
    draft["/summary/aid_nis"] = nis
    every = list(draft["/filter/state"])
    if biases := [every.index(state) for name in beacons if (state := f"{Beacons.name}_bias_{name}") in every]:
        draft["/summary/beacon"] = np.array(beacons, dtype=object)
        of_states = np.array(biases) - states.SENSORS + states.NAV_SENSORS
        draft["/summary/beacon_bias"] = flown.navigation[-1, of_states]
        draft["/summary/beacon_bias_sigma"] = flown.sigma[-1, biases]


def _by_motion(flight: RecordedFlight, moving: float) -> dict[str, np.ndarray]:
    """Which fixes (m,) are in each motion; moving: speed, m/s, from which on a fix is in motion."""
    fast, turning = in_motion(flight, moving), turn_rate(flight) > TURNING
    return {"all": np.ones(fast.size, bool), "moving": fast, "parked": ~fast, "straight": fast & ~turning,
            "turning": fast & turning}  # fmt: skip


CLAIMED = ("position_error_horizontal", "position_error_vertical")
_STEP = 1e-4
"""Step of a setting for the derivatives of what follows from it: s, or of the logarithm."""


def write_tuning(draft: ResultBuilder, recording: Recording, tuning: Tuning) -> None:
    """Noise, latencies and errors of the fixes, where each comes from, and how well the flight shows it."""
    settings, free = tuning.settings, tuning.tuned
    spreads, gnss = _spreads(recording, tuning), recording.scenario.gnss
    given = {"position_sigma": gnss.position_sigma_m is not None,
             "velocity_latency": gnss.velocity_latency_s is not None}  # fmt: skip
    for name, value in _numbers(recording, settings).items():
        spread = spreads[name]
        origin = tuning.origin
        if spread != 0.0:
            origin = "tuned to the innovations"
            if recording.claimed and free[ERROR_SIZE] and name in CLAIMED:
                origin = "accuracies of the receiver, less the noise"
            origin += _uncertainty(spread, name.endswith("latency"))
        if recording.fixes.has_own_noise and "_sigma_" in name:
            origin = "not used: each fix has its own"
        elif any(name.startswith(key) and there for key, there in given.items()):
            origin = "given"
        elif name.startswith("position_sigma") and not free[POSITION_RATIO]:
            origin = f"{settings[POSITION_RATIO]:g} s {VELOCITY_SIGMA}"
            if recording.scenario.tuning == "none" and np.isfinite(recording.fixes.usual_accuracy[:2]).all():
                origin = "accuracies of the fixes"
        elif name == "velocity_latency" and not free[VELOCITY_LAG]:
            origin = "as latency"
        draft.put(f"/tuning/{name}", value, {"origin": origin})


def _uncertainty(spread: float, is_time: bool) -> str:
    """Words on the 1 sigma of a tuned number: of a time s, of others of the logarithm, nan if unknown."""
    if np.isnan(spread):
        return ""
    if is_time:
        return f", 1 sigma {digits(spread, 2)} s"
    wide = float(np.exp(TWO_SIDED * spread))
    if wide > UNDETERMINED:
        return f", not determined: 95 % within a factor of more than {UNDETERMINED:g}"
    if wide > DETERMINED:
        return f", hardly determined: 95 % within a factor of {wide:.2g}"
    return f", 1 sigma {digits(100.0 * np.expm1(spread), 2)} %"


def _numbers(recording: Recording, settings: np.ndarray) -> dict[str, float]:
    """Noise, latencies and errors of the fixes by name, SI, for values of `Recording.tuned`."""
    out = dict(zip(recording.tuned[:VELOCITY_LAG], settings[:VELOCITY_LAG], strict=True))
    if not recording.tight:
        sigma = recording.fix_sigma(settings)
        out |= {
            "velocity_sigma_vertical": sigma[5], "position_sigma_horizontal": sigma[0],
            "position_sigma_vertical": sigma[2],
            "velocity_latency": settings[LATENCY] + recording.velocity_lag(settings),
        }  # fmt: skip
        if settings[ERROR_SIZE] > 0.0:
            (error,) = recording.errors(settings)
            out["position_error_time"] = error.correlation_time_s
            out |= dict(zip(CLAIMED, error.position_sigma_m or (), strict=True))
    if recording.headings is not None:
        out["heading_sigma"] = settings[HEADING_RATIO] * float(np.median(recording.headings.sigma))
    return out


def _spreads(recording: Recording, tuning: Tuning) -> dict[str, float]:
    """1 sigma by which the flight shows each of `_numbers`, to first order: of latencies s, of others of the logarithm;
    0 where it is not tuned, nan where unknown."""

    def logarithm(x: float) -> float:
        return math.log(x) if x > 0.0 else -math.inf

    def searched(settings: np.ndarray) -> dict[str, float]:
        numbers = _numbers(recording, settings).items()
        return {name: x if name.endswith("latency") else logarithm(x) for name, x in numbers}

    free = np.flatnonzero(tuning.tuned)
    ends = []
    for i in free:
        moved = [tuning.settings.copy(), tuning.settings.copy()]
        for settings, step in zip(moved, (_STEP, -_STEP), strict=True):
            settings[i] = settings[i] + step if TIMES[i] else settings[i] * np.exp(step)
        ends.append([searched(settings) for settings in moved])
    out = {}
    for name in _numbers(recording, tuning.settings):
        pairs = [(up[name], down[name]) for up, down in ends]
        slope = np.array([0.0 if up == down else (up - down) / (2.0 * _STEP) for up, down in pairs])
        of = free[slope != 0.0]
        share = slope[slope != 0.0] * tuning.spread[of]
        out[name] = float(np.sqrt(share @ tuning.correlation[np.ix_(of, of)] @ share))
    return out


def write_white_noise(draft: ResultBuilder, recording: Recording) -> None:
    """White noise of the sensors, of a standstill, or of the log or the class where none shows it."""
    rests = standstills(recording.samples, recording.valid_fixes.with_velocity()[0], recording.search)
    imu = recording.scenario.imu
    for name, of, triad, given in (
        ("gyro", "rate", recording.gyro, imu.gyro.arw_deg_sqrt_h),
        ("accelerometer", "force", recording.accel, imu.accelerometer.vrw_m_s_sqrt_h),
    ):
        of_class = f"no rest shows it; imu.sensor_class: {imu.sensor_class}"
        sheet = triad.noise_density, of_class if given is None else "given"
        density, origin = white_noise(recording.samples, rests, of) or sheet
        draft.put(f"/tuning/{name}_white_noise", density, {"origin": origin})


def write_lost_spans(draft: ResultBuilder, flown: replay.Replayed) -> None:
    draft["/lost/span"] = np.arange(len(flown.lost))
    draft["/lost/start"] = np.array([one.begin for one in flown.lost], dtype=float)
    draft["/lost/end"] = np.array([one.end for one in flown.lost], dtype=float)
    draft["/lost/cause"] = np.array([one.why for one in flown.lost], dtype=object)


def write_reference(draft: ResultBuilder, flown: replay.Replayed, time: np.ndarray, rpy: np.ndarray) -> None:
    """Attitude by another system at the outputs, nan where it says nothing, and the filter's minus it where usable."""
    at = draft["/filter/time"]
    theirs = np.stack([np.interp(at, time, np.unwrap(angle)) for angle in rpy.T], axis=1)
    theirs[(at < time[0]) | (at > time[-1])] = np.nan
    draft["/filter/reference_attitude_rpy"] = np.angle(np.exp(1j * theirs))
    usable = np.isfinite(theirs).all(axis=1)
    for one in flown.lost:
        usable &= (at < one.begin) | (at > one.end)
    apart = np.exp(1j * (draft["/filter/attitude_rpy"] - theirs)[usable])
    middle = np.angle(apart.sum(axis=0)) if apart.size else np.full(3, np.nan)
    draft["/summary/attitude_difference_mean"] = middle
    left = np.angle(apart * np.exp(-1j * middle))
    draft["/summary/attitude_difference_scatter"] = np.array([_rms(each) for each in left.T])


def write_fixes(draft: ResultBuilder, flight: RecordedFlight) -> None:
    draft["/receiver/time"] = flight.arrival
    draft["/receiver/position_llh"] = flight.llh
    draft["/receiver/velocity_ned"] = flight.velocity


def write_outages(draft: ResultBuilder, recording: Recording, flight: RecordedFlight, settings: np.ndarray) -> None:
    design = of_outages(recording.design(settings, FILTER_KINDS[recording.scenario.filter.kind]))
    fix_sigma, range_sigma = recording.fix_sigma(settings), recording.range_sigma(settings)
    rows = []
    for span in sorted({span for outage in recording.scenario.outages for span in outage_spans(outage)}):
        found = drift_in_outage(flight, design, fix_sigma, range_sigma, span)
        if found is None:
            rows.append((*span, *(np.nan,) * 3))
            continue
        (north, east, down), sigma = found
        nees = float(np.mean((np.array([north, east]) / sigma[:2]) ** 2))
        rows.append((*span, float(np.hypot(north, east)), float(abs(down)), nees))
    table = np.array(rows).reshape(-1, 5)
    for index, name in enumerate(("start", "end", "horizontal_error", "vertical_error", "nees")):
        draft[f"/outages/{name}"] = table[:, index]
    draft["/outages/outage"] = np.arange(table.shape[0])


def drift_in_outage(
    flight: RecordedFlight,
    design: FilterDesign,
    fix_sigma: np.ndarray,
    range_sigma: tuple[float, float],
    span: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray] | None:
    """Last fix of an outage minus its prediction without the fixes before, (3,) NED, m, and its 1 sigma (3,).

    design: as of `of_outages`. span: begin and end, s. None without a fix, or outside the flight.
    """
    first, last = span
    inside = (flight.arrival >= first) & (flight.arrival <= last + 1e-9)
    solved = inside & np.isfinite(flight.llh[:, 0])
    if not solved.any() or first <= flight.imu_time[0] or last > flight.imu_time[-1]:
        return None
    final = int(np.flatnonzero(solved)[-1])
    inside[final] = False  # the innovation of this one is the drift
    velocity = flight.velocity.copy()
    velocity[final] = np.nan  # an older one would come before the drift is read
    judged = replace(flight, velocity=velocity)
    flown = replay.fly(judged, design, fix_sigma, np.empty(0), flight.arrival[final], inside, range_sigma)
    return flown.innovation[final, :3], flown.innovation_sigma[final, :3]


def of_outages(design: FilterDesign) -> FilterDesign:
    """The filter model for outages, in which the filter may not know what comes after an outage."""
    return replace(design, kind=TFG if is_smoother(design.kind) else design.kind)


def write_summary(draft: ResultBuilder, flight: RecordedFlight, flown: replay.Replayed, moving: float) -> None:
    used = (flown.degrees > 0) & (flown.status != REJECTED)
    groups = {name: used & group for name, group in _by_motion(flight, moving).items()}
    draft.put("/summary/motion", np.array(list(groups)), moving=f"{digits(moving, 2)} m/s")
    rms = np.array([[_rms(flown.innovation[m][:, i]) for i in range(6)] for m in groups.values()])
    draft["/summary/innovation_position"] = rms[:, :3]
    draft["/summary/innovation_velocity"] = rms[:, 3:]
    nis = [
        float(np.sum(flown.innovation_squared[m]) / np.sum(flown.degrees[m])) if m.any() else np.nan
        for m in groups.values()
    ]
    draft["/summary/nis"] = np.array(nis)
    draft["/summary/degrees_of_freedom"] = np.array([int(flown.degrees[m].sum()) for m in groups.values()])
    draft["/summary/motion_fixes"] = np.array([int(m.sum()) for m in groups.values()])
    scaled = flown.innovation / flown.innovation_sigma
    for name, part in (("position", scaled[:, :3]), ("velocity", scaled[:, 3:])):
        draft[f"/summary/nis_{name}"] = np.array([_rms(part[m]) ** 2 for m in groups.values()])
        draft[f"/summary/lag1_{name}"] = lag1_correlation(part[groups["moving"]])
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
    nees = draft["/outages/nees"]
    draft["/summary/drift_nees"] = np.array([_rms(np.sqrt(nees[of == length])) ** 2 for length in lengths], dtype=float)


def _rms(x: np.ndarray) -> float:
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x**2))) if x.size else np.nan
