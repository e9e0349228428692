"""Derived data of a published runway, written out before a scenario is checked: `auto` and derived numbers.

The resolved scenario contains the numbers, so that it gives the same flight without the extras that computed them.
"""

from __future__ import annotations

import datetime
import math
from typing import Any, TypeGuard

import numpy as np

from navsim.scenario_files.base import DEG, reject
from navsim.statistics.rounding import digits

STEEPEST = 5.0
"""Largest slope of a runway, percent."""
LONGEST_RUNWAY = 20e3
"""Distance between thresholds, m, that no runway comes near."""
_SAME = 1e-6
"""Numbers that agree so are one, deg or m."""


def with_published(data: Any) -> Any:
    """Data of a landing with the runway's derived numbers. Raises ValueError (`reject`) if there are none.

    Invalid data are left to the sections, which refuse them.
    """
    runway = data.get("runway") if isinstance(data, dict) else None
    if not isinstance(runway, dict):
        return data
    approach = data.get("approach")
    approach = approach if isinstance(approach, dict) else {}
    place = _point(runway.get("threshold")) or _point(approach.get("start"))
    runway = dict(runway)
    if runway.get("geoid_undulation_m") == "auto" and place is not None:
        from navsim.geodesy.geoid import NoGeoid, undulation

        try:
            runway["geoid_undulation_m"] = round(undulation(*place), 2)
        except NoGeoid as error:
            raise reject(str(error), "runway", "geoid_undulation_m") from None
    if runway.get("declination_deg") == "auto" and place is not None:
        from navsim.geodesy.magnetic import NoMagneticModel, declination

        year = runway.get("bearing_year") or _year(data.get("epoch"))
        try:
            if year is not None and _number(runway.get("height_m", 0.0)):
                found = declination(*place, float(runway.get("height_m", 0.0)), float(year))
                runway["declination_deg"] = round(found, 3)
        except NoMagneticModel as error:
            raise reject(str(error), "runway", "declination_deg") from None
    _check_thresholds(runway)
    _write_heading(runway)
    _write_length(runway)
    _write_slope(runway)
    if _number(runway.get("tch_m")):
        slope = approach.get("glide_slope_deg", 5.0)
        if approach.get("profile") in ("recorded", "track", "pad"):
            text = "a flight of a file, or onto a pad, has no slope that an aim point follows from"
            raise reject(text, "runway", "tch_m")
        if _number(slope) and 0.0 < slope < 90.0:
            rise = runway.get("slope_percent", 0.0)
            below = math.tan(slope * DEG) + (0.01 * rise if _number(rise) else 0.0)
            if below <= 0.0:
                raise reject("the glide does not meet a runway that falls so steeply", "runway", "tch_m")
            _write(runway, "aim_point_m", runway["tch_m"] / below, "tch_m")
    return {**data, "runway": runway}


def _check_thresholds(runway: dict[str, Any]) -> None:
    """Raise where the thresholds are farther apart than any runway is long."""
    first, end = _point(runway.get("threshold")), _point(runway.get("end"))
    if first is None or end is None or (apart := distance(first, end)) <= LONGEST_RUNWAY:
        return
    swapped = distance(first[::-1], end) <= LONGEST_RUNWAY or distance(first, end[::-1]) <= LONGEST_RUNWAY
    hint = "swap lat_deg and lon_deg of one of them" if swapped else "check lat_deg and lon_deg of both"
    raise reject(
        f"is {digits(apart / 1000.0, 4)} km from runway.threshold, and no runway is longer than "
        f"{LONGEST_RUNWAY / 1000.0:g} km: {hint}",
        "runway",
        "end",
    )


