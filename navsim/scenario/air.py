"""The air: section `wind`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import DEG, Azimuth, NonNegative, Section, list_of, reject

if TYPE_CHECKING:
    from navsim.models.air import MeanWind

Speed = Annotated[float, Field(ge=0.0, le=50.0)]
"""Of a wind, m/s."""


class WindLevel(Section):
    """The wind at a height."""

    height_m: NonNegative
    """height above the runway"""
    speed_m_s: Speed
    """speed of the wind over ground"""
    from_deg: Azimuth
    """direction the wind comes from, clockwise from true north"""


class WindSection(Section):
    """Mean wind. It changes the attitude (crab), not the path, which is given over ground, or with `approach.speed_is:
    air` the speed along it."""

    speed_m_s: Speed = 0.0
    """speed of the wind over ground: at every height, of profile log 20 ft above the runway, of power 10 m above it"""
    from_deg: Azimuth = 0.0
    """direction the wind comes from, clockwise from true north"""
    profile: Literal["constant", "log", "power", "table"] = "constant"
    """how the wind changes with height: not at all, by the logarithmic law of MIL-F-8785C, by a power law, as `levels`
    say; below 3 ft it stays what it is there"""
    roughness_m: Annotated[float, Field(ge=1e-4, le=2.0)] = 0.04572
    """roughness length of profile log; MIL-F-8785C has 0.15 ft = 0.04572 m for approach and landing, 2 ft = 0.6096 m
    for other phases"""
    exponent: Annotated[float, Field(ge=0.01, le=1.0)] = 1.0 / 7.0
    """exponent of profile power; 0.11 over open water"""
    levels: Annotated[list_of(WindLevel), Field(max_length=100)] = ()  # type: ignore[valid-type]
    """the wind of profile table, linear between heights, and beyond them as at the nearest"""

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

    @property
    def blows(self) -> bool:
        """Whether there is any wind."""
        return self.speed_m_s > 0.0 or any(level.speed_m_s > 0.0 for level in self.levels)

    def mean(self, heading: float) -> MeanWind:
        """The wind by height along path axes that point to `heading`, rad."""
        import numpy as np

        from navsim.models.air import MeanWind, profiled

        if self.profile == "table":
            rows = [(level.height_m, level.speed_m_s, level.from_deg * DEG) for level in self.levels]
            return MeanWind(profiled("table", 0.0, 0.0, table=np.array(rows)), heading)
        parameter = {"log": self.roughness_m, "power": self.exponent}.get(self.profile, math.nan)
        return MeanWind(profiled(self.profile, self.speed_m_s, self.from_deg * DEG, parameter), heading)
