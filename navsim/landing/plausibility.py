"""Input within its bounds that no aircraft, sensor or site has: warnings of a landing before it is flown.

Likely causes are a wrong unit, a wrong sign, swapped keys, or a copied line. A flight can be computed all the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from navsim.geodesy.earth import ecef_from_llh
from navsim.results.notes import CONSISTENT, SIGMA_WITH_BEACONS, Note
from navsim.scenario.approach import PaperApproach, SmoothApproach, WaypointApproach
from navsim.scenario.estimated_errors import about_transmitter_errors
from navsim.scenario.landing import Landing
from navsim.scenario_files.presets import BEACON_PRESETS, BEACON_UNVERIFIED
from navsim.statistics.rounding import digits
from navsim.trajectory.approach import ROLL_OUT, TOUCHDOWN
from navsim.trajectory.kinematics import Moving, Trajectory

LONGEST_ARM = 50.0
"""Length of a lever arm, m, that the largest airliners reach."""
STRONG_WIND = 0.6
"""Wind over airspeed beyond which it is doubted: in a crosswind, a crab of 37 deg."""
REVOLUTION = 360.0
"""Turn of the computed attitude by a gyro's constant drift within a flight, deg, beyond which the drift is doubted."""
GRAVITY_MG = 1000.0
"""Bias of an accelerometer, mg, as large as gravity."""
WANDERED = 2.0
"""Clock error at the end of a flight over the range error at its begin, beyond which fixes that are weighted each for
itself are doubted."""
MANY_OUTLIERS = 0.1
"""Fraction of outliers among ranges of beacons beyond which the filter's sigma is doubted: it has its gate alone."""
NOISY = 30.0
"""Noise of single ranges of beacons over the sigma of their lasting errors beyond which it is doubted; 0.35 of measured
ultra-wideband modules."""
LEAST_ANGLE = 2.0
"""Angle between two pseudolites, or beacons, as the antenna sees them, deg, below which the second adds no geometry."""
UNDULATION_ERROR = 5.0
"""Difference of a geoid undulation from that of EGM96, m, beyond which it is doubted: other models are closer."""
EXPOSURE = 150.0
"""Time, s, of an approach to LPV minima that levels are for; errors that last as long occur once."""
_LEAST_CLOCK_NS = 1e-3
"""Error of a pseudolite's clock, ns, below which its unit is doubted: 0.3 mm."""
_STEP = 0.5
"""Between times of the flight that are looked at, s."""


