"""The runway, and points given in its axes: section `runway`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.aerodrome import STEEPEST, distance, turned
from navsim.scenario_files.base import (
    DEG,
    Azimuth,
    Latitude,
    Longitude,
    Section,
    Size,
    reject,
)

Reach = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Along or across a runway, m."""


class Point(Section):
    """A place on the ellipsoid."""

    lat_deg: Latitude
    """geodetic latitude"""
    lon_deg: Longitude
    """longitude, east positive"""

    @property
    def radians(self) -> tuple[float, float]:
        """Latitude and longitude, rad."""
        return self.lat_deg * DEG, self.lon_deg * DEG


_LOW, _MAST = 100.0, 30.0
"""Pseudolites above a runway higher than the first, m, and no more than the second above that height, were likely given
the height of a mast above the ellipsoid or the geoid."""


_USUAL_HEIGHTS = {"pseudolites": (-100.0, 1000.0), "beacons": (-1.0, 100.0)}
"""Heights above the runway, m, beyond which navsim doubts them. Valleys and hills reach those of pseudolites; beacons
are within sight of the strip."""


class Runway(Section):
    """The runway and where on it the aircraft touches down."""

    heading_deg: Azimuth = 0.0
    """direction of landing, clockwise from true north; with runway.end or runway.bearing_deg it follows from them"""
    bearing_deg: Azimuth | None = None
    """published direction of landing; null: heading_deg"""
    bearing_is: Literal["true", "magnetic"] = "true"
    """reference of bearing_deg; magnetic north needs declination_deg"""
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | Literal["auto"] | None = None
    """magnetic north from true north, east positive, when bearing_deg was measured; auto: of the World Magnetic Model,
    which needs the extra `magnetic`; the stored scenario has the number"""
    bearing_year: Annotated[float, Field(ge=1990.0, le=2100.0)] | None = None
    """decimal year of bearing_deg, for `declination_deg: auto`; null: that of epoch"""
    height_m: Annotated[float, Field(ge=-500.0, le=6000.0)] = 0.0
    """height above the WGS-84 ellipsoid, or above the geoid, see height_above"""
    height_above: Literal["ellipsoid", "geoid"] = "ellipsoid"
    """reference of height_m; geoid: sea level, as in published heights of runways"""
    geoid_undulation_m: Annotated[float, Field(ge=-120.0, le=100.0)] | Literal["auto"] | None = None
    """height of the geoid above the ellipsoid at the runway; auto: that of EGM96 at runway.threshold or approach.start,
    which needs the extra `geoid`; the stored scenario has the number"""
    slope_percent: Annotated[float, Field(ge=-STEEPEST, le=STEEPEST)] = 0.0
    """rise of the runway in the direction of landing, from the threshold on, which height_m is of; with end_height_m it
    follows from it"""
    end_height_m: Annotated[float, Field(ge=-500.0, le=6000.0)] | None = None
    """height of runway.end with the same reference as height_m, as published for both thresholds; null:
    slope_percent"""
    length_m: Size = 1000.0
    """length of the runway, for drawings, and, where runway.end is not given, for how far it rises by slope_percent; by
    default to runway.end where that is given"""
    width_m: Size = 30.0
    """width of the runway: for drawings, and for warnings of pseudolites on its pavement"""
    aim_point_m: Annotated[float, Field(ge=0.0, le=3000.0)] = 0.0
    """distance of the touchdown point beyond the threshold; with tch_m it follows from it"""
    tch_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """height above the threshold of the straight line down the glide slope to the touchdown point; null: aim_point_m"""
    threshold: Point | None = None
    """where the runway begins; leave out to derive it from approach.start, or from the recording of `profile:
    recorded`"""
    end: Point | None = None
    """threshold of the other direction; heading_deg becomes the direction to it and replaces the published one; null:
    none"""

    @model_validator(mode="after")
    def _above_geoid(self) -> Self:
        if self.height_above == "geoid" and self.geoid_undulation_m is None:
            raise reject("a height above the geoid needs the geoid's own above the ellipsoid", "geoid_undulation_m")
        return self

    @model_validator(mode="after")
    def _derived(self) -> Self:
        if self.end is not None and self.threshold is None:
            raise reject("is counted from the threshold: give runway.threshold", "end")
        if self.end_height_m is not None and self.end is None:
            raise reject("is of the threshold of the other direction: give runway.end", "end_height_m")
        if self.bearing_deg is None:
            for key in ("declination_deg", "bearing_year"):
                if getattr(self, key) is not None:
                    raise reject("is for a published direction: give bearing_deg", key)
            if self.bearing_is == "magnetic":
                text = "belongs to bearing_deg, which is not given; heading_deg counts from true north"
                raise reject(f"{text}: write the magnetic direction as bearing_deg, with declination_deg", "bearing_is")
        elif self.bearing_is == "magnetic" and not isinstance(self.declination_deg, float):
            raise reject("a direction from magnetic north needs the declination there", "declination_deg")
        return self

    def is_pavement(self, along: float, right: float) -> bool:
        """Whether a place, m from the threshold in the direction of landing and right of the centre line, is on it."""
        return 0.0 <= along <= self.length_m and abs(right) < 0.5 * self.width_m

    def on_pavement(self, what: str, places: Iterable[tuple[str, float, float]]) -> list[str]:
        """Warning about transmitters on it, by names and places as of `is_pavement`; empty for none."""
        on = [
            f"{name} ({along:.1f} m beyond the threshold, {abs(right):.1f} m off the centre line)"
            for name, along, right in places
            if self.is_pavement(along, right)
        ]
        most = f"{self.length_m:g} m by {self.width_m:g} m (runway.length_m, runway.width_m)"
        return [f"{what} on the pavement of the runway, {most}: {', '.join(on)}; move them off it"] if on else []

    @property
    def defaulted(self) -> list[str]:
        """Warnings about numbers of a runway with a position that are neither given nor follow from others."""
        if self.threshold is None:
            return []
        out = []
        if "heading_deg" not in self.model_fields_set:
            out.append(
                "runway.heading_deg is not given: 0 (north) is taken; write heading_deg, or the threshold of the other "
                "direction (end), or bearing_deg"
            )
        if "height_m" not in self.model_fields_set:
            out.append(
                "runway.height_m is not given: 0 m above the ellipsoid is taken; write height_m, and height_above: "
                "geoid with geoid_undulation_m for a height above sea level"
            )
        return out

    @property
    def misprint_deg(self) -> float:
        """Published direction minus that between the thresholds, deg; 0 if unknown."""
        if self.bearing_deg is None or self.end is None:
            return 0.0
        magnetic = self.declination_deg if self.bearing_is == "magnetic" else 0.0
        assert isinstance(magnetic, float)
        return turned(self.heading_deg, self.bearing_deg + magnetic)

    @property
    def undulation_m(self) -> float:
        """Height of the geoid above the ellipsoid, m. Raises ValueError if it is missing."""
        if not isinstance(self.geoid_undulation_m, float):
            raise ValueError("the undulation of the geoid is not given")
        return self.geoid_undulation_m

    @property
    def ellipsoidal_m(self) -> float:
        """Height above the ellipsoid, m."""
        return self.height_m + (self.undulation_m if self.height_above == "geoid" else 0.0)

    def doubted_height(self, key: str, height: float, of: Literal["pseudolites", "beacons"] = "pseudolites") -> str:
        """Warning about a height of a pseudolite or beacon above the runway, m, that is implausible; else empty.

        It is probably one above the ellipsoid or the geoid, or not that of an antenna on the ground.
        """
        deepest, highest = _USUAL_HEIGHTS[of]
        meant = (h for h in (self.ellipsoidal_m, self.height_m) if h > _LOW and 0.0 <= height - h <= _MAST)
        other = next(meant, None)
        if other is None and deepest <= height <= highest:
            return ""
        side = "above" if height > 0.0 else "below"
        text = f"{key}: {abs(height):g} m {side} the runway; heights of {of} are counted from the runway"
        if other is not None:
            return f"{text}, which is itself at {other:g} m; give {height - other:g} if that was meant"
        if of == "beacons" and height < 0.0:
            return f"{text}, up positive: this one is under the ground unless that falls there; give 0 or more"
        return (
            f"{text}, not from the ellipsoid or the geoid (the runway is {self.ellipsoidal_m:g} m above the "
            "ellipsoid); give the height of the antenna less that of the runway, and check runway.height_m"
        )

    @property
    def rise(self) -> float:
        """Slope in the direction of landing, m a m."""
        return 0.01 * self.slope_percent

    @property
    def rise_m(self) -> float:
        """Height of the touchdown point above the threshold, m."""
        return self.rise * self.aim_point_m

    @property
    def surface(self) -> tuple[tuple[float, float], ...]:
        """Distances beyond the threshold, m, and heights above it, m, between which the runway is straight; empty if it
        is level."""
        if self.slope_percent == 0.0:
            return ()
        return (0.0, 0.0), (self.extent_m, self.rise * self.extent_m)

    @property
    def extent_m(self) -> float:
        """Distance from the threshold to that of the other direction where it is given, else length_m."""
        if self.threshold is None or self.end is None:
            return self.length_m
        return distance(*((place.lat_deg, place.lon_deg) for place in (self.threshold, self.end)))

    @property
    def elevation_m(self) -> float:
        """Height above the geoid, m. Raises ValueError as of `undulation_m`."""
        return self.height_m - (self.undulation_m if self.height_above == "ellipsoid" else 0.0)
