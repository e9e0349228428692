"""Groups that the results of all landing studies share."""

from __future__ import annotations

from typing import Any

import numpy as np

from navsim.environment.sources import on_glide
from navsim.filter import states
from navsim.geodesy.earth import ned_matrix
from navsim.gnss import timescales
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.interference.horizon import skyline_elevation
from navsim.landing.case import Case, crossing_times, evaluated_heights
from navsim.results.builder import ResultBuilder
from navsim.results.schema import COVARIANCE, SKY_TIMES, SKYLINE
from navsim.runner.attributes import root_attributes
from navsim.scenario.approach import TrackApproach
from navsim.sensors.ground_stations import GroundStation
from navsim.trajectory.air import triangle_along
from navsim.trajectory.kinematics import Trajectory
from navsim.trajectory.recorded import largest


def start_result(case: Case, layout: str) -> ResultBuilder:
    """A draft of a layout of landing's result with the truth, the geometry and their summary."""
    draft = ResultBuilder(
        layout,
        {"mixed": ", ".join(dict.fromkeys(case.state_units))},
        sensor=[aid.sensor.name for aid in case.shared.aids],
        system=[group.constellation.system.name for group in case.environment.satellites],
    )
    _truth(draft, case)
    _wind(draft, case)
    _track(draft, case)
    _geometry(draft, case)
    _geometry_summary(draft, case)
    _navigation(draft, case)
    _interference(draft, case)
    _corrections(draft, case)
    return draft


def attributes(case: Case, seed: int) -> dict[str, Any]:
    """The root attributes of a landing's result."""
    return root_attributes("landing", seed, case.scenario_as_given, method=case.scenario.method)


def _truth(draft: ResultBuilder, case: Case) -> None:
    truth = case.shared.truth
    draft["/truth/time"] = truth.time
    draft["/truth/position_llh"] = truth.llh
    draft["/truth/velocity_ned"] = truth.velocity_ned
    draft["/truth/attitude_rpy"] = truth.rpy
    events = case.trajectory.path.events
    names = [n for n in events if events[n] <= case.scenario.duration_s]
    draft["/truth/event"] = np.array(names, dtype=object)
    draft["/truth/event_time"] = np.array([events[n] for n in names], dtype=float)
    draft["/truth/threshold_llh"] = case.scenario.threshold(case.trajectory.frame)


def _wind(draft: ResultBuilder, case: Case) -> None:
    """Write the mean wind along the trajectory, and the wind triangle at the decision heights, if there is wind."""
    if not case.scenario.wind.blows:
        return
    trajectory, truth = case.trajectory, case.shared.truth
    assert isinstance(trajectory, Trajectory)
    # the tangent plane's axes are those of the touchdown point, a wind's north is that of the place
    c_np = ned_matrix(truth.llh) @ trajectory.frame.axes
    draft["/truth/wind_ned"] = np.einsum("tij,tj->ti", c_np, trajectory.wind.mean(truth.time))
    draft["/truth/airspeed"] = triangle_along(trajectory, truth.time).airspeed
    passed = np.array(crossing_times(case))
    known = np.isfinite(passed)
    at = triangle_along(trajectory, passed[known])
    for name in ("headwind", "crosswind", "airspeed", "crab"):
        values = np.full(passed.size, np.nan)
        if name != "crab" or trajectory.body is None:  # a nose that keeps its heading does not answer the wind
            values[known] = getattr(at, name)
        draft[f"/summary/at/{name}"] = values


def _track(draft: ResultBuilder, case: Case) -> None:
    """Write the effect of smoothing on a trajectory from a table."""
    if not isinstance(case.scenario.approach, TrackApproach):
        return
    most = largest(case.trajectory, case.scenario.duration_s)
    draft["/summary/track/rms_smoothed"] = case.trajectory.path.rms_residual
    draft["/summary/track/specific_force"] = most.force
    draft["/summary/track/rate"] = most.rate


