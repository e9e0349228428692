"""A landing scenario flown: models from its sections, an ensemble of runs, statistics, the result tree.

The layout of the tree is that of `interface.md`, kind landing.
"""

from __future__ import annotations

import datetime
import hashlib
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

import navsim
from navsim.core import states
from navsim.core.wgs84 import SPEED_OF_LIGHT
from navsim.estimation.loosely_coupled import KINDS, REJECTED
from navsim.io.almanac import AlmanacError, read_agl
from navsim.io.results import Result, Variable
from navsim.models import glonass
from navsim.models.approach import GLIDE_START, TOUCHDOWN
from navsim.models.imu import Triad
from navsim.models.kinematics import Trajectory
from navsim.scenario.base import DEG
from navsim.scenario.landing import CLOCKS, Accelerometer, Gyro, Landing
from navsim.scenario.load import resolved_yaml
from navsim.scenario.source import Document, InputError, Place, Problem
from navsim.simulation.landing import (
    ErrorLaw,
    FilterSettings,
    Ground,
    InitialErrors,
    Listed,
    Run,
    Satellites,
    World,
    build_world,
    fly,
)
from navsim.study.statistics import chi_square_exceedance, consistency_band, rms_interval

SCHEMA_VERSION = 1
FOOT = 0.3048
DECISION_HEIGHTS_FT = (0, 50, 100, 200)
RMS_WINDOW = 20.0
"""Length of the stretch before touchdown over which RMS errors are taken, s."""


@dataclass(frozen=True)
class Case:
    """A scenario turned into models, ready to be flown any number of times."""

    scenario: Landing
    trajectory: Trajectory
    world: World
    initial: InitialErrors
    gyro: Triad
    accel: Triad
    settings: FilterSettings
    warnings: list[str] = field(default_factory=list)

    def fly(self, seed: int, run: int) -> Run:
        """Run number `run` of the ensemble of `seed`."""
        return fly(self.world, self.initial, self.gyro, self.accel, self.settings, seed, run)


def prepare(scenario: Landing, document: Document) -> Case:
    """Build everything the runs share. Raises InputError for an almanac that cannot be used."""
    warnings: list[str] = []
    utc = scenario.epoch.timestamp()
    trajectory = scenario.trajectory()
    satellites, listed = None, None
    if scenario.sky.source == "directions":
        listed = _listed(scenario)
    else:
        satellites, scenario = _satellites(scenario, document, utc, warnings)
    receiver = scenario.receiver
    truth_gyro = scenario.imu.gyro.triad(scenario.imu.rate_hz)
    truth_accel = scenario.imu.accelerometer.triad(scenario.imu.rate_hz)
    world = build_world(
        trajectory,
        utc=utc,
        duration=scenario.duration_s,
        imu_rate=scenario.imu.rate_hz,
        fix_rate=receiver.rate_hz,
        latency=receiver.latency_s,
        lever_arm=np.array(receiver.lever_arm_m),
        satellites=satellites,
        listed=listed,
        mask=scenario.sky.mask(),
        ground=_ground(scenario, trajectory),
        law=ErrorLaw(
            scenario.signals.range_law,
            scenario.signals.range_sigma_m,
            scenario.signals.range_scale_deg * DEG,
            scenario.signals.range_rate_sigma_m_s,
            scenario.signals.cn0_dbhz,
        ),
        clock_offset=receiver.clock_offset_us * 1e-6,
        clock_drift=receiver.clock_drift_ppb * 1e-9,
    )
    touchdown = trajectory.path.events.get(TOUCHDOWN, -math.inf)
    if touchdown > scenario.duration_s:
        warnings.append(
            f"touchdown would be at {touchdown:.1f} s, after the end of the simulation "
            f"(duration_s: {scenario.duration_s:g}); figures at touchdown are not defined"
        )
    return Case(
        scenario,
        trajectory,
        world,
        _initial(scenario),
        truth_gyro,
        truth_accel,
        _settings(scenario, truth_gyro, truth_accel),
        warnings,
    )


