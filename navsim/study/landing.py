"""A landing scenario flown: models from its sections, an ensemble of runs, statistics, the result tree.

The layout of the tree is that of `interface.md`, kind landing.
"""

from __future__ import annotations

import datetime
import hashlib
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

import navsim
from navsim.core import states
from navsim.core.jit import digest as kernel_digest
from navsim.core.wgs84 import SPEED_OF_LIGHT
from navsim.estimation.loosely_coupled import KINDS, REJECTED
from navsim.io.almanac import AlmanacError, read_agl
from navsim.io.results import Result, Stream, Variable
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
from navsim.study.ensemble import Arrays, Ensemble, Store
from navsim.study.ensemble import fly_all as fly_ensemble
from navsim.study.statistics import (
    chi_square_exceedance,
    consistency_band,
    ellipsoid_probability,
    mean_interval,
    rms_interval,
    verdict,
)

SCHEMA_VERSION = 1
FOOT = 0.3048
DECISION_HEIGHTS_FT = (0, 50, 100, 200)
GROUPS = tuple(states.SLICES)
"""Groups of states that are judged by themselves."""
LEVELS = np.array([1.0, 2.0, 3.0])
"""Sigma levels of the position ellipsoids whose coverage is counted."""
_NO_LEVEL = np.full(LEVELS.size, np.nan)
PERCENTILES = (50, 95, 99)
RMS_WINDOW = 20.0
"""Length of the stretch before touchdown over which RMS errors are taken, s."""


@dataclass(frozen=True)
class Case:
    """A scenario turned into models, ready to be flown any number of times."""

    scenario: Landing
    trajectory: Trajectory
    ground: Ground
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
    ground = _ground(scenario, trajectory)
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
        ground=ground,
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
        ground,
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


HISTORIES = {
    "none": (),
    "errors": ("error", "sigma", "nees", "nees_position_velocity", "innovation_squared", "status"),
    "all": tuple(Run.__dataclass_fields__),
}
"""Histories of a run that are stored, by `--keep`."""


