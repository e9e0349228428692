"""Export of a result to maps: GeoJSON and KML."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats.ridges import ridges
from navsim.formats.sweep_rows import heads, rows
from navsim.geodesy import earth
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.results.result import Result, ResultError, scenario_of

ELLIPSE_PROBABILITY = 0.95
_ELLIPSE_POINTS = 36
_ELLIPSES = 40
"""Largest number of error ellipses along a track."""
MOST_SITES = 20_000
"""Places of pseudolites on a map."""


def undulation_of(result: Result) -> float | None:
    """Height of the geoid above the ellipsoid, m, if the scenario has it."""
    runway = scenario_of(result).get("runway") or {}
    return None if runway.get("geoid_undulation_m") is None else float(runway["geoid_undulation_m"])


def origin_text(result: Result) -> str:
    return f"navsim {result.attributes['navsim_version']}, scenario {str(result.attributes['scenario_sha256'])[:16]}"


def route_at(result: Result, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """True position of the IMU on the route, rad, rad, m (n, 3), and attitude, rad (n, 3), at times (n,), s."""
    t = result["/truth/time"]

    def interpolated(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, t, column) for column in values.T], axis=1)

    llh = interpolated(earth.unwrap_longitude(result["/truth/position_llh"]))
    return llh, interpolated(np.unwrap(result["/truth/attitude_rpy"], axis=0))


def true_antenna(result: Result, time: np.ndarray | None = None) -> np.ndarray:
    """True position of the antenna, ECEF, m (n, 3), at times (n,), s, by default the fix epochs.

    It is the IMU's position plus the lever arm rotated by the true attitude, both interpolated between the stored
    times.
    """
    llh, attitude = route_at(result, result["/geometry/time"] if time is None else time)
    lever = dcm_from_rpy(attitude) @ np.array(scenario_of(result)["receiver"]["lever_arm_m"], dtype=float)
    return earth.ecef_from_llh(llh) + np.einsum("eij,ei->ej", earth.ned_matrix(llh), lever)


def ranges_output(result: Result) -> str:
    """Group of the trajectory of recorded ranges: "smoother" if the result has it, otherwise "filter"."""
    return "smoother" if "/smoother/position" in result else "filter"


def ranges_llh(result: Result, position: np.ndarray) -> np.ndarray:
    """Geodetic coordinates, rad, rad, m (n, 3), of positions (n, 3), m, in the axes of the sources.

    Raises ResultError if the positions of the sources are not geodetic.
    """
    if "/sources/origin_llh" not in result:
        raise ResultError("the sources have local positions, and a map needs latitude and longitude: export --csv")
    origin = result["/sources/origin_llh"]
    ned = position[:, [1, 0, 2]] * (1.0, 1.0, -1.0)
    return earth.llh_from_ecef(earth.ecef_from_llh(origin) + ned @ earth.ned_matrix(origin))


def _map_features(result: Result) -> list[dict[str, Any]]:
    """Track, error ellipses of fixes, pseudolites, runway, ridges: type, name, coordinates (lon, lat, height), ..."""
    if result.attributes["kind"] == "replay":
        path = [
            (name, result[f"/{group}/position_llh"]) for name, group in (("track", "filter"), ("fixes", "receiver"))
        ]
        return [
            {"kind": "track", "type": "LineString", "name": name, "coordinates": _lonlat(llh)} for name, llh in path
        ]
    if result.attributes["kind"] == "ranges":
        paths = f"/{ranges_output(result)}/position", "/sources/position"
        of_tag, sites = (ranges_llh(result, result[path]) for path in paths)
        route: dict[str, Any] = {"kind": "track", "type": "LineString", "name": "track", "coordinates": _lonlat(of_tag)}
        return [route, *(
            {"kind": "beacon", "type": "Point", "name": str(name), "coordinates": _lonlat(place[None])}
            for name, place in zip(result["/source"], sites, strict=True)
        )]  # fmt: skip
    if result.attributes["kind"] == "sweep":
        return [*_combinations(result), *_ridges(result)]
    if result.attributes["kind"] != "landing":
        return [*_placements(result), *_ridges(result)]
    llh = result["/truth/position_llh"]
    step = max(1, llh.shape[0] // 2000)
    track = np.concatenate([llh[::step], llh[-1:]])
    out: list[dict[str, Any]] = [
        {"kind": "track", "type": "LineString", "name": "track", "coordinates": _lonlat(track)}
    ]
    threshold = result["/truth/threshold_llh"]
    runway = scenario_of(result)["runway"]
    out.append(_runway(threshold, runway))
    out += _glide(result) + _ridges(result)
    for kind in ("pseudolite", "beacon", "station"):
        if f"/{kind}s/name" in result:
            for name, place in zip(result[f"/{kind}s/name"], result[f"/{kind}s/position_llh"], strict=True):
                out.append({"kind": kind, "type": "Point", "name": str(name), "coordinates": _lonlat(place[None])})
    covariance, antenna = result["/receiver/covariance_enu"], earth.llh_from_ecef(true_antenna(result))
    known = np.flatnonzero(np.isfinite(covariance[:, 0, 0]))
    scale = np.sqrt(-2.0 * np.log(1.0 - ELLIPSE_PROBABILITY))
    for e in known[:: max(1, known.size // _ELLIPSES)]:
        t = result["/geometry/time"][e]
        here = antenna[e]
        values, vectors = np.linalg.eigh(covariance[e, :2, :2])
        angle = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS + 1)
        circle = np.stack([np.cos(angle), np.sin(angle)]) * (scale * np.sqrt(values))[:, None]
        east, north = vectors @ circle
        ned = np.stack([north, east, np.zeros_like(north)], axis=1)
        out.append(
            {"kind": "ellipse", "type": "Polygon", "name": f"fix at {t:g} s",
             "coordinates": _lonlat(_offset(here, ned @ earth.ned_matrix(here))),
             "properties": {"t_s": float(t), "probability": ELLIPSE_PROBABILITY,
                            "semi_major_m": float(scale * np.sqrt(values[1])),
                            "semi_minor_m": float(scale * np.sqrt(values[0]))}}
        )  # fmt: skip
    return out


def _runway(threshold: np.ndarray, runway: Any) -> dict[str, Any]:
    axes = earth.heading_axes(threshold, np.radians(runway["heading_deg"]))
    half, length = 0.5 * runway["width_m"], runway["length_m"]
    far = -0.01 * runway.get("slope_percent", 0.0) * length  # down; runways of earlier versions are level
    corners = np.array([[0, -half, 0], [length, -half, far], [length, half, far], [0, half, 0], [0, -half, 0]])
    return {"kind": "runway", "type": "Polygon", "name": "runway",
            "coordinates": _lonlat(_offset(threshold, corners @ axes.T))}  # fmt: skip


def _glide(result: Result) -> list[dict[str, Any]]:
    """The path from the start of the glide to touchdown, where the flight has both."""
    events = dict(zip(map(str, result["/truth/event"]), result["/truth/event_time"].tolist(), strict=True))
    if "touchdown" not in events:
        return []
    time = result["/truth/time"]
    flown = (time >= events.get("glide_start", -np.inf)) & (time <= events["touchdown"])
    llh = result["/truth/position_llh"][flown]
    if len(llh) < 2:
        return []
    llh = np.concatenate([llh[:: max(1, len(llh) // 500)], llh[-1:]])
    return [{"kind": "glide", "type": "LineString", "name": "glide path", "coordinates": _lonlat(llh)}]


def _ridges(result: Result) -> list[dict[str, Any]]:
    """The tops of the terrain's ridges and skylines."""
    return [
        {"kind": "ridge", "type": "LineString", "name": ridge.name, "coordinates": _lonlat(ridge.llh),
         "properties": {"height_m": round(ridge.height, 3)}}
        for ridge in ridges(result)
    ]  # fmt: skip


