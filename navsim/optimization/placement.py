"""Constraints on a placement of pseudolites or beacons, as distances by which it violates them.

Axes s and l1 are those of the runway.

Source: [1] ICAO Annex 14, vol. I, 3.4 (runway strip) and table 4-1 (approach and transitional surfaces).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.formats import geojson
from navsim.geodesy.earth import ecef_from_llh, in_heading_axes
from navsim.gnss.interference.horizon import Terrain
from navsim.gnss.pseudolite import Track, runway_positions
from navsim.optimization.costs import CostModel, Permitted
from navsim.optimization.scenario import Constraints, Optimize, Strip, Surfaces
from navsim.results import files
from navsim.scenario.landing import Landing
from navsim.scenario.site_clearance import track_of
from navsim.scenario_files.base import DEG
from navsim.scenario_files.source import Document, InputError, Place, Problem

ObjectiveFunction = Callable[[np.ndarray], np.ndarray]
"""Values (n,) of placements (n, k, 2); smaller is better, not finite without a solution."""

_LOOKED_AT = 400
"""Points along each side of an area at which it is asked whether the files have heights."""


@dataclass(frozen=True)
class RunwayPlane:
    """The runway's plane: where places (s, l1) lie on the Earth, all at one height above it, or k each at its own.
    Places (s, l1, height) have their own. With files of heights these count from the ground."""

    threshold: np.ndarray
    heading: float
    height: float | np.ndarray
    terrain: Terrain | None = None

    def llh(self, places: np.ndarray) -> np.ndarray:
        """Antennas at places (..., 2 or 3), geodetic (..., 3), rad, rad, m."""
        out = runway_positions(self.threshold, self.heading, places[..., :2], 0.0)
        if self.terrain is not None:
            out[..., 2] = self.terrain.ground(out)
        out[..., 2] += self.antenna_heights(places)
        return out

    def antenna_heights(self, places: np.ndarray) -> np.ndarray | float:
        """Heights of antennas as the study counts them, above the plane or the ground, m."""
        return self.height if places.shape[-1] == 2 else places[..., 2]

    def heights(self, places: np.ndarray) -> np.ndarray | float:
        """Heights of antennas above the plane, m."""
        return self.antenna_heights(places) if self.terrain is None else self.above_runway(places)[..., 2]

    def above_runway(self, places: np.ndarray) -> np.ndarray:
        """Places (..., 2 or 3) as a scenario has them, whose heights count from the runway."""
        if self.terrain is None:
            return places
        return np.concatenate([places[..., :2], self.llh(places)[..., 2:] - self.threshold[2]], axis=-1)

    def ecef(self, places: np.ndarray) -> np.ndarray:
        """Positions in ECEF (..., 3), m."""
        return ecef_from_llh(self.llh(places))

    def places(self, llh: np.ndarray) -> np.ndarray:
        """Places (..., 2) of geodetic points (..., 3), m."""
        offset = in_heading_axes(ecef_from_llh(llh), self.threshold, self.heading)
        return np.stack([offset[..., 1], -offset[..., 0]], axis=-1)


@dataclass(frozen=True)
class Rules:
    """Constraints of a study over one approach.

    receiver: (e, 3) the antenna during the glide, ECEF m. track: the aircraft during the whole simulation. keep_out,
    permission: shapely geometries in (s, l1), or None. limit: of the cost.
    """

    given: Constraints
    plane: RunwayPlane
    runway_length: float
    receiver: np.ndarray
    track: Track
    keep_out: Any
    permission: Any = None
    costs: CostModel | None = None
    limit: float = math.inf

    def violation(self, places: np.ndarray) -> np.ndarray:
        """Violation of the tightest rule by placements (n, k, c), (n,); zero or less without one, -inf without rules.

        Metres, but for near_far_db, which counts in dB, and the limit of the cost, in thousandths of it.
        """
        worst = np.full(places.shape[0], -np.inf)
        for excess in self.excesses(places).values():
            np.maximum(worst, excess, out=worst)
        return worst

    def excesses(self, places: np.ndarray) -> dict[str, np.ndarray]:
        """Violation of each rule by placements (n, k, 2), (n,), by its key below `constraints`; zero or less without
        one.

        `aircraft` is the distance of pseudolites from it. Metres, but for near_far_db: dB.
        """
        s, l1 = places[..., 0], places[..., 1]
        found: dict[str, np.ndarray] = {}

        def keep(rule: str, excess: np.ndarray) -> None:
            worst = excess.reshape(places.shape[0], -1).max(axis=1)
            found[rule] = np.maximum(worst, found.get(rule, worst))

        if self.given.runway_strip is not None:
            keep("runway_strip", _into_strip(self.given.runway_strip, self.runway_length, s, l1))
        if self.given.surfaces is not None:
            keep(
                "surfaces", self.plane.heights(places) - surface_height(self.given.surfaces, self.runway_length, s, l1)
            )
        for rule, area, sign in (("keep_out", self.keep_out, 1.0), ("permission", self.permission, -1.0)):
            if area is not None:
                import shapely

                depth = shapely.distance(shapely.points(s, l1), area.boundary)
                keep(rule, sign * np.where(shapely.contains_xy(area, s, l1), depth, -depth))
        if self.costs is not None and math.isfinite(self.limit):
            keep("costs", 1e3 * (self.costs.total(places, self.plane.antenna_heights(places)) / self.limit - 1.0))
        count = places.shape[1]
        if count:
            keep("aircraft", self.track.too_near(self.plane.ecef(places)))
        for i in range(count):
            for j in range(i):
                keep("spacing_m", self.given.spacing_m - np.hypot(s[:, i] - s[:, j], l1[:, i] - l1[:, j]))
        if self.given.distance_m is not None or self.given.near_far_db is not None:
            sites = self.plane.ecef(places)
            # an axis after the other: (n, k, e, 3) at one go takes twice as long
            squares = sum((sites[..., i, None] - self.receiver[:, i]) ** 2 for i in range(3))
            near, far = np.sqrt(np.min(squares, axis=2)), np.sqrt(np.max(squares, axis=2))
            if self.given.distance_m is not None:
                keep("distance_m", np.maximum(self.given.distance_m[0] - near, far - self.given.distance_m[1]))
            if self.given.near_far_db is not None:
                keep("near_far_db", 20.0 * np.log10(far / near) - self.given.near_far_db)
        return found


def _into_strip(strip: Strip, length: float, s: np.ndarray, l1: np.ndarray) -> np.ndarray:
    """Depth of positions in the runway strip, negative outside, m."""
    across = strip.half_width_m - np.abs(s)
    before = strip.beyond_m - l1
    past = l1 + length + strip.beyond_m
    return np.minimum(across, np.minimum(before, past))


def surface_height(surfaces: Surfaces, length: float, s: np.ndarray, l1: np.ndarray) -> np.ndarray:
    """Height above the runway of the approach and transitional surfaces, which limit obstacles, m [1].

    The approach surface rises from `from_threshold_m` before the threshold; beside it and beside the strip the
    transitional surface rises outwards. The same holds at the far end, for landings from there.
    """
    outside = np.maximum(l1, -length - l1) - surfaces.from_threshold_m
    outwards = np.maximum(outside, 0.0)
    half = 0.5 * surfaces.inner_edge_m + 0.01 * surfaces.divergence_percent * outwards
    beside = np.maximum(np.abs(s) - half, 0.0)
    return 0.01 * (surfaces.approach_slope_percent * outwards + surfaces.transitional_slope_percent * beside)


def rules(study: Optimize, document: Document, scenario: Landing, receiver: np.ndarray, power: float) -> Rules:
    """The constraints ready to be asked, with the checksums of their files. power: cost of the transmitter power of a
    source. Raises InputError for a file of polygons that cannot be used."""
    trajectory = scenario.trajectory()
    threshold = scenario.threshold(trajectory.frame)
    ground = scenario.terrain_around(trajectory.frame) if study.height_above == "ground" else None
    if ground is not None and not ground.grids:
        text = f"{study.base} has no `file` of heights under `terrain`, which ground is taken from"
        raise InputError([Problem(document.place(("height_above",)), "height_above", text)])
    plane = RunwayPlane(threshold, scenario.runway.heading_deg * DEG, study.height_m, ground)
    places = np.array([(site.s_m, site.l1_m) for site in study.sites]).reshape(-1, 2)
    if study.area is not None and ground is not None:
        axes = (np.linspace(*ends, _LOOKED_AT) for ends in (study.area.s_m, study.area.l1_m))
        places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    unknown = places[:0] if ground is None else places[np.isnan(plane.llh(places)[..., 2])]
    if len(unknown):
        text = f"the files of heights have none at s, l1 of {unknown[0, 0]:.0f}, {unknown[0, 1]:.0f} m"
        raise InputError([Problem(document.place(("height_above",)), "height_above", text)])
    height, sums = scenario.runway.ellipsoidal_m, {}
    areas: dict[str, list[Permitted]] = {"keep_out": [], "permission": []}
    for name, found in areas.items():
        given, key = getattr(study.constraints, name), ("constraints", name)
        if given is None:
            continue
        path = document.resolve(key, given)
        try:
            content = files.content(path, _MOST_BYTES)
            checksum = hashlib.sha256(content).hexdigest()
            if getattr(study.constraints, f"{name}_sha256") not in (None, checksum):
                key = ("constraints", f"{name}_sha256")
                message = f"{given} has the checksum {checksum}, not this one"
                raise InputError([Problem(document.place(key), f"constraints.{name}_sha256", message)])
            sums[f"{name}_sha256"] = checksum
            found += _polygons(content, plane, height, name == "permission")
        except ValueError as error:
            raise InputError([Problem(Place(str(path)), "", f"{error} (named at {document.place(key)})")]) from None
        except OSError as error:
            message = f"{path}: cannot be read: {error.strerror or error}"
            raise InputError([Problem(document.place(key), f"constraints.{name}", message)]) from None
    keep_out, permission = (_union(found) for found in areas.values())
    if study.costs is None and any(cost for _, cost in areas["permission"]):
        message = "polygons have a `cost`, which needs `costs`; `costs: {}` counts this alone"
        raise InputError([Problem(document.place(("constraints", "permission")), "constraints.permission", message)])
    return Rules(
        study.constraints.model_copy(update=sums), plane, scenario.runway.length_m, receiver,
        track_of(scenario, trajectory), keep_out, permission, CostModel.of(study, power, tuple(areas["permission"])),
    )  # fmt: skip


def _union(found: list[Permitted]) -> Any:
    """All polygons as one geometry; None without any."""
    import shapely

    return shapely.unary_union([area for area, _ in found]) if found else None


def _polygons(content: bytes, plane: RunwayPlane, height: float, priced: bool) -> list[Permitted]:
    """The polygons of a GeoJSON file's content, in (s, l1), if `priced` with their property `cost`, else with 0. Raises
    ValueError for all else in it."""
    import shapely

    found, pieces = [], 0.0
    for i, (geometry, properties) in enumerate(geojson.features(content)):
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        if not isinstance(geometry, dict) or kind not in ("Polygon", "MultiPolygon"):
            raise ValueError(f"feature {i}: {kind!r:.40} is not a Polygon or MultiPolygon")
        try:
            polygon = _geometry(kind, geometry.get("coordinates"))
        except (ValueError, shapely.errors.ShapelyError) as error:
            raise ValueError(f"feature {i}: not a polygon: {error}") from None
        cost = properties.get("cost", 0.0) if priced else 0.0
        if type(cost) not in (int, float) or not 0.0 <= cost < math.inf:
            raise ValueError(f"feature {i}: cost {cost!r:.40} is not a number from 0")

        def to_plane(coordinates: np.ndarray) -> np.ndarray:
            llh = np.column_stack([coordinates[:, 1] * DEG, coordinates[:, 0] * DEG, np.full(len(coordinates), height)])
            return plane.places(llh)

        if not polygon.is_valid:
            raise ValueError(f"feature {i}: {shapely.is_valid_reason(polygon)}")
        pieces += shapely.get_num_coordinates(polygon) + polygon.length / _STEP_DEG
        if pieces > _MOST_POINTS:
            message = f"more than {_MOST_POINTS:,} points, in steps of {_STEP_DEG:g} degrees along the outlines"
            raise ValueError(f"feature {i}: {message}")
        found.append(Permitted(shapely.transform(shapely.segmentize(polygon, _STEP_DEG), to_plane), float(cost)))
    if not found:
        raise ValueError("no polygons in it")
    return found


_MOST_BYTES = 10_000_000
"""Largest size of a keep-out file."""
_STEP_DEG = 5e-4
"""Edges are straight in longitude and latitude (RFC 7946): pieces as short as this keep them so to 0.1 mm."""
_MOST_POINTS = 500_000
"""Largest number of points of all outlines in a file: some 25 000 km of them."""


def _geometry(kind: str, coordinates: Any) -> Any:
    """The shapely geometry of a GeoJSON geometry's coordinates. Raises ValueError, or shapely's own."""
    import shapely

    def polygon(value: Any) -> Any:
        shell, *holes = (
            [geojson.point(p) for p in geojson.parts(ring, "points")] for ring in geojson.parts(value, "rings")
        )
        return shapely.Polygon(shell, holes)

    if kind == "Polygon":
        return polygon(coordinates)
    return shapely.MultiPolygon([polygon(value) for value in geojson.parts(coordinates, "polygons")])