def _geometry(draft: ResultBuilder, case: Case) -> None:
    shared = case.shared
    s = shared.signals
    draft["/geometry/time"] = s.time
    draft["/geometry/source"] = np.array(s.names, dtype=object)
    draft.put("/geometry/clock", s.time_scale, {"clocks": ", ".join(CLOCKS)})
    draft["/geometry/line_of_sight"] = s.los
    for i, name in enumerate(("gdop", "pdop", "hdop", "vdop", "tdop")):
        draft[f"/geometry/{name}"] = shared.dop[:, i]
    some = np.unique(np.linspace(0, s.time.size - 1, min(SKY_TIMES, s.time.size)).astype(int))
    draft["/geometry/instant"] = s.time[some]
    draft["/geometry/azimuth"] = s.azimuth[some]
    draft["/geometry/elevation"] = s.elevation[some]
    if (horizon := case.environment.mask.horizon) is not None:
        draft["/geometry/bearing"] = horizon.azimuth
        draft["/geometry/horizon"] = horizon.elevation
    if case.environment.sight_placed:
        draft["/geometry/behind_terrain"] = case.behind_terrain().sum(axis=0)
    if case.environment.terrain.grids and s.time.size:
        around = np.linspace(0.0, 2.0 * np.pi, SKYLINE)
        draft["/geometry/skyline_azimuth"] = around
        draft["/geometry/skyline"] = skyline_elevation(case.environment.terrain, s.antenna[-1], around)
    if case.environment.antenna is not None:
        draft["/geometry/shadowed"] = case.preflight.shadowed.sum(axis=0)
    pseudolites = case.pseudolites
    draft["/pseudolites/name"] = np.array(pseudolites.names, dtype=object)
    draft["/pseudolites/position_llh"] = pseudolites.llh
    if stations := [aid.sensor for aid in case.shared.aids if isinstance(aid.sensor, GroundStation)]:
        draft["/stations/name"] = np.array([station.name for station in stations], dtype=object)
        draft["/stations/position_llh"] = np.array([station.llh(case.trajectory.frame) for station in stations])
    if (beacons := case.beacons) is not None:
        draft["/beacons/name"] = np.array(beacons.sensor.names, dtype=object)
        draft["/beacons/position_llh"] = beacons.llh
        draft["/beacons/time"], draft["/beacons/instant"] = s.time, s.time[some]
        draft["/beacons/received"] = beacons.received.sum(axis=0)
        for i, name in enumerate(("pdop", "hdop", "vdop")):
            draft[f"/beacons/{name}"] = beacons.dop[:, i]
            draft[f"/beacons/{name}_with_sources"] = beacons.dop_with_sources(s)[:, i]
        draft["/beacons/image_height"], draft["/beacons/image_residual"] = beacons.images(some)
    draft["/receiver/time"] = s.time
    draft["/receiver/covariance_enu"] = shared.fix_covariance


def _navigation(draft: ResultBuilder, case: Case) -> None:
    """Write the messages of the satellites, real or simulated, for an export to RINEX."""
    time = timescales.gps_from_utc(case.scenario.epoch.timestamp()) + case.shared.signals.time
    for group in case.environment.satellites:
        sent = group.constellation.messages(time)
        if sent is None:
            continue
        branch = f"/navigation/{group.constellation.system.name}"
        for name, values in sent.fields.items():
            draft[f"{branch}/{name}"] = values.astype(np.int8) if values.dtype == bool else values
        draft.put(f"{branch}/message", np.arange(len(sent.fields["healthy"])), {"exact": int(sent.exact)})
        if f"{branch}/position" in draft:
            draft[f"{branch}/xyz"] = np.array(["x", "y", "z"])


def _interference(draft: ResultBuilder, case: Case) -> None:
    """Write the effect of jammers on signals, if any."""
    jamming, s = case.environment.jamming, case.shared.signals
    if jamming is None:
        return
    ground = () if jamming.pseudolites is None else case.pseudolites.names
    draft["/interference/time"] = s.time
    draft["/interference/source"] = np.array(s.names, dtype=object)
    draft["/interference/jammer"] = np.array([*(jammer.name for jammer in jamming.jammers), *ground], dtype=object)
    draft["/interference/js"] = s.js
    draft["/interference/cn0"] = s.cn0
    draft["/interference/held"] = s.used.astype(np.int8)


def _corrections(draft: ResultBuilder, case: Case) -> None:
    """Write the age of corrections that come over a link."""
    station, s = case.environment.effects.reference, case.shared.signals
    if station is not None and station.link is not None:
        draft["/corrections/time"] = s.time
        draft["/corrections/age"] = s.correction_age