def _placements(result: Result) -> list[dict[str, Any]]:
    """Positions of the pseudolites, or beacons, of a search, for each number of them."""
    beacons = scenario_of(result, "study").get("beacons") is not None
    kind, letters = ("beacon", "B") if beacons else ("pseudolite", "PL")
    height, found = float(scenario_of(result)["runway"]["height_m"]), result.variables["/pareto/objective"]
    out = []
    for i, k in np.argwhere(np.isfinite(result["/optimum/latitude"])):
        angles = (float(result[f"/optimum/{axis}"][i, k]) for axis in ("latitude", "longitude"))
        count = int(result["/pseudolites"][i])
        properties_ = {f"{kind}s": count, "objective": float(np.asarray(found.data)[i]), "unit": found.units,
                "s_m": float(result["/optimum/s"][i, k]), "l1_m": float(result["/optimum/l1"][i, k])}  # fmt: skip
        if "/optimum/up" in result:
            properties_["height_m"] = float(result["/optimum/up"][i, k])
        cost = float(result["/pareto/cost"][i]) if "/pareto/cost" in result else None
        if cost is not None:
            properties_["cost"] = cost
        name = f"{letters}{k + 1} of {count}" + ("" if cost is None else f" for {cost:.6g}")
        out.append(_site(name, np.array([*angles, height]), properties_) | {"kind": kind})
    return out