@dataclass(frozen=True)
class LandingStudy:
    """An ensemble of a case as the engine flies it (`study.ensemble.Study`)."""

    case: Case
    seed: int
    keep: str

    @cached_property
    def window(self) -> np.ndarray:
        """Which filter outputs count for the RMS errors."""
        return _rms_window(self.case)

    @cached_property
    def crossings(self) -> list[float]:
        """Times at the decision heights, s."""
        return _crossings(self.case)

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1 and reduce them, in order."""
        window, crossings = self.window, self.crossings
        rows: list[dict[str, np.ndarray | np.generic]] = []
        sums = {name: np.zeros(self.case.world.filter_time.size) for name in ("nees", "nees_position_velocity", "nis")}
        sums["nis"][0] = np.nan
        sums["nees_group"] = np.zeros((self.case.world.filter_time.size, len(GROUPS)))
        kept: Arrays = {}
        for i in range(count):
            # one run at a time: holding all of a batch costs more in memory traffic than flying them
            run = self.case.fly(self.seed, first + i)
            rows.append(
                {
                    "mean_square": _mean_square(run.error[window]),
                    "at_height": _at_heights(self.case, crossings, run.error),
                    "fixes": np.sum(~np.isnan(run.fix_llh[:, 0])),
                    "lost": np.sum(np.isnan(run.fix_llh[:, 0])),
                    "rejected": np.sum(run.status == REJECTED),
                    "broken": ~np.all(np.isfinite(run.nees)),
                    "degrees": run.degrees.max(initial=0),
                    "inside": np.mean(run.nees_group[1:, :1] <= LEVELS**2, axis=0) if len(run.degrees) else _NO_LEVEL,
                }
            )
            sums["nees"] += run.nees / states.N
            sums["nees_position_velocity"] += run.nees_position_velocity / 6
            sums["nees_group"] += run.nees_group / 3
            sums["nis"][1:] += run.innovation_squared / np.maximum(run.degrees, 1)
            for name in HISTORIES[self.keep]:
                history = getattr(run, name)
                if name not in kept:
                    kept[name] = np.empty((count, *history.shape), history.dtype)
                kept[name][i] = history
        per_run = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        return per_run, sums, kept


def fly_all(
    case: Case,
    seed: int,
    first_run: int,
    runs: int,
    workers: int,
    *,
    keep: str = "all",
    store: Store | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
) -> Ensemble:
    """Fly runs of a case; see `study.ensemble.fly_all`."""
    return fly_ensemble(LandingStudy(case, seed, keep), first_run, runs, workers, store, done, enough)


_UNTIL = re.compile(r"\s*(rms_horizontal|rms_vertical)\s+within\s+([0-9.]+)\s*%\s*")


def stopping_rule(expression: str) -> Callable[[Ensemble], bool]:
    """`rms_horizontal within 2%`: true once the 95 % interval reaches no further than that from its value.

    Raises ValueError for anything else.
    """
    match = _UNTIL.fullmatch(expression)
    try:
        share = float(match.group(2)) / 100.0 if match else 0.0
    except ValueError:
        share = 0.0
    if match is None or share <= 0.0:
        raise ValueError(f"{expression!r}: expected `rms_horizontal within 2%` or `rms_vertical within 2%`")
    columns = slice(0, 2) if match.group(1) == "rms_horizontal" else slice(2, 3)

    def enough(ensemble: Ensemble) -> bool:
        value, low, high = rms_interval(ensemble.per_run("mean_square")[:, columns])
        return bool(0.5 * (high - low) <= share * value)

    return enough


def partial_key(case: Case, seed: int, first_run: int, runs: int, keep: str) -> dict[str, object]:
    """What partial work must agree in to be resumed: scenario, random numbers, extent, code."""
    text = resolved_yaml(case.scenario)
    return {
        "scenario_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "seed": seed,
        "first_run": first_run,
        "runs": runs,
        "keep": keep,
        "navsim_version": navsim.__version__,
        "kernels": kernel_digest(),
    }


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
    rejected = int(ensemble.per_run("rejected").sum())
    if rejected:
        share = f" of {ensemble.runs} runs" if ensemble.runs > 1 else ""
        out.append(f"{rejected} fixes{share} were rejected by the innovation gate")
    broken = int(ensemble.per_run("broken").sum())
    if broken:
        out.append(f"the filter's covariance lost positive definiteness in {broken} of {ensemble.runs} runs")
    return out


# --- what is reduced within a batch


def _touchdown(case: Case) -> float:
    """Time of touchdown, or the end of a flight without one, s."""
    return min(case.trajectory.path.events.get(TOUCHDOWN, math.inf), case.scenario.duration_s)


def _rms_window(case: Case) -> np.ndarray:
    """Which filter outputs lie in the last seconds before touchdown (t,)."""
    t, end = case.world.filter_time, _touchdown(case)
    return (t >= end - RMS_WINDOW - 1e-9) & (t <= end + 1e-9)


def _mean_square(error: np.ndarray) -> np.ndarray:
    """Mean square over time (t, 15) -> (15,); nan for no time at all."""
    return np.mean(error**2, axis=0) if error.shape[0] else np.full(error.shape[1], np.nan)


def _crossings(case: Case) -> list[float]:
    """Times when the true height above the runway passes the decision heights, nan where it does not."""
    path = case.trajectory.path
    touchdown = path.events.get(TOUCHDOWN, math.inf)
    fine = np.arange(0.0, min(touchdown, case.scenario.duration_s), 1e-3)
    height = -path.jet(fine)[:, 0, 2]
    times = []
    for feet in DECISION_HEIGHTS_FT:
        above = np.flatnonzero(height >= feet * FOOT)
        crossed = above.size and above[-1] < fine.size - 1
        when = touchdown if feet == 0 else (float(fine[above[-1]]) if crossed else math.nan)
        times.append(when if when <= case.world.filter_time[-1] + 1e-9 else math.nan)
    return times


def _at_heights(case: Case, crossings: list[float], error: np.ndarray) -> np.ndarray:
    """Lateral, along-track and vertical position error (h, 3) of one run at the crossings, m."""
    t = case.world.filter_time
    c, s = np.cos(case.scenario.runway.heading_deg * DEG), np.sin(case.scenario.runway.heading_deg * DEG)
    out = np.full((len(crossings), 3), np.nan)
    for row, when in zip(out, crossings, strict=True):
        if math.isfinite(when):
            north, east, down = (np.interp(when, t, error[:, i]) for i in range(3))
            row[:] = c * east - s * north, c * north + s * east, -down
    return out


# --- the result tree

_XYZ = ("north", "east", "down")


def result(case: Case, ensemble: Ensemble, seed: int, *, keep: str, created: str | None = None) -> Result:
    """The result tree of an ensemble that was flown with the same `keep`.

    keep: `all` also stores measurements and fixes of every run, `errors` the filter's errors, `none` the
    statistics alone.
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
    _receiver(v, world, ensemble, clocks, keep == "all")
    if keep == "all":
        _measurements(v, case, ensemble)
    if keep != "none":
        _filter(v, world, ensemble)
    _summary(v, case, ensemble)
    return Result(attributes, v)