def geometry_summary(case: Case) -> ResultBuilder:
    """Summary of the geometry of the glide, DOPs and SKO, without the rest of a result."""
    draft = ResultBuilder(COVARIANCE)
    _geometry_summary(draft, case)
    return draft


def _geometry_summary(draft: ResultBuilder, case: Case) -> None:
    shared = case.shared
    glide = on_glide(case.scenario, case.trajectory, shared.signals.time)
    for i, name in enumerate(("gdop", "pdop", "hdop", "vdop", "tdop")):
        values = shared.dop[glide, i]
        draft[f"/summary/dop/{name}"] = _statistics(values[np.isfinite(values)])
    if (beacons := case.beacons) is not None:
        for i, name in enumerate(("pdop", "hdop", "vdop")):
            for end, every in (("", beacons.dop), ("_with_sources", beacons.dop_with_sources(shared.signals))):
                values = every[glide, i]
                draft[f"/summary/beacons/{name}{end}"] = _statistics(values[np.isfinite(values)])
    ground = np.isin(shared.signals.names, case.pseudolites.names)
    for name, chosen in (("satellites", ~ground), ("pseudolites", ground)):
        draft[f"/summary/used/{name}"] = _statistics(shared.signals.used[glide][:, chosen].sum(axis=1))

    variance = np.diagonal(shared.fix_covariance, axis1=1, axis2=2)[glide]
    variance = variance[np.isfinite(variance[:, 0])]
    for name, columns in (("rms_horizontal", [0, 1]), ("rms_vertical", [2]), ("rms_3d", [0, 1, 2])):
        each = np.sqrt(variance[:, columns].sum(axis=1))
        reach = {"minimum": each.min() if each.size else np.nan, "maximum": each.max() if each.size else np.nan}
        draft.put(f"/summary/fix/{name}", np.full(3, each.mean() if each.size else np.nan), reach)


def _statistics(values: np.ndarray) -> np.ndarray:
    """Mean, least, largest, median and 95th percentile of values (n,); nan without any."""
    if not values.size:
        return np.full(5, np.nan)
    return np.array([values.mean(), values.min(), values.max(), *np.percentile(values, [50, 95])])


def write_accuracy(
    draft: ResultBuilder,
    case: Case,
    rms: np.ndarray,
    rpy: np.ndarray,
    horizontal: np.ndarray,
    vertical: np.ndarray,
    at: np.ndarray,
) -> None:
    """Write the accuracy table over the last seconds before touchdown; last axis value, low, high.

    - `rms` (9, 3): position, velocity, attitude; `rpy` (3, 3): roll, pitch, yaw.
    - `horizontal`, `vertical` (3,): position.
    - `at` (3, h, 3): lateral, along, vertical at the evaluated heights.
    """
    for name, part in (("position_ned", "position"), ("velocity_ned", "velocity"), ("attitude", "attitude")):
        draft[f"/summary/rms/{name}"] = rms[states.SLICES[part]]
    draft["/summary/rms/attitude_rpy"] = rpy
    draft["/summary/rms/horizontal"] = horizontal
    draft["/summary/rms/vertical"] = vertical
    draft["/summary/at/height"] = np.array(list(evaluated_heights(case.scenario).values()))
    for i, name in enumerate(("lateral", "along", "vertical")):
        draft[f"/summary/at/{name}"] = at[i]


def write_filter_sigmas(draft: ResultBuilder, variance: np.ndarray, rpy: np.ndarray, at: np.ndarray) -> None:
    """Write the filter sigmas of the errors in the accuracy table.

    Mean variances over the last seconds before touchdown: (15,) of the states, (3,) of roll, pitch, yaw; and (h, 3) of
    lateral, along, vertical position at the decision heights.
    """
    sigma = np.sqrt(variance)
    for name, part in (("position_ned", "position"), ("velocity_ned", "velocity"), ("attitude", "attitude")):
        draft[f"/summary/sigma/{name}"] = sigma[states.SLICES[part]]
    draft["/summary/sigma/attitude_rpy"] = np.sqrt(rpy)
    draft["/summary/sigma/horizontal"] = np.sqrt(variance[states.POS : states.POS + 2].sum())
    draft["/summary/sigma/vertical"] = sigma[states.POS + 2]
    for i, name in enumerate(("lateral", "along", "vertical")):
        draft[f"/summary/at/{name}_sigma"] = np.sqrt(at[:, i])
