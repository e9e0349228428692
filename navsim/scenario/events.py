"""Events that affect signals during a landing: the list `events`.

Source: `docs/theory/integrity.md`, section 8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.runway import Point
from navsim.scenario_files.base import DistinctListOf, FlightTime, Section, Triple, reject

if TYPE_CHECKING:
    from navsim.gnss.events import Event, EventEffect

Error = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Error of a range, m, or its change, m/s."""
_NONE = (0.0, 0.0, 0.0)


class EventSection(Section):
    """An event that affects the signals of some sources for some time; `what` selects its kind."""

    what: str
    """kind of event"""
    sources: Annotated[DistinctListOf[str], Field(min_length=1)]
    """names of satellites, pseudolites and beacons, of satellite systems, `pseudolites`, `beacons`, and `all` for
    satellites and pseudolites"""
    at_s: FlightTime = 0.0
    """when it begins, after time 0"""
    until_s: FlightTime | None = None
    """when it ends, after time 0; null: at the end of the flight"""

    @model_validator(mode="after")
    def _lasting(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise reject("must lie after at_s", "until_s")
        return self

    def happening(self) -> EventEffect:
        """Model of the event."""
        raise NotImplementedError

    def model(self) -> Event:
        """The event."""
        from navsim.gnss.events import Event

        return Event(self.happening(), self.sources, self.at_s, float("inf") if self.until_s is None else self.until_s)


class SilenceSection(EventSection):
    """Nothing is received of them."""

    what: Literal["silence"]
    """nothing is received of the sources"""

    def happening(self) -> EventEffect:
        from navsim.gnss.events import Silence

        return Silence()


class RangeSection(EventSection):
    """An error of ranges alone."""

    code_only: bool = False
    """whether it is an error of the code alone: range rates and carriers have none"""
    reference_receiver: Annotated[int, Field(ge=1, le=4)] | None = None
    """number of the reference receiver of signals.errors.ground_station that has the error: ranges have its share of
    the mean; null: the ranges themselves have it"""

    def model(self) -> Event:
        from dataclasses import replace

        return replace(super().model(), code_only=self.code_only, receiver=self.reference_receiver or 0)


class StepSection(RangeSection):
    """Their ranges are wrong by a constant."""

    what: Literal["step"]
    """ranges are wrong by a constant"""
    error_m: Error
    """how much longer the ranges become"""

    def happening(self) -> EventEffect:
        from navsim.gnss.events import RangeFault

        return RangeFault(self.error_m, 0.0)


class RampSection(RangeSection):
    """Their ranges go wrong slowly, and without `code_only` their range rates with them: a clock that runs away."""

    what: Literal["ramp"]
    """ranges go wrong at a constant rate"""
    rate_m_s: Error
    """how fast the ranges grow"""

    def happening(self) -> EventEffect:
        from navsim.gnss.events import RangeFault

        return RangeFault(0.0, self.rate_m_s)


class SurveySection(EventSection):
    """Sources at positions other than those that the receiver assumes."""

    what: Literal["survey"]
    """the sources are not at the positions that the receiver assumes"""
    ned_m: Triple
    """true position minus the assumed one: north, east, down at the receiver"""

    def happening(self) -> EventEffect:
        import numpy as np

        from navsim.gnss.events import DisplacedSources

        return DisplacedSources(np.array(self.ned_m))


class SpoofSection(EventSection):
    """Their signals are replaced by such as another place would receive, consistent with each other."""

    what: Literal["spoof"]
    """signals are replaced by such as another place would receive"""
    offset_ned_m: Triple = _NONE
    """the other place less the true one at the beginning: north, east, down"""
    rate_ned_m_s: Triple = _NONE
    """how the other place moves off from there: north, east, down"""
    clock_m: Error = 0.0
    """apparent additional offset of the receiver's clock"""
    drift_m_s: Error = 0.0
    """how fast clock_m grows"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not (any(self.offset_ned_m) or any(self.rate_ned_m_s) or self.clock_m or self.drift_m_s):
            raise reject("changes nothing: give offset_ned_m, rate_ned_m_s, clock_m or drift_m_s", "what")
        return self

    def happening(self) -> EventEffect:
        import numpy as np

        from navsim.gnss.events import Spoofed

        return Spoofed(np.array(self.offset_ned_m), np.array(self.rate_ned_m_s), self.clock_m, self.drift_m_s)


class MeaconSection(EventSection):
    """Their signals are received at a place and sent again from there, stronger."""

    what: Literal["meacon"]
    """signals are received at a place and sent again from there"""
    place: Point
    """where they are received and retransmitted"""
    height_m: Annotated[float, Field(ge=-1000.0, le=1e5)] = 0.0
    """height of the antennas above the ellipsoid"""
    delay_m: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """delay within the meacon, as a range"""

    def happening(self) -> EventEffect:
        import numpy as np

        from navsim.geodesy.earth import ecef_from_llh
        from navsim.gnss.events import Meaconed

        return Meaconed(ecef_from_llh(np.array([*self.place.radians, self.height_m])), self.delay_m)


AnyEvent = Annotated[
    SilenceSection | StepSection | RampSection | SurveySection | SpoofSection | MeaconSection,
    Field(discriminator="what"),
]
"""An entry of `events`."""