def _history(
    ensemble: Ensemble, name: str, convert: Callable[[np.ndarray], np.ndarray] = lambda block: block
) -> Stream:
    """A kept history as a stream of blocks along the run axis, never in memory as a whole."""
    first = convert(next(ensemble.blocks(name)))
    return Stream((ensemble.runs, *first.shape[1:]), first.dtype, lambda: map(convert, ensemble.blocks(name)))


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
    ground = case.ground
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
    v["/measurements/pseudorange"] = Variable(dims, _history(ensemble, "pseudorange"), "m", "pseudoranges")
    v["/measurements/range_rate"] = Variable(dims, _history(ensemble, "range_rate"), "m/s", "pseudorange rates")
    cn0 = _history(ensemble, "pseudorange", lambda block: np.broadcast_to(s.cn0, block.shape))
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
    v["/receiver/position_llh"] = Variable(
        (*dims, "llh"), _history(ensemble, "fix_llh"), "rad, rad, m", "fixes of the antenna"
    )
    v["/receiver/velocity_ned"] = Variable(
        (*dims, "ned"), _history(ensemble, "fix_velocity"), "m/s", "velocity fixes of the antenna"
    )
    v["/receiver/clock"] = Variable(
        (*dims, "clock_name"),
        _history(ensemble, "fix_clock", lambda block: block[..., clocks]),
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
        ("run", "time", "state"), _history(ensemble, "error"), mixed, "truth minus estimate, after the update"
    )
    v["/filter/sigma"] = Variable(
        ("run", "time", "state"), _history(ensemble, "sigma"), mixed, "1 sigma of the filter, after the update"
    )
    v["/filter/nees"] = Variable(
        ("run", "time"),
        _history(ensemble, "nees"),
        "1",
        "normalised estimation error squared, 15 states",
        {"degrees_of_freedom": states.N},
    )
    v["/filter/nees_position_velocity"] = Variable(
        ("run", "time"), _history(ensemble, "nees_position_velocity"), "1",
        "normalised estimation error squared, position and velocity", {"degrees_of_freedom": 6},
    )  # fmt: skip
    v["/filter/epoch"] = Variable(("epoch",), world.signals.time, "s", "fix epochs, time of validity")
    innovation = _history(ensemble, "innovation_squared")
    v["/filter/innovation_squared"] = Variable(
        ("run", "epoch"), innovation, "1", "normalised innovation squared, nan without a fix",
        {"degrees_of_freedom": int(ensemble.per_run("degrees").max())},
    )  # fmt: skip
    status = _history(ensemble, "status", lambda block: block.astype(np.int8))
    v["/filter/fix_status"] = Variable(("run", "epoch"), status, "1", "0 no fix, 1 used, 2 rejected by the gate")


