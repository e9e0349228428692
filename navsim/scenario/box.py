"""The box that the position error of a landing is to stay in: section `box`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import NonNegative, Section, reject

Limit = Annotated[float, Field(ge=1e-3, le=1e6)] | None
"""A size that an error is not to exceed, m, if any."""


class BoxSection(Section):
    """Limits of the position error, truth minus estimate, or of the total system error, at a height; those left out are
    none."""

    height_m: NonNegative = 0.0
    """true height above the runway at which the error is judged, when the aircraft last comes down through it; 0:
    touchdown"""
    error: Literal["navigation", "total"] = "navigation"
    """what is to stay inside: the position error of the filter, or with it how far the way of the run is off its route,
    which is where an aircraft that steers its estimate ends; total is counted, of runs with ways of their own"""
    lateral_m: Limit = None
    """largest size of the error across the runway"""
    along_m: Limit = None
    """largest size of the error along the runway"""
    vertical_m: Limit = None
    """largest size of the error in height"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not any(self.limits()):
            raise reject("limits nothing: give lateral_m, along_m or vertical_m")
        return self

    def limits(self) -> tuple[float | None, float | None, float | None]:
        """Lateral, along, vertical."""
        return self.lateral_m, self.along_m, self.vertical_m