def _satellites(scenario: Landing, document: Document, utc: float, warnings: list[str]) -> tuple[Satellites, Landing]:
    """The constellation, and the scenario with the almanac's checksum written into it."""
    sky = scenario.sky
    constellation: glonass.Nominal | glonass.Almanac = glonass.Nominal()
    if sky.source == "almanac":
        assert sky.almanac is not None
        key = ("sky", "almanac")
        path = document.resolve(key, sky.almanac)

        def wrong(message: str, line: int = 0) -> InputError:
            named = document.place(key)
            if not line:
                return InputError([Problem(named, "sky.almanac", f"{sky.almanac}: {message}")])
            return InputError([Problem(Place(str(path), line, 1), "sky.almanac", f"{message} (named at {named})")])

        try:
            checksum = hashlib.sha256(path.read_bytes()).hexdigest()
            constellation = read_agl(path)
        except AlmanacError as error:
            raise wrong(f"not a usable .agl almanac: {error}", error.line) from None
        except OSError as error:
            raise wrong(f"cannot be read: {error.strerror or error} ({path})") from None
        if sky.almanac_sha256 not in (None, checksum):
            raise wrong(f"has the checksum {checksum}, not the one of sky.almanac_sha256")
        scenario = scenario.model_copy(update={"sky": sky.model_copy(update={"almanac_sha256": checksum})})
        age = constellation.age(utc) / 86400.0
        if age > sky.almanac_warning_days:
            warnings.append(
                f"the almanac {sky.almanac} is {age:.0f} days away from the epoch; satellite positions may be off"
            )
    names = tuple(f"R{slot:02d}" for slot in constellation.slot)
    healthy = np.ones(len(names), dtype=bool) if sky.use_unhealthy else constellation.healthy
    if not np.all(healthy):
        out = ", ".join(n for n, h in zip(names, healthy, strict=True) if not h)
        warnings.append(f"not used, because the almanac marks them as unhealthy: {out}")
    chosen = healthy & np.array([name not in sky.exclude for name in names])
    return Satellites(constellation, names, CLOCKS.index("glonass"), chosen), scenario


def _listed(scenario: Landing) -> Listed:
    directions = scenario.sky.directions
    names = tuple(f"X{i:02d}" for i in range(1, len(directions) + 1))
    return Listed(
        names,
        np.array([d.azimuth_deg for d in directions]) * DEG,
        np.array([d.elevation_deg for d in directions]) * DEG,
        np.array([CLOCKS.index(d.clock) for d in directions]),
        np.array([name not in scenario.sky.exclude for name in names]),
    )


def _ground(scenario: Landing, trajectory: Trajectory) -> Ground:
    section = scenario.pseudolites
    return Ground(
        names=section.names(),
        llh=scenario.pseudolite_positions(trajectory.frame),
        survey_error=np.array(section.survey_error_m),
        clock=CLOCKS.index(section.clock),
        # a transmitter ahead of its time scale is heard too early
        delay=-SPEED_OF_LIGHT * section.clock_offset_ns * 1e-9,
        sigma=section.range_sigma_m,
        rate_sigma=section.range_rate_sigma_m_s,
        cn0=section.cn0_dbhz,
    )


def _initial(scenario: Landing) -> InitialErrors:
    section = scenario.initial_errors
    fixed = None
    if section.fixed is not None:
        f = section.fixed
        fixed = np.array([*f.position_m, *f.velocity_m_s, *(a * DEG for a in f.attitude_deg)])
    return InitialErrors(section.attitude_deg * DEG, section.position_m, section.velocity_m_s, fixed)


def _settings(scenario: Landing, gyro: Triad, accel: Triad) -> FilterSettings:
    """The filter's beliefs: what its section leaves out is what the truth has."""
    section = scenario.filter
    rate = scenario.imu.rate_hz
    truth = scenario.initial_errors
    given = section.initial
    initial = InitialErrors(
        (truth.attitude_deg if given.attitude_deg is None else given.attitude_deg) * DEG,
        truth.position_m if given.position_m is None else given.position_m,
        truth.velocity_m_s if given.velocity_m_s is None else given.velocity_m_s,
    )
    if section.imu.gyro is not None:
        gyro = _believed(scenario.imu.gyro, section.imu.gyro).triad(rate)
    if section.imu.accelerometer is not None:
        accel = _believed(scenario.imu.accelerometer, section.imu.accelerometer).triad(rate)
    lever_arm = scenario.receiver.lever_arm_m if section.lever_arm_m is None else section.lever_arm_m
    return FilterSettings(
        kind=KINDS[section.kind],
        initial=initial,
        gyro=gyro,
        accel=accel,
        with_velocity=section.velocity,
        latency=scenario.receiver.latency_s if section.latency_s is None else section.latency_s,
        lever_arm=np.array(lever_arm),
        sigma_scale=section.fix_sigma_scale,
        gate=np.array([chi_square_exceedance(section.gate.probability, m) for m in (3, 6)]),
        max_rejected=section.gate.max_rejected,
    )


