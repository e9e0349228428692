"""GeoJSON files: features with geometries of any type.

Source: RFC 7946.
"""

from __future__ import annotations

import json
from typing import Any

from navsim.formats.text import decoded


def features(content: bytes) -> list[tuple[Any, dict[str, Any]]]:
    """Geometries of a file's content, each with its properties. Raises ValueError unless it is GeoJSON."""
    try:
        data = json.loads(decoded(content))
    except RecursionError:
        raise ValueError("not a GeoJSON file: nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not a GeoJSON file: {error}") from None
    if not isinstance(data, dict):
        raise ValueError("not a GeoJSON file: its top level is not an object")
    found = data.get("features") if data.get("type") == "FeatureCollection" else [data]
    if not isinstance(found, list):
        raise ValueError("not a GeoJSON file: its features are no list")
    out = []
    for feature in found:
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        properties = feature.get("properties") if isinstance(feature, dict) else None
        out.append((geometry, properties if isinstance(properties, dict) else {}))
    return out


def parts(value: Any, what: str) -> list[Any]:
    """A list with something in it. Raises ValueError."""
    if not isinstance(value, list) or not value:
        raise ValueError(f"{what} are due in a list that is not empty")
    return value


def point(value: Any) -> tuple[float, float]:
    """Longitude and latitude, deg. Raises ValueError."""
    numbers = isinstance(value, list) and all(type(x) in (int, float) for x in value)  # false is no number
    if not numbers or len(value) not in (2, 3):
        raise ValueError("a point is a list of numbers: longitude, latitude, and height where it is given")
    if not (abs(value[0]) <= 360.0 and abs(value[1]) <= 90.0):
        raise ValueError("coordinates are longitude, latitude in degrees")
    return value[0], value[1]


MOST_BYTES = 10_000_000
"""Largest size of a file of outlines."""
MOST_POINTS = 200_000
"""Largest number of points of an overlay."""


def lines(content: bytes) -> list[tuple[str, list[list[tuple[float, float]]], str]]:
    """Shapes of a file: for each feature `area`, `line` or `point`, with coordinates and name, "" for none.

    Coordinates are lists of longitude and latitude, deg, of its rings, lines or points. A feature without a geometry
    gives nothing. Raises ValueError, with the number of the feature.
    """
    out: list[tuple[str, list[list[tuple[float, float]]], str]] = []
    count = 0
    for i, (geometry, properties) in enumerate(features(content)):
        name = properties.get("name")
        text = name[:40] if isinstance(name, str) else ""
        try:
            for what, rings in _drawn(geometry):
                count += sum(map(len, rings))
                if count > MOST_POINTS:
                    raise ValueError(f"more than {MOST_POINTS:,} points")
                out.append((what, rings, text))
        except ValueError as error:
            raise ValueError(f"feature {i}: {error}") from None
    return out


def _drawn(geometry: Any, within: bool = False) -> list[tuple[str, list[list[tuple[float, float]]]]]:
    if geometry is None:
        return []
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind == "GeometryCollection" and not within:
        return [each for one in parts(geometry.get("geometries"), "geometries") for each in _drawn(one, within=True)]
    given = geometry.get("coordinates") if isinstance(geometry, dict) else None

    def along(value: Any) -> list[tuple[float, float]]:
        return [point(each) for each in parts(value, "points")]

    def rings(value: Any) -> list[list[tuple[float, float]]]:
        return [along(ring) for ring in parts(value, "rings")]

    if kind == "Point":
        return [("point", [[point(given)]])]
    if kind == "MultiPoint":
        return [("point", [[each] for each in along(given)])]
    if kind == "LineString":
        return [("line", [along(given)])]
    if kind == "MultiLineString":
        return [("line", rings(given))]
    if kind == "Polygon":
        return [("area", rings(given))]
    if kind == "MultiPolygon":
        return [("area", rings(each)) for each in parts(given, "polygons")]
    raise ValueError(f"{kind!r:.40} is not a geometry")