def _combinations(result: Result) -> list[dict[str, Any]]:
    """Runway, and positions of up to eight pseudolites of each combination of a sweep, with its settings and
    outputs."""
    if "/plan/threshold_llh" not in result:
        raise ResultError("the result is of an earlier version, which did not say where the runway is; sweep again")
    along, right = result["/plan/site_along"], result["/plan/site_right"]
    count = int(np.isfinite(right).sum())
    if count > MOST_SITES:
        text = f"{count:,} places are more than a map shows, {MOST_SITES:,}"
        raise ResultError(f"{text}; the result has them in /plan/site_along and site_right")
    threshold, runway = result["/plan/threshold_llh"], scenario_of(result)["runway"]
    axes = earth.heading_axes(threshold, np.radians(runway["heading_deg"]))
    names, out = heads(result), [_runway(threshold, runway)]
    for number, (i, row) in enumerate(rows(result)):
        plain = (value.item() if isinstance(value, np.generic) else value for value in row)
        properties_ = dict(zip(names, plain, strict=True))
        for k in np.flatnonzero(np.isfinite(right[i])):
            level = np.array([along[i][k], right[i][k], 0.0])
            # from the plane of the runway onto the Earth
            llh = _offset(threshold, level @ axes.T) * [1.0, 1.0, 0.0] + [0.0, 0.0, threshold[2]]
            out.append(_site(f"PL{k + 1}, combination {number + 1}", llh, properties_))
    return out


def _site(name: str, llh: np.ndarray, properties: dict[str, Any]) -> dict[str, Any]:
    """A place for a pseudolite, at the height of the runway."""
    properties_ = {
        key: value for key, value in properties.items() if not isinstance(value, float) or np.isfinite(value)
    }
    return {
        "kind": "pseudolite",
        "type": "Point",
        "name": name,
        "coordinates": _lonlat(llh[None]),
        "properties": properties_,
    }


def _offset(llh: np.ndarray, ecef: np.ndarray) -> np.ndarray:
    return earth.llh_from_ecef(earth.ecef_from_llh(llh) + ecef)


def _lonlat(llh: np.ndarray) -> list[list[float]]:
    """Longitude, latitude, deg, height, m, of positions (n, 3) of a line or ring.

    Beyond 180 degrees the longitude continues, since maps would draw the line around the Earth.
    """
    there = earth.unwrap_longitude(llh)
    return [
        [round(float(np.degrees(p[1])), 9), round(float(np.degrees(p[0])), 9), round(float(p[2]), 3)] for p in there
    ]


def write_geojson(result: Result, target: Path) -> dict[Path, str]:
    features = []
    for f in _map_features(result):
        features.append(
            {"type": "Feature", "geometry": _geometry(f["type"], f["coordinates"]),
             "properties": {"kind": f["kind"], "name": f["name"], **f.get("properties", {})}}
        )  # fmt: skip
    whole = {"type": "FeatureCollection", "features": features}
    return {target.with_suffix(".geojson"): json.dumps(whole, indent=1) + "\n"}


def _geometry(kind: str, coordinates: list[list[float]]) -> dict[str, Any]:
    """Geometry of RFC 7946, which requires lines and areas cut at 180 degrees, and outer rings counterclockwise."""
    parts = _cut_at_180(kind, coordinates)
    if kind == "Point":
        return {"type": kind, "coordinates": parts[0][0]}
    shapes: list[Any] = [[_counterclockwise(ring)] for ring in parts] if kind == "Polygon" else parts
    if len(shapes) == 1:
        return {"type": kind, "coordinates": shapes[0]}
    return {"type": f"Multi{kind}", "coordinates": shapes}


def _cut_at_180(kind: str, coordinates: list[list[float]]) -> list[list[list[float]]]:
    """The parts of a line, or the outer rings of those of an area, on either side of 180 degrees, in their order, with
    longitudes within 180 degrees."""
    turn = _turn(coordinates[0][0])
    whole = [[lon - 360.0 * turn, *rest] for lon, *rest in coordinates]
    return [whole] if all(abs(lon) <= 180.0 for lon, *_ in whole) else _cut(kind, coordinates)


def _cut(kind: str, coordinates: list[list[float]]) -> list[list[list[float]]]:
    if kind == "LineString":
        return _cut_line(coordinates)
    from shapely.geometry import Polygon, box

    whole, out = Polygon(coordinates), []
    for turn in range(_turn(whole.bounds[0]), _turn(whole.bounds[2]) + 1):
        middle = 360.0 * turn
        part = whole.intersection(box(middle - 180.0, -90.0, middle + 180.0, 90.0))
        for one in getattr(part, "geoms", [part]):
            if one.geom_type == "Polygon" and not one.is_empty:
                ring = one.exterior.coords
                out.append([[round(lon - middle, 9), round(lat, 9), round(h, 3)] for lon, lat, h in ring])
    return out


