"""What the result trees of all landing studies have in common, in the layout of `interface.md`, kind landing."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from navsim.core import states
from navsim.io.results import Result, Variable
from navsim.models import glonass, glonass_broadcast, gps, timescales
from navsim.scenario.sky import CLOCKS
from navsim.study.landing.case import DECISION_HEIGHTS_FT, FOOT, Case, on_glide
from navsim.study.root import root_attributes

AXES = ("north", "east", "down")


def base(case: Case, seed: int) -> Result:
    """The truth, the geometry and their summary."""
    v: dict[str, Variable] = {}
    _coordinates(v)
    _truth(v, case)
    _geometry(v, case)
    v.update(geometry_summary(case))
    _navigation(v, case)
    attributes = root_attributes("landing", seed, case.scenario, method=case.scenario.method)
    return Result(attributes, v)


def _coordinates(v: dict[str, Variable]) -> None:
    for name, labels, meaning in (
        ("llh", ("latitude", "longitude", "height"), "geodetic coordinates, WGS-84"),
        ("ned", AXES, "axes of the local level frame"),
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


def _geometry(v: dict[str, Variable], case: Case) -> None:
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
    v["/receiver/time"] = Variable(("time",), s.time, "s", "fix epochs, time of validity")
    v["/receiver/covariance_enu"] = Variable(
        ("time", "enu", "enu_column"),
        world.fix_covariance,
        "m2",
        "weighted covariance of a position fix at truth",
    )


def _navigation(v: dict[str, Variable], case: Case) -> None:
    """The messages the satellites flew by, or would have sent: what an export to RINEX needs."""
    time = timescales.gps_from_utc(case.scenario.epoch.timestamp()) + case.world.signals.time
    for group in case.environment.satellites:
        constellation = group.constellation
        exact = not isinstance(constellation, (glonass.Almanac, glonass.Nominal))
        if not exact:
            records: Any = None
            if time.size:
                records = glonass_broadcast.messages(constellation, *timescales.utc_from_gps(time[[0, -1]]))
        elif isinstance(constellation, (gps.Constellation, glonass_broadcast.Constellation)):
            used = constellation.chosen(np.repeat(time[:, None], len(group.names), axis=1))
            records = constellation.records.take(np.unique(used[used >= 0]))
        else:
            continue
        if records is None:
            continue
        branch = f"/navigation/{constellation.system}"
        for field in fields(records):
            data = np.asarray(getattr(records, field.name))
            unit = _MESSAGE_UNITS.get(field.name, "1")
            dims = ("message",) if data.ndim == 1 else ("message", "xyz")
            data = data.astype(np.int8) if data.dtype == bool else data
            v[f"{branch}/{field.name}"] = Variable(dims, data, unit, f"{field.name} of the navigation message")
        v[f"{branch}/message"] = Variable(
            ("message",), np.arange(len(records.healthy)), "1",
            "number of the message; exact: the satellites flew by these messages", {"exact": int(exact)},
        )  # fmt: skip
        if f"{branch}/position" in v:
            v[f"{branch}/xyz"] = Variable(("xyz",), np.array(["x", "y", "z"]), "1", "axes fixed to the Earth")


_MESSAGE_UNITS = {
    **dict.fromkeys(("toe", "toc"), "s"), "sqrt_a": "sqrt(m)",
    **dict.fromkeys(("i0", "omega0", "omega", "m0", "cuc", "cus", "cic", "cis"), "rad"),
    **dict.fromkeys(("delta_n", "omega_dot", "i_dot"), "rad/s"), **dict.fromkeys(("crc", "crs", "ura"), "m"),
    "af0": "s", "af1": "s/s", "af2": "s/s2", "tgd": "s",
    "time": "s", "position": "m", "velocity": "m/s", "acceleration": "m/s2", "tau": "s", "gamma": "s/s", "age": "day",
}  # fmt: skip


def geometry_summary(case: Case) -> dict[str, Variable]:
    """What the fixes of the glide owe to the geometry: DOPs and SKO."""
    v: dict[str, Variable] = {}
    world = case.world
    glide = on_glide(case.scenario, case.trajectory, world.signals.time)
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
    return v


def accuracy(
    v: dict[str, Variable],
    rms: np.ndarray,
    rpy: np.ndarray,
    horizontal: np.ndarray,
    vertical: np.ndarray,
    at: np.ndarray,
) -> None:
    """The accuracy table: rms (9, 3) of position, velocity, attitude, rpy (3, 3) of roll, pitch, yaw, horizontal and
    vertical (3,) of position, over the last seconds before touchdown; at (3, h, 3) lateral, along, vertical at the
    decision heights; last axis value, low, high."""
    over = "root mean square over runs and over 20 s to touchdown"
    for name, part, axis, unit in (
        ("position_ned", "position", "ned", "m"),
        ("velocity_ned", "velocity", "ned", "m/s"),
        ("attitude", "attitude", "ned", "rad"),
    ):
        v[f"/summary/rms/{name}"] = Variable(
            (axis, "interval"), rms[states.SLICES[part]], unit, f"{part} error, {over}"
        )
    v["/summary/rms/attitude_rpy"] = Variable(
        ("rpy", "interval"), rpy, "rad", f"roll, pitch, yaw error, true minus estimated, {over}"
    )
    v["/summary/rms/horizontal"] = Variable(("interval",), horizontal, "m", f"horizontal error, {over}")
    v["/summary/rms/vertical"] = Variable(("interval",), vertical, "m", f"vertical error, {over}")

    heights = np.array(DECISION_HEIGHTS_FT) * FOOT
    v["/summary/at/height"] = Variable(
        ("height",), heights, "m", "true height above the runway: touchdown, 50, 100, 200 ft"
    )
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}"] = Variable(
            ("height", "interval"),
            at[i],
            "m",
            f"root mean square over runs of the {name} position error",
        )


def belief(v: dict[str, Variable], variance: np.ndarray, rpy: np.ndarray, at: np.ndarray) -> None:
    """What the filter believes of the errors in the accuracy table: mean variances (15,) of the states and (3,) of
    roll, pitch, yaw over the last seconds before touchdown, and (h, 3) of lateral, along, vertical position at the
    decision heights; written as 1 sigma."""
    over = "1 sigma of the filter, root mean square over runs"
    late = f"{over} and over 20 s to touchdown"
    sigma = np.sqrt(variance)
    for name, part, axis, unit in (
        ("position_ned", "position", "ned", "m"),
        ("velocity_ned", "velocity", "ned", "m/s"),
        ("attitude", "attitude", "ned", "rad"),
    ):
        v[f"/summary/sigma/{name}"] = Variable((axis,), sigma[states.SLICES[part]], unit, f"{part}, {late}")
    v["/summary/sigma/attitude_rpy"] = Variable(("rpy",), np.sqrt(rpy), "rad", f"roll, pitch, yaw, {late}")
    horizontal = np.sqrt(variance[states.POS : states.POS + 2].sum())
    v["/summary/sigma/horizontal"] = Variable((), horizontal, "m", f"horizontal position, {late}")
    v["/summary/sigma/vertical"] = Variable((), sigma[states.POS + 2], "m", f"vertical position, {late}")
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}_sigma"] = Variable(("height",), np.sqrt(at[:, i]), "m", f"{name} position, {over}")