def _write_heading(runway: dict[str, Any]) -> None:
    """The direction of landing from both thresholds, or from the published bearing."""
    first, end = _point(runway.get("threshold")), _point(runway.get("end"))
    if first is not None and end is not None:
        heading = between(first, end)
        given = runway.get("heading_deg")
        if _number(given) and 0.0 <= given <= 360.0 and "bearing_deg" not in runway:
            if abs(turned(given, heading)) > _SAME:
                # the given one is the published one, which the thresholds replace
                runway["bearing_deg"], runway["bearing_is"] = given, "true"
            runway["heading_deg"] = heading
        _write(runway, "heading_deg", heading, "end")
        return
    bearing = runway.get("bearing_deg")
    if not _number(bearing):
        return
    if runway.get("bearing_is", "true") == "magnetic":
        if not _number(runway.get("declination_deg")):
            return
        bearing = bearing + runway["declination_deg"]
    _write(runway, "heading_deg", bearing % 360.0, "bearing_deg")


def _write(runway: dict[str, Any], key: str, value: float, source: str) -> None:
    given = runway.get(key)
    if given is None:
        runway[key] = value
    elif _number(given) and abs(given - value) > _SAME:
        raise reject(f"is {digits(value, 6)} by {source}; leave one of them out", "runway", key)


def _write_length(runway: dict[str, Any]) -> None:
    """Write the length of the runway from both thresholds, if it is missing."""
    first, end = _point(runway.get("threshold")), _point(runway.get("end"))
    if first is not None and end is not None and "length_m" not in runway:
        length = distance(first, end)
        if length > 0.0:
            runway["length_m"] = length


def _write_slope(runway: dict[str, Any]) -> None:
    """The slope of the runway from the heights of both thresholds."""
    first, end = _point(runway.get("threshold")), _point(runway.get("end"))
    height, other = runway.get("height_m"), runway.get("end_height_m")
    if first is None or end is None or not _number(other):
        return
    if height is None:
        raise reject("is the other threshold's beside height_m: give runway.height_m", "runway", "end_height_m")
    if _number(height) and (length := distance(first, end)) > 0.0:
        slope = 100.0 * (other - height) / length
        if abs(slope) > STEEPEST:
            text = f"{other:g} m beside height_m {height:g} m is a slope of {slope:.1f} % over {length:.0f} m"
            raise reject(f"{text}; at most {STEEPEST:g} are taken", "runway", "end_height_m")
        _write(runway, "slope_percent", slope, "end_height_m")


def between(first: tuple[float, float], end: tuple[float, float]) -> float:
    """Direction from a place to another, latitudes and longitudes, deg; clockwise from true north, 0 to 360 deg."""
    north, east = _north_east_offset(first, end)
    return math.degrees(math.atan2(east, north)) % 360.0


def distance(first: tuple[float, float], end: tuple[float, float]) -> float:
    """From a place to another, latitudes and longitudes, deg, in the plane of the first, m."""
    return math.hypot(*_north_east_offset(first, end))


def _north_east_offset(first: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    """Position north and east of another, m."""
    from navsim.geodesy.earth import ecef_from_llh, ned_matrix

    a, b = (np.array([*(math.radians(value) for value in each), 0.0]) for each in (first, end))
    north, east, _ = ned_matrix(a) @ (ecef_from_llh(b) - ecef_from_llh(a))
    return float(north), float(east)


def turned(a: float, b: float) -> float:
    """Angle from one direction to another, deg, -180 to 180."""
    return (b - a + 180.0) % 360.0 - 180.0


def _point(value: Any) -> tuple[float, float] | None:
    if not isinstance(value, dict) or not all(_number(value.get(key)) for key in ("lat_deg", "lon_deg")):
        return None
    return float(value["lat_deg"]), float(value["lon_deg"])


def _number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _year(epoch: Any) -> float | None:
    """The decimal year of an epoch as a file has it."""
    if isinstance(epoch, str):
        try:
            epoch = datetime.datetime.fromisoformat(epoch)
        except ValueError:
            return None
    if not isinstance(epoch, datetime.datetime):
        return None
    return epoch.year + (epoch.timetuple().tm_yday - 1) / 365.25
