"""The box that the position error of a landing is to stay in: section `box`."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from navsim.scenario_files.base import NonNegative, Pair, Section, reject

_LEAST = 1e-3
Limit = (
    Annotated[
        Annotated[float, Field(ge=_LEAST, le=1e6), Tag("size")] | Annotated[Pair, Tag("pair")],
        Discriminator(lambda value: "pair" if isinstance(value, list | tuple) else "size"),
    ]
    | None
)
"""A size that an error is not to exceed, m, or the least and the largest that it may be, if any."""
_LIMITS = ("lateral_m", "along_m", "vertical_m", "from_threshold_m")


class BoxSection(Section):
    """Limits of the position error, truth minus estimate, or of the total system error, at a height; those left out are
    none."""

    height_m: NonNegative = 0.0
    """true height above the runway at which the error is evaluated, at the last descent through it; 0: touchdown"""
    error: Literal["navigation", "total", "touchdown"] = "navigation"
    """error that must stay inside: the filter's position error, or with total also the run's distance from its route.
    An aircraft that steers by its estimate ends there. touchdown: the place where the run meets the runway, from that
    of the route, early or late by its error in height. `total` and `touchdown` are for runs that leave their route"""
    lateral_m: Limit = None
    """largest size of the error across the runway, or its limits to the left (below 0) and to the right"""
    along_m: Limit = None
    """largest size of the error along the runway, or its limits backward (below 0) and forward"""
    from_threshold_m: Pair | None = None
    """limits along the runway, counted from the threshold, in place of along_m. They bound the route's place plus the
    error: with `error: total` this is the touchdown zone"""
    vertical_m: Limit = None
    """largest size of the error in height, or its limits downward (below 0) and upward"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        given: dict[str, Any] = {name: value for name in _LIMITS if (value := getattr(self, name)) is not None}
        if not given:
            raise reject("limits nothing: give lateral_m, along_m, from_threshold_m or vertical_m")
        if {"along_m", "from_threshold_m"} <= given.keys():
            raise reject("is the limit along the runway that along_m is; leave one of them out", "from_threshold_m")
        if self.error == "touchdown" and self.height_m:
            raise reject("is for other errors: `error: touchdown` is where the run meets the runway", "height_m")
        if self.error == "touchdown" and self.vertical_m is not None:
            text = "an aircraft touches down at the height of the runway: give lateral_m, along_m or from_threshold_m"
            raise reject(text, "vertical_m")
        for name, value in given.items():
            if isinstance(value, tuple) and not value[1] - value[0] >= _LEAST:
                raise reject(f"the lower limit comes first, and is below the other by {_LEAST:g} m at least", name)
        return self

    def limits(self, place: float) -> tuple[list[float], list[float]]:
        """Least and largest lateral, along-track and vertical error, m, infinite for none, where the route is this far
        along the runway from its threshold, m."""
        along: Any = self.along_m
        if self.from_threshold_m is not None:
            along = tuple(end - place for end in self.from_threshold_m)
        ends = [_both(limit) for limit in (self.lateral_m, along, self.vertical_m)]
        return [low for low, _ in ends], [high for _, high in ends]


def _both(limit: float | tuple[float, float] | None) -> tuple[float, float]:
    if isinstance(limit, tuple):
        return limit
    size = math.inf if limit is None else limit
    return -size, size