def plausibility_warnings(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warnings of values that no aircraft, sensor, wind or runway has."""
    return [
        *_lever_arms(scenario), *_drifts(scenario), *_speeds(scenario), *_wind(scenario, trajectory),
        *_undulation(scenario, trajectory), *free_clocks(scenario), *_beacons(scenario), *_repeated_noise(scenario),
        *_errors_beyond_levels(scenario), *_levels_of_others(scenario), *_clock_in_seconds(scenario),
    ]  # fmt: skip


def _beacons(scenario: Landing) -> Iterator[str]:
    """Beacons with a filter that has no use for them, or no model of their outliers."""
    section, kind, too_small = scenario.beacons, scenario.filter.kind, (SIGMA_WITH_BEACONS, (CONSISTENT,))
    if section is None:
        return
    lasting = math.hypot(section.bias_sigma_m, section.growth_sigma_m)
    if section.sigma_m > NOISY * lasting > 0.0:
        yield (
            f"beacons.sigma_m: a noise of {section.sigma_m:g} m is {section.sigma_m / lasting:.0f} times what differs "
            f"between beacons for long, {digits(lasting)} m (bias_sigma_m, growth_sigma_m); of measured modules it "
            "is a third of that. Give metres, not centimetres"
        )
    key = BEACON_UNVERIFIED.get(section.preset)
    if key is not None and getattr(section, key) == (value := BEACON_PRESETS[section.preset][key]):
        yield (
            f"beacons.{key}: {value:g} m of the preset {section.preset} is unverified: PX4 assumes it by default, and "
            "nobody measured it; give the noise of your beacons"
        )
    if kind in ("first-estimates", "observability-constrained"):
        yield Note(
            f"filter.kind: {kind} takes every correction by a beacon for a change of specific force, which would show "
            "heading: its sigma of heading is far too small with beacons; write eskf or gaussian-sum",
            *too_small,
        )
    share = section.outlier_share + section.long_share
    if scenario.filter.beacons.outliers == "mixture":
        return
    if share > 0.0 and scenario.filter.gate.probability == 0.0:
        yield Note(
            f"filter.gate.probability: 0 is no gate, and {digits(share)} of the ranges of the beacons are outliers, "
            "which the filter takes for noise; write 1e-4",
            *too_small,
        )
    elif share > MANY_OUTLIERS:
        yield Note(
            f"beacons: {digits(share)} of the ranges are outliers, against which the filter has its gate alone. Above "
            f"{MANY_OUTLIERS:g} errors exceed its sigma; write filter.beacons.outliers: mixture",
            *too_small,
        )


def _repeated_noise(scenario: Landing) -> Iterator[str]:
    """Levels of single fixes for one independent error an approach, in which the noise of ranges repeats. Where other
    errors last, errors beyond a level are nearly as frequent: they need a large noise, too."""
    section = scenario.integrity
    if section is None or section.method != "mhss" or section.effective_samples > 1.0:
        return
    smoothing = scenario.receiver.smoothing_s
    if smoothing < EXPOSURE:
        alert = 0.0 if section.limits is None else section.limits.tta_s
        apart, where = max(alert, smoothing), "here "
        if apart == 0.0:
            apart, where = 6.0, "with white noise and 6 s to alert "
        yield (
            "integrity.effective_samples: levels allow for one independent error an approach. The noise of ranges has "
            "more: the operation's exposure over the larger of time to alert and receiver.smoothing_s, "
            f"{where}{EXPOSURE:g} s / {apart:g} s = {EXPOSURE / apart:.0f}. Set this number; with 1 the levels are too "
            "low"
        )


def _errors_beyond_levels(scenario: Landing) -> Iterator[str]:
    """Levels of a scenario with errors that no level contains."""
    section, signals = scenario.integrity, scenario.signals
    last = [f"signals.{key}" for key in ("ephemeris", "ionosphere") if getattr(signals, key) is not None]
    if section is not None and last:
        yield (
            f"integrity: no level contains the errors of {' and '.join(last)}, so the levels are too low. Declare "
            "their size by signals.errors instead, which levels of mhss contain"
        )


def _levels_of_others(scenario: Landing) -> Iterator[str]:
    """Levels of the receiver's fixes beside a filter that uses no fixes."""
    section = scenario.integrity
    if section is not None and scenario.monitored and scenario.filter.tight and section.method in ("mhss", "chi2"):
        yield (
            f"integrity.method: levels and alarms of {section.method} are those of the receiver's fixes, which the "
            "filter doesn't use with filter.coupling: tight. No level bounds its errors; write filter.coupling: loose, "
            "or integrity.method: filter if no errors of pseudolites last"
        )


def _clock_in_seconds(scenario: Landing) -> Iterator[str]:
    """A clock error of pseudolites that is probably in seconds."""
    size = scenario.pseudolites.clock_sigma_ns
    if 0.0 < size < _LEAST_CLOCK_NS and scenario.pseudolites.placed():
        yield (
            f"pseudolites.clock_sigma_ns: {size:g} ns are {digits(0.3 * size)} m, which no clock keeps; the key is in "
            "nanoseconds: did you mean seconds?"
        )


def free_clocks(scenario: Landing) -> Iterator[str]:
    """Clocks of pseudolites that leave their setting by more than fixes that are weighted each for itself make use
    of."""
    section, monitor = scenario.pseudolites, scenario.integrity if scenario.monitored else None
    excludes = monitor is not None and monitor.exclusion != "none"
    if scenario.filter.tight or not section.placed() or not (errors := section.errors()).wanders:
        return
    if not excludes and about_transmitter_errors(scenario) != "none":
        return
    cause = "integrity.exclusion" if excludes else "filter.fix_errors: none"
    begin, end = np.sqrt(errors.clock_covariance(np.array([0.0, scenario.duration_s]))[:, 0, 0])
    if end > WANDERED * math.hypot(begin, errors.offset, section.range_sigma_m):
        yield (
            f"pseudolites: their clocks wander by {digits(end)} m (1 sigma) in the flight. With {cause} each fix is "
            "weighted alone, and the result may be worse than without pseudolites; write filter.coupling: tight, "
            "whose filter learns the clocks"
        )


def one_direction(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warnings of pseudolites, and of beacons, that the antenna sees in the direction of another one throughout the
    flight."""
    frame, section = trajectory.frame, scenario.beacons
    placed = [("pseudolites", scenario.pseudolites.names(), lambda: scenario.pseudolite_positions(frame))]
    if section is not None:
        placed.append(("beacons", section.names(), lambda: section.model(scenario).positions(frame)))
    return [text for what, names, llh in placed if len(names) > 1
            for text in _behind_each_other(scenario, trajectory, what, names, llh())]  # fmt: skip


def _behind_each_other(
    scenario: Landing, trajectory: Moving, what: str, names: Sequence[str], llh: np.ndarray
) -> Iterator[str]:
    """Of sources of one sort at (n, 3) rad, rad, m."""
    from navsim.gnss.signals import antenna_ecef

    motion = trajectory.motion(_times(scenario, trajectory, TOUCHDOWN))
    sites = ecef_from_llh(llh)
    towards = sites - antenna_ecef(motion, np.array(scenario.receiver.lever_arm_m))[:, None]
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    for j in range(1, len(sites)):
        across = np.linalg.norm(np.cross(towards[:, :j], towards[:, j, None]), axis=2)
        along = np.einsum("epk,ek->ep", towards[:, :j], towards[:, j])
        apart = np.degrees(np.arctan2(across, along)).max(axis=0)
        i = int(np.argmin(apart))
        if apart[i] < LEAST_ANGLE:
            far = float(np.linalg.norm(sites[j] - sites[i]))
            yield (
                f"{what}: {names[j]} is {far:.1f} m from {names[i]}, and the antenna sees both within "
                f"{apart[i]:.1f} deg of each other throughout the flight. The second one adds no geometry; give "
                f"{names[j]} a position on another side of the approach"
            )


def _times(scenario: Landing, trajectory: Moving, until: str) -> np.ndarray:
    """Times from 0 to an event, or to the end of the flight, s."""
    end = min(scenario.duration_s, trajectory.path.events.get(until, math.inf))
    return np.linspace(0.0, end, max(2, math.ceil(end / _STEP)))


def _lever_arms(scenario: Landing) -> Iterator[str]:
    """Antennas farther from the IMU than an aircraft is long."""
    radio, its = scenario.radio_altimeter, scenario.filter.radio_altimeter
    arms = {
        "receiver.lever_arm_m": scenario.receiver.lever_arm_m, "filter.lever_arm_m": scenario.filter.lever_arm_m,
        "radio_altimeter.lever_arm_m": None if radio is None else radio.lever_arm_m,
        "filter.radio_altimeter.lever_arm_m": None if radio is None else its.lever_arm_m,
    }  # fmt: skip
    for key, arm in arms.items():
        if arm is not None and (length := math.hypot(*arm)) > LONGEST_ARM:
            yield (
                f"{key}: the antenna is {length:g} m from the IMU, farther than any aircraft is long; give metres "
                "along the body axes (forward, right, down) from the IMU to the antenna"
            )


def _drifts(scenario: Landing) -> Iterator[str]:
    """Constant errors of inertial sensors that are as large as their measurements."""
    hours = scenario.duration_s / 3600.0
    for where, imu in (("imu", scenario.imu), ("filter.imu", scenario.filter.imu)):
        if (gyro := imu.gyro) is not None:
            for name, drift in (("drift_deg_h", gyro.drift_deg_h), ("drift_fixed_deg_h", gyro.drift_fixed_deg_h)):
                if (worst := _largest(drift)) * hours > REVOLUTION:
                    yield (
                        f"{where}.gyro.{name}: {worst:g} deg/h turns the computed attitude by {worst * hours:.0f} deg "
                        f"in the {scenario.duration_s:g} s of the flight, more than a revolution, which no filter "
                        "follows; give deg/h (deg/s times 3600)"
                    )
        if (accelerometer := imu.accelerometer) is not None:
            for name, bias in (("bias_mg", accelerometer.bias_mg), ("bias_fixed_mg", accelerometer.bias_fixed_mg)):
                if (worst := _largest(bias)) > GRAVITY_MG:
                    yield (
                        f"{where}.accelerometer.{name}: {worst:g} mg is more than gravity, 1000 mg; give mg "
                        "(m/s2 times 102)"
                    )


def _largest(value: float | Sequence[float] | None) -> float:
    """Largest size of a number or of a list of numbers; 0 for none."""
    return float(np.abs(() if value is None else value).max(initial=0.0))


def _speeds(scenario: Landing) -> Iterator[str]:
    """An approach that speeds up towards touchdown."""
    approach = scenario.approach
    if not isinstance(approach, PaperApproach | SmoothApproach | WaypointApproach):
        return
    key, first = "speed_start_kmh", approach.speed_start_kmh
    if isinstance(approach, WaypointApproach):
        if approach.ending == "none":
            return
        if approach.points and (given := approach.points[-1].speed_kmh) is not None:
            key, first = f"points[{len(approach.points) - 1}].speed_kmh", given
    if (last := approach.speed_touchdown_kmh) > first:
        yield (
            f"approach.speed_touchdown_kmh: {last:g} km/h is faster than approach.{key}, {first:g} km/h: the aircraft "
            "speeds up all the way down the glide; swap the two if that was not meant"
        )


def _wind(scenario: Landing, trajectory: Moving) -> Iterator[str]:
    """Wind that comes near the airspeed."""
    if not scenario.wind.blows or not isinstance(trajectory, Trajectory) or trajectory.body is not None:
        return
    from navsim.trajectory.air import triangle_along

    times = _times(scenario, trajectory, ROLL_OUT)[:-1]
    flown = triangle_along(trajectory, times)
    speed = np.linalg.norm(trajectory.wind.mean(times), axis=1)
    worst = int(np.argmax(speed / flown.airspeed))
    share = speed[worst] / flown.airspeed[worst]
    if share > STRONG_WIND:
        key = "levels" if scenario.wind.profile == "table" else "speed_m_s"
        crab = math.degrees(float(np.nanmax(np.abs(flown.crab))))
        yield (
            f"wind.{key}: at {times[worst]:.1f} s the wind of {speed[worst]:.1f} m/s is {100.0 * share:.0f} % of the "
            f"airspeed of {flown.airspeed[worst]:.1f} m/s; no aircraft lands in it. A mean wind only turns the nose, "
            f"here by up to {crab:.0f} deg, so accuracies hardly change. Check the unit (1 kt is 0.514 m/s); "
            "wind.turbulence and wind.gusts disturb the flight"
        )


def _undulation(scenario: Landing, trajectory: Moving) -> Iterator[str]:
    """A geoid undulation that EGM96 does not have there, where the extra `geoid` is installed."""
    from navsim.geodesy.geoid import NoGeoid, undulation

    given = scenario.runway.geoid_undulation_m
    if not isinstance(given, float):
        return
    lat, lon = np.degrees(scenario.threshold(trajectory.frame)[:2]).tolist()
    try:
        model = undulation(lat, lon)
    except NoGeoid:
        return
    if abs(given - model) > UNDULATION_ERROR:
        sign = ", with the other sign" if abs(given + model) <= UNDULATION_ERROR else ""
        yield (
            f"runway.geoid_undulation_m: {given:g} m, and EGM96 has {model:.1f} m at the threshold{sign}; give the "
            "height of the geoid above the ellipsoid, positive where the geoid is above it, or `auto`"
        )
