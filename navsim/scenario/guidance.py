"""How runs deviate from the route: keys of flight-technical errors, the autopilot, the deviations that a pilot sees."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.runway import Runway
from navsim.scenario_files.base import (
    DEG,
    Section,
    reject,
)

if TYPE_CHECKING:
    from navsim.trajectory.air import Deviation
    from navsim.trajectory.autopilot import Autopilot

MOST_ACCELERATION = 3.0
"""1 sigma of the acceleration of a flight-technical error, m/s2, beyond which it is none."""


class DeviationSection(Section):
    """A flight-technical error along one axis: third-order Gauss-Markov, of finite acceleration."""

    sigma_m: Annotated[float, Field(ge=1e-3, le=200.0)]
    """1 sigma; with reference_height_m that at this height"""
    correlation_time_s: Annotated[float, Field(ge=1.0, le=300.0)] = 10.0
    """integral of the normalised autocorrelation"""
    reference_height_m: Annotated[float, Field(ge=1.0, le=5000.0)] | None = None
    """height above the runway where 1 sigma is sigma_m, in proportion to which it shrinks, as by angular guidance;
    null: it is the same at all heights"""
    floor_m: Annotated[float, Field(ge=0.0, le=200.0)] = 0.0
    """1 sigma that is left at no height, with reference_height_m; adds in squares"""

    @model_validator(mode="after")
    def _flyable(self) -> Self:
        if self.floor_m and self.reference_height_m is None:
            raise reject("is for an error that shrinks: give reference_height_m", "floor_m")
        acceleration = self.sigma_m * self.model().beta ** 2
        if acceleration > MOST_ACCELERATION:
            raise reject(
                f"an error of {self.sigma_m:g} m that lasts {self.correlation_time_s:g} s has accelerations of 1 sigma "
                f"{acceleration:.1f} m/s2; at most {MOST_ACCELERATION:g} are taken",
                "correlation_time_s",
            )
        return self

    def model(self) -> Deviation:
        """The process."""
        from navsim.trajectory.air import Deviation

        if self.reference_height_m is None:
            return Deviation(self.sigma_m, self.correlation_time_s)
        return Deviation(self.sigma_m, self.correlation_time_s, self.floor_m, self.reference_height_m)


class FlightTechnicalErrorSection(Section):
    """Deviation of an aircraft from its route, drawn for each run; omitted keys mean none."""

    lateral: DeviationSection | None = None
    """to the right of the course; null: none"""
    along: DeviationSection | None = None
    """along the course; null: none"""
    vertical: DeviationSection | None = None
    """in height; it ends on the ground; null: none"""
    bank_lag_s: Annotated[float, Field(ge=0.1, le=5.0)] = 0.3
    """time constant of each of two lags of the bank behind the lateral acceleration"""

    @model_validator(mode="before")
    @classmethod
    def _moved(cls, data: Any) -> Any:
        if isinstance(data, dict) and "follow_estimate_s" in data:
            text = "the autopilot has its own section now: write approach.guidance: estimate, and time constants"
            raise reject(f"{text} below approach.autopilot", "follow_estimate_s")
        return data

    @model_validator(mode="after")
    def _some(self) -> Self:
        if all(part is None for part in (self.lateral, self.along, self.vertical)):
            raise reject("there is none: give lateral, along or vertical")
        return self


class AutopilotSection(Section):
    """Autopilot that steers an aircraft by the estimate; the defaults are examples, of no aircraft in particular."""

    lateral_time_constant_s: Annotated[float, Field(ge=0.5, le=300.0)] = 5.0
    """T of the lateral loop: acceleration -(d/T + 2 damping d')/T for the estimated deviation d"""
    vertical_time_constant_s: Annotated[float, Field(ge=0.5, le=300.0)] = 5.0
    """likewise in height, where d is the deviation from the glide path at the estimated place"""
    speed_time_constant_s: Annotated[float, Field(ge=0.5, le=300.0)] = 5.0
    """T of the speed loop: acceleration -d'/T for the estimated deviation d' from the route's speed"""
    damping: Annotated[float, Field(ge=0.5, le=2.0)] = 1.0
    """damping ratio of the lateral and vertical loops without the aircraft's lags"""
    bank_lag_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.3
    """time constant of each of two lags of the bank, and so of the lateral acceleration, behind its command"""
    pitch_lag_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.3
    """time constant of each of two lags of the vertical acceleration behind its command"""
    thrust_lag_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.5
    """time constant of each of two lags of the acceleration along the course behind its command"""
    bank_limit_deg: Annotated[float, Field(ge=1.0, le=60.0)] = 25.0
    """largest bank that guidance commands"""
    bank_rate_limit_deg_s: Annotated[float, Field(ge=0.5, le=180.0)] = 20.0
    """largest rate of the commanded bank"""
    load_factor_limit: Annotated[float, Field(ge=0.01, le=2.0)] = 0.2
    """largest change of the load factor that guidance commands, up or down"""
    acceleration_limit_m_s2: Annotated[float, Field(ge=0.05, le=10.0)] = 1.5
    """largest acceleration along the course that guidance commands"""

    def model(self) -> Autopilot:
        """The autopilot."""
        from navsim.trajectory.air import GRAVITY
        from navsim.trajectory.autopilot import Autopilot, Channel

        bank, rate = GRAVITY * math.tan(self.bank_limit_deg * DEG), GRAVITY * self.bank_rate_limit_deg_s * DEG
        return Autopilot((
            Channel(self.lateral_time_constant_s, self.damping, self.bank_lag_s, bank, rate),
            Channel(self.speed_time_constant_s, None, self.thrust_lag_s, self.acceleration_limit_m_s2),
            Channel(self.vertical_time_constant_s, self.damping, self.pitch_lag_s, self.load_factor_limit * GRAVITY),
        ))  # fmt: skip

    @model_validator(mode="after")
    def _damped(self) -> Self:
        if not self.model_fields_set:
            return self
        from navsim.trajectory.autopilot import LEAST_DAMPING

        names, lags = ("lateral", "speed", "vertical"), ("bank_lag_s", "thrust_lag_s", "pitch_lag_s")
        for name, lag, channel in zip(names, lags, self.model().channels, strict=True):
            if channel.least_damping < LEAST_DAMPING:
                has = f"the {name} loop has a damping ratio of {channel.least_damping:.2f}"
                text = f"with {lag} {channel.lag:g} s {has}; at least {LEAST_DAMPING:g} is allowed: give a longer time"
                raise reject(text, f"{name}_time_constant_s")
        return self


FULL_SCALE = {"ils": 0.24, "gls": 0.25}
"""Full-scale deviation in height, as a part of the glide slope's angle. ICAO Annex 10, volume I, 3.1.5.6: half of full
scale, 0.0875 DDM, at 0.12 of the angle. Unverified for gls: usual, said to be of RTCA DO-253, which is not public."""


BEYOND_END = {"ils": 300.0, "gls": 305.0}
"""Distance of the vertex of the course beyond the runway's end, m: a usual place of a localizer's antenna, and,
unverified, of the GARP of GBAS."""


class IndicatorSection(Section):
    """Deviations from localizer and glide path as a pilot sees them: angles, in parts of full scale."""

    system: Literal["ils", "gls"] = "ils"
    """whose scales: instrument landing system; or GBAS, whose receiver imitates it"""
    course_width_m: Annotated[float, Field(ge=20.0, le=300.0)] = 106.75
    """distance from the centre line at the threshold that is full scale; the FAS data block of GBAS has it"""
    course_origin_m: Annotated[float, Field(ge=100.0, le=20000.0)] | None = None
    """distance beyond the threshold of the localizer's antenna, or of the GARP; null: 300 m (ils) or 305 m (gls) beyond
    the end of the runway"""
    glide_full_scale: Annotated[float, Field(ge=0.05, le=1.0)] | None = None
    """full scale of the glide path as a part of its angle; null: 0.24 (ils) or 0.25 (gls)"""
    until_height_m: Annotated[float, Field(ge=1.0, le=1000.0)] = 60.96
    """height above the runway down to which deviations are judged, for instance the decision height"""

    def origin_m(self, runway: Runway) -> float:
        """Distance of the course's vertex beyond the threshold, m."""
        return runway.extent_m + BEYOND_END[self.system] if self.course_origin_m is None else self.course_origin_m

    @property
    def share(self) -> float:
        """Full scale of the glide path as a part of its angle."""
        return FULL_SCALE[self.system] if self.glide_full_scale is None else self.glide_full_scale
