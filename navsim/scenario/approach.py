"""The runway and the ways to it: sections `runway`, `approach`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import (
    DEG,
    KMH,
    Azimuth,
    Checksum,
    Latitude,
    LogTime,
    Longitude,
    Section,
    Size,
    Stretch,
    reject,
)

if TYPE_CHECKING:
    from navsim.models.path import Path


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


class Runway(Section):
    """The runway and where on it the aircraft touches down."""

    heading_deg: Azimuth = 0.0
    """direction of landing, clockwise from true north"""
    height_m: Annotated[float, Field(ge=-500.0, le=6000.0)] = 0.0
    """height above the WGS-84 ellipsoid, or above the geoid, as height_above says"""
    height_above: Literal["ellipsoid", "geoid"] = "ellipsoid"
    """what height_m is above; geoid: sea level, as published heights of runways are"""
    geoid_undulation_m: Annotated[float, Field(ge=-120.0, le=100.0)] | Literal["auto"] | None = None
    """height of the geoid above the ellipsoid at the runway; auto: that of EGM96 at runway.threshold or approach.start,
    which needs the extra `geoid`; the stored scenario has the number"""
    length_m: Size = 1000.0
    """length of the runway, for drawings only"""
    width_m: Size = 30.0
    """width of the runway, for drawings only"""
    aim_point_m: Annotated[float, Field(ge=0.0, le=3000.0)] = 0.0
    """distance of the touchdown point beyond the threshold"""
    threshold: Point | None = None
    """where the runway begins; leave out to derive it from approach.start"""

    @model_validator(mode="after")
    def _above_geoid(self) -> Self:
        if self.height_above == "geoid" and self.geoid_undulation_m is None:
            raise reject("a height above the geoid needs the geoid's own above the ellipsoid", "geoid_undulation_m")
        return self

    @property
    def undulation_m(self) -> float:
        """Height of the geoid above the ellipsoid, m. Raises ValueError where it is not given."""
        if not isinstance(self.geoid_undulation_m, float):
            raise ValueError("the undulation of the geoid is not given")
        return self.geoid_undulation_m

    @property
    def ellipsoidal_m(self) -> float:
        """Height above the ellipsoid, m."""
        return self.height_m + (self.undulation_m if self.height_above == "geoid" else 0.0)

    @property
    def elevation_m(self) -> float:
        """Height above the geoid, m. Raises ValueError as of `undulation_m`."""
        return self.height_m - (self.undulation_m if self.height_above == "ellipsoid" else 0.0)


class _Approach(Section):
    start: Point | None = None
    """where the simulation begins; leave out to derive it from runway.threshold"""
    start_height_m: Annotated[float, Field(ge=0.1, le=5000.0)] = 153.0
    """height above the runway at the start"""
    glide_slope_deg: Annotated[float, Field(ge=1.0, le=15.0)] = 5.0
    """angle of the glide path below the horizontal"""
    speed_start_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 130.0
    """speed at the start, along the path, over ground, or through the air by speed_is"""
    speed_touchdown_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 80.0
    """speed at touchdown, along the path, over ground, or through the air by speed_is"""
    speed_is: Literal["ground", "air"] = "ground"
    """what speeds are meant against: over ground, whatever the wind; through the air, which is held along the path"""
    angle_of_attack_deg: Annotated[float, Field(ge=-10.0, le=30.0)] = 3.0
    """constant angle of attack; pitch = path angle relative to the air + angle of attack"""
    pitch: Literal["path", "level"] = "path"
    """path: the nose follows the path; level: it keeps angle_of_attack_deg above the horizon"""


class STurn(_Approach):
    """Level flight turning right and left, not a landing: for filters to prove themselves in."""

    profile: Literal["s-turn"]
    """level turns to the right and to the left, no landing"""
    turn_rate_deg_s: Annotated[float, Field(ge=1e-3, le=45.0)] = 6.0
    """largest rate of turn"""
    period_s: Stretch = 30.0
    """time of one turn to the right and one to the left"""
    roll_s: Stretch = 2.0
    """time to roll from one side to the other"""

    def path(self) -> Path:
        """The path in the tangent plane of its first point, an hour long. Raises ValueError where there is none."""
        from navsim.models.approach import s_turn

        return s_turn(
            self.speed_start_kmh * KMH,
            self.start_height_m,
            self.turn_rate_deg_s * DEG,
            self.period_s,
            self.roll_s,
            3600.0,
        )


class PaperApproach(_Approach):
    """The paper's profile: uniformly decelerated glide from time 0, then level at the touchdown speed."""

    profile: Literal["paper"]
    """the paper's decelerated glide, then level at the touchdown speed"""
    corner_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.5
    """time within which the glide turns into level flight (instantaneous in the paper)"""

    def path(self) -> Path:
        """The path in the tangent plane of the touchdown point. Raises ValueError where there is none."""
        from navsim.models.approach import paper_profile

        return paper_profile(
            self.speed_start_kmh * KMH,
            self.speed_touchdown_kmh * KMH,
            self.start_height_m,
            self.glide_slope_deg * DEG,
            self.corner_s,
        )


class SmoothApproach(_Approach):
    """A profile an aircraft can fly: level lead-in, capture, decelerated glide, exponential flare, roll-out."""

    profile: Literal["smooth"]
    """one that an aircraft can fly, from level flight to the roll-out"""
    lead_in_s: Stretch = 35.0
    """level flight before the capture of the glide slope"""
    capture_s: Stretch = 6.0
    """duration of the transition onto the slope"""
    flare_height_m: Annotated[float, Field(ge=0.01, le=1000.0)] = 6.0
    """height above the runway at which the flare begins"""
    flare_blend_s: Stretch = 1.0
    """transition from the slope into the exponential flare"""
    touchdown_sink_m_s: Annotated[float, Field(ge=0.001, le=50.0)] = 0.5
    """rate of descent at touchdown"""
    settle_s: Stretch = 1.0
    """time in which the landing gear takes up the sink rate and the brakes come on"""
    rollout_deceleration_m_s2: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """deceleration by the brakes after touchdown"""

    def path(self) -> Path:
        """The path in the tangent plane of the touchdown point. Raises ValueError where there is none."""
        from navsim.models.approach import Ending, smooth_profile

        return smooth_profile(
            self.speed_start_kmh * KMH,
            self.speed_touchdown_kmh * KMH,
            self.start_height_m,
            self.glide_slope_deg * DEG,
            self.lead_in_s,
            self.capture_s,
            Ending(
                self.flare_height_m,
                self.flare_blend_s,
                self.touchdown_sink_m_s,
                self.settle_s,
                self.rollout_deceleration_m_s2,
            ),
        )


class RecordedApproach(Section):
    """A real flight, as `navsim replay` found it, with simulated sensors, satellites and pseudolites."""

    profile: Literal["recorded"]
    """a real flight, as `navsim replay` found it"""
    file: str
    """result of a replay; smoothed (filter.kind: rts) it is smoothest"""
    file_sha256: Checksum | None = None
    """its checksum; when given, another file is refused"""
    start_s: LogTime | None = None
    """time of the log that becomes time 0; default: the first there is"""
    touchdown_s: LogTime | None = None
    """time of the log at touchdown, for the figures there"""

    @property
    def start(self) -> Point | None:
        """Nothing: the recording says where it starts."""
        return None