def _summary(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    world = case.world
    events = case.trajectory.path.events
    touchdown = _touchdown(case)
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
    squares = ensemble.per_run("mean_square")
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

    heights = np.array(DECISION_HEIGHTS_FT) * FOOT
    v["/summary/at/height"] = Variable(
        ("height",), heights, "m", "true height above the runway: touchdown, 50, 100, 200 ft"
    )
    at = ensemble.per_run("at_height")
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}"] = Variable(
            ("height", "interval"),
            np.stack([rms_interval(at[:, h, [i]] ** 2) for h in range(heights.size)]),
            "m",
            f"root mean square over runs of the {name} position error",
        )

    v["/summary/percentile"] = Variable(
        ("percentile",), np.array(PERCENTILES), "1", "percentiles over runs of the size of an error"
    )
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}_percentile"] = Variable(
            ("height", "percentile"), np.percentile(np.abs(at[:, :, i]), PERCENTILES, axis=0).T, "m",
            f"percentiles over runs of the size of the {name} position error",
        )  # fmt: skip
    for name, first, last in (("horizontal", 0, 2), ("vertical", 2, 3)):
        size = np.sqrt(squares[:, first:last].sum(axis=1))
        v[f"/summary/rms/{name}_percentile"] = Variable(
            ("percentile",), np.percentile(size, PERCENTILES), "m",
            f"percentiles over runs of the {name} error, root mean square over 20 s to touchdown",
        )  # fmt: skip

    v["/summary/coverage/level"] = Variable(("level",), LEVELS, "1", "size of the ellipsoid in sigmas")
    inside = ensemble.per_run("inside")
    v["/summary/coverage/position"] = Variable(
        ("level", "interval"), np.stack([mean_interval(inside[:, k]) for k in range(LEVELS.size)]), "1",
        "share of outputs after time 0 with the position error inside its ellipsoid",
    )  # fmt: skip
    v["/summary/coverage/expected"] = Variable(
        ("level",), np.array([ellipsoid_probability(k, 3) for k in LEVELS]), "1", "share of a Gaussian error"
    )

    runs = ensemble.runs
    v["/summary/consistency/time"] = Variable(("time",), t, "s", "time of the filter's output")
    most = int(ensemble.per_run("degrees").max())
    for name, degrees, meaning in (
        ("nees", states.N, "normalised estimation error squared, 15 states"),
        ("nees_position_velocity", 6, "normalised estimation error squared, position and velocity"),
        ("nis", most, "normalised innovation squared"),
    ):
        low, high = consistency_band(degrees, runs) if degrees else (np.nan, np.nan)
        v[f"/summary/consistency/{name}"] = Variable(
            ("time",), ensemble.mean(name), "1", f"ensemble mean per degree of freedom: {meaning}",
            {"band_low": low, "band_high": high, "degrees_of_freedom": degrees},
        )  # fmt: skip

    band = consistency_band(3, runs)
    groups = ensemble.mean("nees_group")
    v["/summary/consistency/group"] = Variable(
        ("group",), np.array(GROUPS, dtype=object), "1", "groups of three states"
    )
    v["/summary/consistency/nees_group"] = Variable(
        ("time", "group"), groups, "1", "ensemble mean per degree of freedom of each group's normalised squared error",
        {"band_low": band[0], "band_high": band[1], "degrees_of_freedom": 3},
    )  # fmt: skip
    window = _rms_window(case)
    late = groups[window].mean(axis=0) if window.any() else np.full(len(GROUPS), np.nan)
    v["/summary/consistency/mean_group"] = Variable(
        ("group",), late, "1", "mean of nees_group over 20 s to touchdown; one is right"
    )
    v["/summary/consistency/verdict"] = Variable(
        ("group",), np.array([verdict(m, band) for m in late], dtype=object), "1",
        "mean_group against the 95 % band of a single time",
    )  # fmt: skip

    for name, value, meaning in (
        ("runs", runs, "number of runs"),
        ("fixes", int(ensemble.per_run("fixes").sum()), "fixes of all runs"),
        ("epochs_without_fix", int(ensemble.per_run("lost").sum()), "epochs of all runs without a fix"),
    ):
        v[f"/summary/count/{name}"] = Variable((), np.int64(value), "1", meaning)


__all__ = [
    "Case",
    "Ensemble",
    "default_workers",
    "findings",
    "fly_all",
    "partial_key",
    "prepare",
    "result",
    "stopping_rule",
]
