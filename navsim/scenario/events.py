"""What happens to signals during a landing: the list `events`, which reads like a story.

Source: `docs/theory/integrity.md`, section 8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.approach import Point
from navsim.scenario.base import Section, Triple, list_of, reject

if TYPE_CHECKING:
    from navsim.models.events import Event, Happening

When = Annotated[float, Field(ge=0.0, le=3600.0)]
Error = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Of a range, m, or its change, m/s."""
_NONE = (0.0, 0.0, 0.0)


class EventSection(Section):
    """Something that happens to the signals of some sources for some time; every kind has its own word for `what`."""

    what: str
    sources: Annotated[list_of(str), Field(min_length=1)]  # type: ignore[valid-type]
    """names of satellites and pseudolites, of satellite systems, `pseudolites`, `all`"""
    at_s: When = 0.0
    until_s: When | None = None
    """null: to the end"""

    @model_validator(mode="after")
    def _lasting(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise reject("must lie after at_s", "until_s")
        return self

    def happening(self) -> Happening:
        """The model of what happens."""
        raise NotImplementedError

    def model(self) -> Event:
        """The event."""
        from navsim.models.events import Event

        return Event(self.happening(), self.sources, self.at_s, float("inf") if self.until_s is None else self.until_s)


class SilenceSection(EventSection):
    """Nothing is received of them."""

    what: Literal["silence"]

    def happening(self) -> Happening:
        from navsim.models.events import Silence

        return Silence()


class RangeSection(EventSection):
    """An error of ranges by itself."""

    code_only: bool = False
    """of the code: range rates and carriers stay as they are"""

    def model(self) -> Event:
        from dataclasses import replace

        return replace(super().model(), code_only=self.code_only)


class StepSection(RangeSection):
    """Their ranges are wrong by a constant."""

    what: Literal["step"]
    error_m: Error

    def happening(self) -> Happening:
        from navsim.models.events import RangeFault

        return RangeFault(self.error_m, 0.0)


class RampSection(RangeSection):
    """Their ranges go wrong slowly, and without `code_only` their range rates with them: a clock that runs away."""

    what: Literal["ramp"]
    rate_m_s: Error

    def happening(self) -> Happening:
        from navsim.models.events import RangeFault

        return RangeFault(0.0, self.rate_m_s)


class SurveySection(EventSection):
    """They stand elsewhere than the receiver believes."""

    what: Literal["survey"]
    ned_m: Triple
    """true place less the one believed in: north, east, down at the receiver"""

    def happening(self) -> Happening:
        import numpy as np

        from navsim.models.events import Displaced

        return Displaced(np.array(self.ned_m))


class SpoofSection(EventSection):
    """Their signals are replaced by such as another place would receive, consistent with each other."""

    what: Literal["spoof"]
    offset_ned_m: Triple = _NONE
    """that place less the true one at the beginning"""
    rate_ned_m_s: Triple = _NONE
    """how it moves off from there"""
    clock_m: Error = 0.0
    """what the receiver's clock seems to be off by, beside the truth"""
    drift_m_s: Error = 0.0
    """how that grows"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not (any(self.offset_ned_m) or any(self.rate_ned_m_s) or self.clock_m or self.drift_m_s):
            raise reject("changes nothing: give offset_ned_m, rate_ned_m_s, clock_m or drift_m_s", "what")
        return self

    def happening(self) -> Happening:
        import numpy as np

        from navsim.models.events import Spoofed

        return Spoofed(np.array(self.offset_ned_m), np.array(self.rate_ned_m_s), self.clock_m, self.drift_m_s)


class MeaconSection(EventSection):
    """Their signals are received at a place and sent again from there, stronger."""

    what: Literal["meacon"]
    place: Point
    height_m: Annotated[float, Field(ge=-1000.0, le=1e5)] = 0.0
    """above the ellipsoid"""
    delay_m: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """of the meacon itself"""

    def happening(self) -> Happening:
        import numpy as np

        from navsim.core.arrays.earth import ecef_from_llh
        from navsim.models.events import Meaconed

        return Meaconed(ecef_from_llh(np.array([*self.place.radians, self.height_m])), self.delay_m)


AnyEvent = Annotated[
    SilenceSection | StepSection | RampSection | SurveySection | SpoofSection | MeaconSection,
    Field(discriminator="what"),
]
"""An entry of `events`."""
