"""The air: section `wind`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario_files.base import DEG, Azimuth, ListOf, NonNegative, Section, reject

if TYPE_CHECKING:
    from navsim.trajectory.air import Gust, MeanWind, Response, Turbulence

Speed = Annotated[float, Field(ge=0.0, le=50.0)]
"""Wind speed, m/s."""


def beside(keys: Sequence[tuple[str, ...]]) -> str:
    """Ends a refusal of the first of some keys by naming the others, which are refused for the same."""
    others = ", ".join(".".join(key) for key in keys[1:])
    return f"; the same goes for {others}" if others else ""


class WindLevel(Section):
    """The wind at a height."""

    height_m: NonNegative
    """height above the runway"""
    speed_m_s: Speed
    """speed of the wind over ground"""
    from_deg: Azimuth
    """direction the wind comes from, clockwise from true north"""


SEVERITIES = {"light": 15.0, "moderate": 30.0, "severe": 45.0}
"""Wind 20 ft above the ground, kt, that turbulence of a severity goes by (MIL-F-8785C)."""


class TurbulenceSection(Section):
    """Dryden turbulence of low altitude, another in each run; up to 1000 ft above the runway."""

    severity: Literal["light", "moderate", "severe"] | None = None
    """strength: as with 15, 30 or 45 kt 20 ft above the runway; null: from w20_m_s, or from the mean wind"""
    w20_m_s: Annotated[float, Field(gt=0.0, le=50.0)] | None = None
    """wind 20 ft above the runway that determines its strength; null: from severity, or the mean wind there"""
    specification: Literal["mil-f-8785c", "mil-hdbk-1797"] = "mil-f-8785c"
    """whose lengths and spectra: two forms of one model, which give the same"""

    @model_validator(mode="after")
    def _one_strength(self) -> Self:
        if self.severity is not None and self.w20_m_s is not None:
            raise reject("severity says it: give one of both", "w20_m_s")
        return self

    def model(self, mean: MeanWind) -> Turbulence:
        """The turbulence in a mean wind."""
        import numpy as np

        from navsim.trajectory.air import KNOT, REFERENCE, Turbulence

        if self.severity is not None:
            return Turbulence(SEVERITIES[self.severity] * KNOT, self.specification)
        if self.w20_m_s is not None:
            return Turbulence(self.w20_m_s, self.specification)
        return Turbulence(float(mean.profile.at(np.array([REFERENCE]))[0][0]), self.specification)


class GustSection(Section):
    """A 1 - cosine gust: it rises, stays, and falls as it rose; the same in all runs."""

    amplitude_m_s: Annotated[float, Field(ge=-50.0, le=50.0)]
    """speed of the air that is reached; negative: the other way"""
    towards: Literal["north", "east", "up", "along", "right", "wind"]
    """where it blows to: true north, east, up; along the course of the aircraft, level, or to the right of it; where
    the mean wind goes"""
    start_s: Annotated[float, Field(ge=0.0, le=1e5)]
    """when it begins"""
    ramp_s: Annotated[float, Field(ge=0.1, le=1e3)] | None = None
    """time in which it rises; null: use ramp_m"""
    ramp_m: Annotated[float, Field(ge=5.0, le=1e5)] | None = None
    """distance through the air in which it rises, at the airspeed of its start; null: use ramp_s"""
    hold_s: Annotated[float, Field(ge=0.0, le=1e5)] | None = None
    """time before it falls; null: it never does"""

    @model_validator(mode="after")
    def _one_ramp(self) -> Self:
        if (self.ramp_s is None) == (self.ramp_m is None):
            raise reject("give exactly one of ramp_s and ramp_m", "ramp_s")
        if self.amplitude_m_s == 0.0:
            raise reject("a gust of 0 m/s is none", "amplitude_m_s")
        return self

    def model(self) -> Gust:
        """The gust."""
        from navsim.trajectory.air import Gust

        by_way = self.ramp_s is None
        ramp = self.ramp_m if by_way else self.ramp_s
        assert ramp is not None
        hold = math.inf if self.hold_s is None else self.hold_s
        return Gust(self.amplitude_m_s, self.start_s, ramp, hold, self.towards, by_way)


class ResponseSection(Section):
    """Response of the aircraft to gusts and turbulence; the defaults are examples, of no aircraft in particular."""

    wing_loading_n_m2: Annotated[float, Field(ge=10.0, le=1e4)] = 200.0
    """weight by wing area"""
    lift_slope: Annotated[float, Field(ge=0.5, le=10.0)] = 5.0
    """of the coefficient of lift by the angle of attack, 1/rad"""
    side_force_slope: Annotated[float, Field(ge=0.05, le=5.0)] = 0.98
    """of the coefficient of side force by the sideslip, without its sign, 1/rad"""
    drag: Annotated[float, Field(ge=0.005, le=0.5)] = 0.06
    """coefficient of drag"""
    nose_lag_s: Annotated[float, Field(ge=0.1, le=5.0)] = 0.5
    """time constant of each of the two lags by which the nose turns into the wind behind a gust"""
    guidance_s: Annotated[float, Field(ge=0.5, le=60.0)] = 5.0
    """time constant of the critically damped loop that brings the aircraft back to its route; with `approach.guidance:
    estimate` until the flight begins"""

    def model(self) -> Response:
        """The response."""
        from navsim.trajectory.air import Response

        return Response(
            self.wing_loading_n_m2,
            self.lift_slope,
            self.side_force_slope,
            self.drag,
            self.nose_lag_s,
            self.guidance_s,
        )


class WindSection(Section):
    """The wind. A mean wind changes the attitude (crab), not the path, which is given over ground, or with
    `approach.speed_is: air` the speed along it; gusts and turbulence take each run off the path."""

    speed_m_s: Speed = 0.0
    """speed of the wind over ground: at every height, of profile log 20 ft above the runway, of power 10 m above it"""
    from_deg: Azimuth = 0.0
    """direction the wind comes from, clockwise from true north"""
    profile: Literal["constant", "log", "power", "table"] = "constant"
    """change of the wind with height: none, logarithmic law of MIL-F-8785C, power law, or `levels`; below 3 ft it is
    constant"""
    roughness_m: Annotated[float, Field(ge=1e-4, le=2.0)] = 0.04572
    """roughness length of profile log; MIL-F-8785C has 0.15 ft = 0.04572 m for approach and landing, 2 ft = 0.6096 m
    for other phases"""
    exponent: Annotated[float, Field(ge=0.01, le=1.0)] = 1.0 / 7.0
    """exponent of profile power; 0.11 over open water"""
    levels: Annotated[ListOf[WindLevel], Field(max_length=100)] = ()
    """the wind of profile table, linear between heights, and beyond them as at the nearest"""
    turbulence: TurbulenceSection | None = None
    """Dryden turbulence; null: none"""
    gusts: Annotated[ListOf[GustSection], Field(max_length=100)] = ()
    """gusts of the form 1 - cosine, that add up, with turbulence (3 sigma) to less than the airspeed"""
    response: ResponseSection = ResponseSection()
    """response of the aircraft to gusts and turbulence"""

    def unused(self) -> list[str]:
        """Keys without effect, as messages."""
        if self.blows or not self.from_deg:
            return []
        return ["wind.from_deg changes nothing: there is no mean wind; give wind.speed_m_s"]

    @model_validator(mode="after")
    def _of_its_profile(self) -> Self:
        given = self.model_fields_set
        for key, profile in (("roughness_m", "log"), ("exponent", "power"), ("levels", "table")):
            if key in given and self.profile != profile and getattr(self, key) != type(self).model_fields[key].default:
                raise reject(f"is for `profile: {profile}`", key)
        if self.profile == "table":
            if len(self.levels) < 2:
                raise reject("profile table needs two levels or more", "levels")
            for key in ("speed_m_s", "from_deg"):
                if getattr(self, key):
                    raise reject("the levels of profile table say it", key)
            for i, (lower, upper) in enumerate(zip(self.levels[:-1], self.levels[1:], strict=True), 1):
                if upper.height_m < lower.height_m + 0.1:
                    raise reject("heights of levels must rise by 0.1 m or more", "levels", i, "height_m")
        return self

    @model_validator(mode="after")
    def _of_the_mean_wind(self) -> Self:
        if not self.buffets and self.response != ResponseSection():
            raise reject("is for gusts and turbulence: give wind.turbulence or wind.gusts", "response")
        turbulence = self.turbulence
        if turbulence is not None and turbulence.model(self.mean(0.0)).wind == 0.0:
            raise reject("there is no mean wind to go by: give severity or w20_m_s", "turbulence")
        for i, gust in enumerate(self.gusts):
            if gust.towards == "wind" and not self.blows:
                raise reject("there is no mean wind to go with", "gusts", i, "towards")
        return self

    @property
    def buffets(self) -> bool:
        """Whether there are gusts, or turbulence."""
        return self.turbulence is not None or bool(self.gusts)

    @property
    def blows(self) -> bool:
        """Whether there is any mean wind."""
        return self.speed_m_s > 0.0 or any(level.speed_m_s > 0.0 for level in self.levels)

    def mean(self, heading: float) -> MeanWind:
        """The wind by height along path axes that point to `heading`, rad."""
        import numpy as np

        from navsim.trajectory.air import MeanWind, profiled

        if self.profile == "table":
            rows = [(level.height_m, level.speed_m_s, level.from_deg * DEG) for level in self.levels]
            return MeanWind(profiled("table", 0.0, 0.0, table=np.array(rows)), heading)
        parameter = {"log": self.roughness_m, "power": self.exponent}.get(self.profile, math.nan)
        return MeanWind(profiled(self.profile, self.speed_m_s, self.from_deg * DEG, parameter), heading)