def _believed(truth: Gyro | Accelerometer, given: Gyro | Accelerometer) -> Gyro | Accelerometer:
    """The true sensor with the filter's own values put in; one spelling of the noise displaces the other."""
    values = given.model_dump(exclude_none=True)
    for pair in (("noise_deg_h", "arw_deg_sqrt_h"), ("noise_mg", "vrw_m_s_sqrt_h")):
        if values.keys() & set(pair):
            values = {p: None for p in pair if hasattr(truth, p)} | values
    return truth.model_copy(update=values)


@dataclass(frozen=True)
class Ensemble:
    """Runs first_run, first_run + 1, ... stacked: the fields of `Run` with a leading run axis."""

    first_run: int
    runs: int
    stacked: dict[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.stacked[name]


def fly_all(
    case: Case,
    seed: int,
    first_run: int,
    runs: int,
    workers: int,
    done: Callable[[int], None] = lambda _: None,
) -> Ensemble:
    """Fly the runs on threads (the kernels release the GIL); `done(n)` is told how many are finished.

    Every run has its own random streams, so the numbers do not depend on `workers`.
    """
    numbers = range(first_run, first_run + runs)
    results: list[Run] = []
    if min(workers, runs) <= 1:
        for run in numbers:
            results.append(case.fly(seed, run))
            done(len(results))
    else:
        with ThreadPoolExecutor(max_workers=workers) as pool:
            try:
                for result in pool.map(lambda run: case.fly(seed, run), numbers):
                    results.append(result)
                    done(len(results))
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    names = Run.__dataclass_fields__
    return Ensemble(first_run, runs, {n: np.stack([getattr(r, n) for r in results]) for n in names})


def default_workers() -> int:
    """As many threads as this process may use cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def findings(case: Case, ensemble: Ensemble) -> list[str]:
    """Warnings about what happened, beside those about the input."""
    out = list(case.warnings)
    lost = np.isnan(case.world.dop[:, 1])
    total = lost.size
    if total == 0:
        out.append("the simulation is shorter than one fix interval: the filter never gets a fix")
    elif np.all(lost):
        out.append(f"no fix at all: too few usable sources at each of the {total} epochs")
    elif np.any(lost):
        times = case.world.signals.time[lost]
        out.append(
            f"{lost.sum()} of {total} epochs without a fix, the first at {times[0]:g} s, the last at {times[-1]:g} s"
        )
    rejected = int(np.sum(ensemble["status"] == REJECTED))
    if rejected:
        share = f" of {ensemble.runs} runs" if ensemble.runs > 1 else ""
        out.append(f"{rejected} fixes{share} were rejected by the innovation gate")
    broken = int(np.sum(np.any(~np.isfinite(ensemble["nees"]), axis=1)))
    if broken:
        out.append(f"the filter's covariance lost positive definiteness in {broken} of {ensemble.runs} runs")
    return out


# --- the result tree

_XYZ = ("north", "east", "down")


def result(case: Case, ensemble: Ensemble, seed: int, *, keep: str, created: str | None = None) -> Result:
    """The result tree of an ensemble.

    keep: `all` also stores measurements and fixes of every run, `errors` the filter's errors, `none` the
    statistics alone. For one run everything is kept but with `none`.
    """
    scenario, world = case.scenario, case.world
    text = resolved_yaml(scenario)
    now = created or datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    attributes = {
        "kind": "landing",
        "schema_version": SCHEMA_VERSION,
        "navsim_version": navsim.__version__,
        "seed": seed,
        "scenario": text,
        "scenario_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "epoch": scenario.epoch.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "created": now,
        "title": scenario.title,
    }
    v: dict[str, Variable] = {}
    _coordinates(v, ensemble)
    _truth(v, case)
    clocks = _geometry(v, case)
    if keep != "none":
        every = keep == "all" or ensemble.runs == 1
        if every:
            _measurements(v, case, ensemble)
        _receiver(v, world, ensemble, clocks, every)
        _filter(v, world, ensemble)
    _summary(v, case, ensemble)
    return Result(attributes, v)


def _coordinates(v: dict[str, Variable], ensemble: Ensemble) -> None:
    runs = np.arange(ensemble.first_run, ensemble.first_run + ensemble.runs)
    v["/run"] = Variable(("run",), runs, "1", "number of the run in the ensemble of the seed")
    for name, labels, meaning in (
        ("llh", ("latitude", "longitude", "height"), "geodetic coordinates, WGS-84"),
        ("ned", _XYZ, "axes of the local level frame"),
        ("enu", ("east", "north", "up"), "axes of the local level frame, east first"),
        ("enu_column", ("east", "north", "up"), "columns of matrices in these axes"),
        ("rpy", ("roll", "pitch", "yaw"), "Euler angles, yaw-pitch-roll sequence"),
        ("interval", ("value", "low", "high"), "a value and its two-sided 95 % confidence interval"),
        ("statistic", ("mean", "min", "max", "p50", "p95"), "statistics over the fix epochs of the glide"),
    ):
        v[f"/{name}"] = Variable((name,), np.array(labels), "1", meaning)


def _truth(v: dict[str, Variable], case: Case) -> None:
    truth = case.world.truth
    v["/truth/time"] = Variable(("time",), truth.time, "s", "time since the epoch")
    v["/truth/position_llh"] = Variable(
        ("time", "llh"), truth.llh, "rad, rad, m", "latitude, longitude, height of the IMU"
    )
    v["/truth/velocity_ned"] = Variable(("time", "ned"), truth.velocity_ned, "m/s", "velocity over ground")
    v["/truth/attitude_rpy"] = Variable(("time", "rpy"), truth.rpy, "rad", "roll, pitch, yaw")
    events = case.trajectory.path.events
    names = [n for n in events if events[n] <= case.scenario.duration_s]
    v["/truth/event"] = Variable(("event",), np.array(names, dtype=object), "1", "names of the events")
    v["/truth/event_time"] = Variable(("event",), np.array([events[n] for n in names]), "s", "times of the events")
    frame = case.trajectory.frame
    threshold = case.scenario.threshold(frame)
    v["/truth/threshold_llh"] = Variable(("llh",), threshold, "rad, rad, m", "threshold of the runway")


def _geometry(v: dict[str, Variable], case: Case) -> list[int]:
    """Geometry group; returns the clock numbers in use, the order of the clock axis."""
    world = case.world
    s = world.signals
    v["/geometry/time"] = Variable(("time",), s.time, "s", "fix epochs, time of validity since the epoch")
    v["/geometry/source"] = Variable(("source",), np.array(s.names, dtype=object), "1", "names of the sources")
    v["/geometry/clock"] = Variable(
        ("source",), s.clock, "1", "clock unknown the source belongs to", {"clocks": ", ".join(CLOCKS)}
    )
    v["/geometry/line_of_sight"] = Variable(
        ("time", "source", "enu"), s.los, "1", "unit vectors antenna to source at truth, nan where not used"
    )
    for i, name in enumerate(("gdop", "pdop", "hdop", "vdop", "tdop")):
        v[f"/geometry/{name}"] = Variable(
            ("time",), world.dop[:, i], "1", f"{name.upper()}, unit weights, nan without a fix"
        )
    ground = _ground(case.scenario, case.trajectory)
    v["/pseudolites/name"] = Variable(("name",), np.array(ground.names, dtype=object), "1", "names of the pseudolites")
    v["/pseudolites/position_llh"] = Variable(
        ("name", "llh"), ground.llh, "rad, rad, m", "surveyed positions of the pseudolites"
    )
    return sorted(set(s.clock[np.any(s.used, axis=0)].tolist()))


def _measurements(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    s = case.world.signals
    v["/measurements/time"] = Variable(("time",), s.time, "s", "fix epochs")
    v["/measurements/source"] = Variable(("source",), np.array(s.names, dtype=object), "1", "names of the sources")
    dims = ("run", "time", "source")
    v["/measurements/pseudorange"] = Variable(dims, ensemble["pseudorange"], "m", "pseudoranges")
    v["/measurements/range_rate"] = Variable(dims, ensemble["range_rate"], "m/s", "pseudorange rates")
    cn0 = np.broadcast_to(s.cn0, (ensemble.runs, *s.cn0.shape))
    v["/measurements/cn0"] = Variable(dims, cn0, "dB-Hz", "carrier to noise density ratio")


def _receiver(v: dict[str, Variable], world: World, ensemble: Ensemble, clocks: list[int], every: bool) -> None:
    v["/receiver/time"] = Variable(("time",), world.signals.time, "s", "fix epochs, time of validity")
    v["/receiver/covariance_enu"] = Variable(
        ("time", "enu", "enu_column"),
        world.fix_covariance,
        "m2",
        "weighted covariance of a position fix at truth",
    )
    if not every:
        return
    v["/receiver/clock_name"] = Variable(
        ("clock_name",), np.array([CLOCKS[c] for c in clocks], dtype=object), "1", "time scales"
    )
    dims = ("run", "time")
    v["/receiver/position_llh"] = Variable((*dims, "llh"), ensemble["fix_llh"], "rad, rad, m", "fixes of the antenna")
    v["/receiver/velocity_ned"] = Variable(
        (*dims, "ned"), ensemble["fix_velocity"], "m/s", "velocity fixes of the antenna"
    )
    v["/receiver/clock"] = Variable(
        (*dims, "clock_name"),
        ensemble["fix_clock"][..., clocks],
        "m",
        "receiver clock against each time scale",
    )


def _filter(v: dict[str, Variable], world: World, ensemble: Ensemble) -> None:
    v["/filter/time"] = Variable(("time",), world.filter_time, "s", "time 0, then the times the fixes are applied")
    v["/filter/state"] = Variable(
        ("state",),
        np.array(states.NAMES),
        "1",
        "states of the filter",
        {"state_units": ", ".join(states.UNITS)},
    )
    mixed = "m, m/s, rad, rad/s, m/s2"
    v["/filter/error"] = Variable(
        ("run", "time", "state"), ensemble["error"], mixed, "truth minus estimate, after the update"
    )
    v["/filter/sigma"] = Variable(
        ("run", "time", "state"), ensemble["sigma"], mixed, "1 sigma of the filter, after the update"
    )
    v["/filter/nees"] = Variable(
        ("run", "time"),
        ensemble["nees"],
        "1",
        "normalised estimation error squared, 15 states",
        {"degrees_of_freedom": states.N},
    )
    v["/filter/nees_position_velocity"] = Variable(
        ("run", "time"), ensemble["nees_position_velocity"], "1",
        "normalised estimation error squared, position and velocity", {"degrees_of_freedom": 6},
    )  # fmt: skip
    v["/filter/epoch"] = Variable(("epoch",), world.signals.time, "s", "fix epochs, time of validity")
    degrees = ensemble["degrees"]
    v["/filter/innovation_squared"] = Variable(
        ("run", "epoch"), ensemble["innovation_squared"], "1", "normalised innovation squared, nan without a fix",
        {"degrees_of_freedom": int(degrees.max()) if degrees.size else 0},
    )  # fmt: skip
    v["/filter/fix_status"] = Variable(
        ("run", "epoch"), ensemble["status"].astype(np.int8), "1", "0 no fix, 1 used, 2 rejected by the gate"
    )


def _summary(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    world = case.world
    events = case.trajectory.path.events
    touchdown = min(events.get(TOUCHDOWN, math.inf), case.scenario.duration_s)
    fix_time = world.signals.time
    glide = (fix_time >= events.get(GLIDE_START, 0.0) - 1e-9) & (fix_time <= touchdown + 1e-9)
    for i, name in enumerate(("gdop", "pdop", "hdop", "vdop", "tdop")):
        values = world.dop[glide, i]
        values = values[np.isfinite(values)]
        numbers = np.full(5, np.nan)
        if values.size:
            numbers[:] = values.mean(), values.min(), values.max(), *np.percentile(values, [50, 95])
        v[f"/summary/dop/{name}"] = Variable(
            ("statistic",), numbers, "1", f"{name.upper()} over the fix epochs of the glide"
        )

    variance = np.diagonal(world.fix_covariance, axis1=1, axis2=2)[glide]
    variance = variance[np.isfinite(variance[:, 0])]
    for name, columns in (("rms_horizontal", [0, 1]), ("rms_vertical", [2]), ("rms_3d", [0, 1, 2])):
        each = np.sqrt(variance[:, columns].sum(axis=1))
        mean = each.mean() if each.size else np.nan
        v[f"/summary/fix/{name}"] = Variable(
            ("interval",), np.full(3, mean), "m",
            "SKO of a fix: root of the weighted covariance, mean over the fix epochs of the glide; a prediction, "
            "without sampling uncertainty",
            {"minimum": each.min() if each.size else np.nan, "maximum": each.max() if each.size else np.nan},
        )  # fmt: skip

    t = world.filter_time
    window = (t >= touchdown - RMS_WINDOW - 1e-9) & (t <= touchdown + 1e-9)
    error = ensemble["error"]
    squares = np.mean(error[:, window] ** 2, axis=1) if window.any() else np.full((ensemble.runs, states.N), np.nan)
    rms = np.stack([rms_interval(squares[:, [i]]) for i in range(9)])
    over = "root mean square over runs and over 20 s to touchdown"
    for name, part, axis, unit in (
        ("position_ned", "position", "ned", "m"),
        ("velocity_ned", "velocity", "ned", "m/s"),
        ("attitude", "attitude", "ned", "rad"),
    ):
        v[f"/summary/rms/{name}"] = Variable(
            (axis, "interval"), rms[states.SLICES[part]], unit, f"{part} error, {over}"
        )
    v["/summary/rms/horizontal"] = Variable(
        ("interval",), rms_interval(squares[:, :2]), "m", f"horizontal error, {over}"
    )
    v["/summary/rms/vertical"] = Variable(("interval",), rms_interval(squares[:, 2:3]), "m", f"vertical error, {over}")

    _at_heights(v, case, error)

    runs = ensemble.runs
    v["/summary/consistency/time"] = Variable(("time",), t, "s", "time of the filter's output")
    for name, values, degrees in (
        ("nees", ensemble["nees"], states.N),
        ("nees_position_velocity", ensemble["nees_position_velocity"], 6),
    ):
        low, high = consistency_band(degrees, runs)
        v[f"/summary/consistency/{name}"] = Variable(
            ("time",), values.mean(axis=0) / degrees, "1", f"ensemble mean of {name} per degree of freedom",
            {"band_low": low, "band_high": high, "degrees_of_freedom": degrees},
        )  # fmt: skip
    degrees_each = ensemble["degrees"]
    with np.errstate(invalid="ignore"):
        each = ensemble["innovation_squared"] / np.where(degrees_each > 0, degrees_each, 1)
    nis = np.concatenate([[np.nan], each.mean(axis=0)])
    most = int(degrees_each.max()) if degrees_each.size else 0
    low, high = consistency_band(most, runs) if most else (np.nan, np.nan)
    v["/summary/consistency/nis"] = Variable(
        ("time",), nis, "1", "ensemble mean of the normalised innovation squared per degree of freedom",
        {"band_low": low, "band_high": high, "degrees_of_freedom": most},
    )  # fmt: skip

    lost = np.isnan(ensemble["fix_llh"][..., 0])
    for name, value, meaning in (
        ("runs", runs, "number of runs"),
        ("fixes", int(np.sum(~lost)), "fixes of all runs"),
        ("epochs_without_fix", int(np.sum(lost)), "epochs of all runs without a fix"),
    ):
        v[f"/summary/count/{name}"] = Variable((), np.int64(value), "1", meaning)


def _at_heights(v: dict[str, Variable], case: Case, error: np.ndarray) -> None:
    """Errors in runway axes when the true height above the runway passes the decision heights."""
    path = case.trajectory.path
    times = case.world.filter_time
    touchdown = path.events.get(TOUCHDOWN, math.inf)
    c, s = np.cos(case.scenario.runway.heading_deg * DEG), np.sin(case.scenario.runway.heading_deg * DEG)
    fine = np.arange(0.0, min(touchdown, case.scenario.duration_s), 1e-3)
    height = -path.jet(fine)[:, 0, 2]
    axes = {"lateral": [], "along": [], "vertical": []}  # type: dict[str, list[np.ndarray]]
    for feet in DECISION_HEIGHTS_FT:
        above = np.flatnonzero(height >= feet * FOOT)
        crossed = above.size and above[-1] < fine.size - 1
        when = touchdown if feet == 0 else (fine[above[-1]] if crossed else np.nan)
        if not when <= times[-1] + 1e-9:
            for values in axes.values():
                values.append(np.full(3, np.nan))
            continue
        k = min(int(np.searchsorted(times, when, side="right")), times.size - 1)
        share = (when - times[k - 1]) / (times[k] - times[k - 1])
        north, east, down = ((1.0 - share) * error[:, k - 1, :3] + share * error[:, k, :3]).T
        for name, value in (
            ("along", c * north + s * east),
            ("lateral", c * east - s * north),
            ("vertical", -down),
        ):
            axes[name].append(rms_interval(value[:, None] ** 2))
    heights = np.array(DECISION_HEIGHTS_FT) * FOOT
    v["/summary/at/height"] = Variable(
        ("height",), heights, "m", "true height above the runway: touchdown, 50, 100, 200 ft"
    )
    for name, values in axes.items():
        v[f"/summary/at/{name}"] = Variable(
            ("height", "interval"),
            np.array(values),
            "m",
            f"root mean square over runs of the {name} position error",
        )


__all__ = ["Case", "Ensemble", "default_workers", "findings", "fly_all", "prepare", "result"]