def _turn(longitude: float) -> int:
    """Number of times that a continued longitude has passed 180 degrees."""
    return math.floor((longitude + 180.0) / 360.0)


def _cut_line(coordinates: list[list[float]]) -> list[list[list[float]]]:
    """Parts of a line in its order, cut at every crossing."""
    parts: list[list[list[float]]] = [[]]
    before: list[float] | None = None
    for here in coordinates:
        if before is not None and (turn := _turn(here[0])) != _turn(before[0]):
            at = 360.0 * max(turn, _turn(before[0])) - 180.0
            share = (at - before[0]) / (here[0] - before[0])
            lat, h = (round(a + share * (b - a), digits) for a, b, digits in zip(before[1:], here[1:], (9, 3)))  # noqa: B905
            east = turn > _turn(before[0])
            parts[-1].append([180.0 if east else -180.0, lat, h])
            parts.append([[-180.0 if east else 180.0, lat, h]])
        parts[-1].append([round(here[0] - 360.0 * _turn(here[0]), 9), *here[1:]])
        before = here
    return [part for part in parts if len(part) > 1]


def _counterclockwise(ring: list[list[float]]) -> list[list[float]]:
    """Ring in counterclockwise order, which RFC 7946 requires of outer rings."""
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise(ring))
    return ring if area > 0.0 else ring[::-1]


def _kml_geometry(into: Any, kind: str, type_: str, coordinates: list[list[float]], separation: float) -> None:
    """Add a point, line or area to a placemark. separation: of the geoid, m; KML's heights are over the sea, and are
    those over the ellipsoid if the scenario does not have it (0)."""
    from xml.etree import ElementTree as Xml

    shape = Xml.SubElement(into, type_)
    on_ground = kind in ("runway", "ellipse", "pseudolite", "beacon", "station")
    if kind == "ridge":  # a wall down to the ground
        Xml.SubElement(shape, "extrude").text = "1"
    if type_ != "Point":
        Xml.SubElement(shape, "tessellate").text = "1"
    Xml.SubElement(shape, "altitudeMode").text = "clampToGround" if on_ground else "absolute"
    if type_ == "Polygon":
        shape = Xml.SubElement(Xml.SubElement(shape, "outerBoundaryIs"), "LinearRing")
    places = [(round(lon, 9), lat, *(round(h - separation, 3) for h in up)) for lon, lat, *up in coordinates]
    Xml.SubElement(shape, "coordinates").text = " ".join(",".join(map(str, place)) for place in places)


_STYLES = {"track": ("ffb27200", 2, "00ffffff"), "runway": ("ff777777", 1, "a0777777"),
           "ellipse": ("ff005ed5", 1, "30005ed5"), "pseudolite": ("ff005ed5", 1, "ff005ed5"),
           "beacon": ("ffa779cc", 1, "ffa779cc"), "station": ("ff552288", 1, "ff552288"),
           "glide": ("ff739e00", 2, "00ffffff"), "ridge": ("ff004b8c", 2, "60004b8c")}  # fmt: skip
"""Line colour (aabbggrr), width, fill."""


def write_kml(result: Result, target: Path) -> dict[Path, str]:
    from xml.etree import ElementTree as Xml

    separation = undulation_of(result) or 0.0
    kml = Xml.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = Xml.SubElement(kml, "Document")
    Xml.SubElement(document, "name").text = str(result.attributes.get("title") or target.stem)
    Xml.SubElement(document, "description").text = origin_text(result)
    for kind, (line, width, fill) in _STYLES.items():
        style = Xml.SubElement(document, "Style", id=kind)
        drawn = Xml.SubElement(style, "LineStyle")
        Xml.SubElement(drawn, "color").text = line
        Xml.SubElement(drawn, "width").text = str(width)
        Xml.SubElement(Xml.SubElement(style, "PolyStyle"), "color").text = fill
    for f in _map_features(result):
        mark = Xml.SubElement(document, "Placemark")
        Xml.SubElement(mark, "name").text = f["name"]
        Xml.SubElement(mark, "styleUrl").text = f"#{f['kind']}"
        # programs draw a line between longitudes of 180 and -180 degrees round the Earth
        parts = _cut_at_180(f["type"], f["coordinates"])
        into = mark if len(parts) == 1 else Xml.SubElement(mark, "MultiGeometry")
        for coordinates in parts:
            _kml_geometry(into, f["kind"], f["type"], coordinates, separation)
    Xml.indent(kml, space=" ")
    text = Xml.tostring(kml, encoding="unicode", xml_declaration=False)
    return {target.with_suffix(".kml"): '<?xml version="1.0" encoding="UTF-8"?>\n' + text + "\n"}
