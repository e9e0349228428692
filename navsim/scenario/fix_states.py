"""A receiver whose fixes have a state: section `receiver.fix_states`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import Field, model_validator

from navsim.scenario_files.base import FlightTime, ListOf, NonNegative, Section, Size, Triple, reject

if TYPE_CHECKING:
    from navsim.gnss.fix_states import FixStates

State = Literal["fixed", "float", "differential", "single", "wrong"]
"""State of a fix."""
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Delay = Annotated[float, Field(ge=0.0, le=60.0)]


class FollowingSection(Section):
    """Probabilities of the next state; they add up to 1."""

    fixed: Share = 0.0
    """of right ambiguities"""
    float: Share = 0.0
    """of ambiguities as real numbers"""
    differential: Share = 0.0
    """of corrected code"""
    single: Share = 0.0
    """of code without corrections"""
    wrong: Share = 0.0
    """of wrong ambiguities, flagged as fixed"""

    @model_validator(mode="after")
    def _check_complete(self) -> Self:
        if abs(sum(dict(self).values()) - 1.0) > 1e-6:
            raise reject("the probabilities of the next state have to add up to 1")
        return self


class FixStateSection(Section):
    """A state of the fixes; null: the default of that state."""

    mean_s: Size | None = None
    """mean time until the state changes; times are exponentially distributed"""
    horizontal_m: NonNegative | None = None
    """1 sigma of the white noise of each horizontal axis"""
    vertical_m: NonNegative | None = None
    """1 sigma of the white noise of the height"""
    velocity_m_s: NonNegative | None = None
    """1 sigma of the white noise of each axis of the velocity"""
    lasting_horizontal_m: NonNegative | None = None
    """1 sigma of each horizontal axis of the error that is drawn when the state begins, and lasts until it ends"""
    lasting_vertical_m: NonNegative | None = None
    """likewise of the height: with that of the state before it, the jump of the height at a change"""
    next: FollowingSection | None = None
    """the state that follows"""


def _state(
    mean: float, noise: tuple[float, float, float], lasting: tuple[float, float], **following: float
) -> FixStateSection:
    """A state by default."""
    horizontal, vertical, velocity = noise
    return FixStateSection(
        mean_s=mean, horizontal_m=horizontal, vertical_m=vertical, velocity_m_s=velocity,
        lasting_horizontal_m=lasting[0], lasting_vertical_m=lasting[1], next=FollowingSection(**following),
    )  # fmt: skip


class ForcedStateSection(Section):
    """A state that all runs have from a time to another."""

    state: State
    """the state"""
    at_s: FlightTime
    """when it begins"""
    until_s: FlightTime
    """when it ends; the state that would be there then follows"""
    error_ned_m: Triple | None = None
    """its lasting error north, east, down; null: drawn as otherwise"""

    @model_validator(mode="after")
    def _lasting(self) -> Self:
        if self.until_s <= self.at_s:
            raise reject("must lie after at_s", "until_s")
        return self


class FixStatesSection(Section):
    """States of the fixes of a receiver with carrier ambiguities (RTK), as a Markov chain; numbers are examples, of no
    receiver in particular."""

    fixed: FixStateSection = _state(600.0, (0.01, 0.015, 0.03), (0.01, 0.015), float=0.97, single=0.02, wrong=0.01)
    """right ambiguities"""
    float: FixStateSection = _state(20.0, (0.05, 0.1, 0.05), (0.2, 0.4), fixed=0.95, differential=0.03, wrong=0.02)
    """ambiguities as real numbers"""
    differential: FixStateSection = _state(30.0, (0.3, 0.5, 0.1), (0.4, 0.8), float=0.9, single=0.1)
    """corrected code"""
    single: FixStateSection = _state(20.0, (0.5, 1.0, 0.1), (1.5, 3.0), differential=0.5, float=0.5)
    """code without corrections"""
    wrong: FixStateSection = _state(30.0, (0.01, 0.015, 0.03), (0.5, 1.5), float=1.0)
    """wrong ambiguities, flagged as fixed; the lasting error is the size of a wrong fix"""
    flag_delay_s: Delay = 0.0
    """time from a change of state until the receiver's flag changes"""
    forced: Annotated[ListOf[ForcedStateSection], Field(max_length=100)] = ()
    """states at given times, for instance one wrong fix in all runs, in order of time"""

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, data: Any) -> Any:
        """Write out the defaults of keys that a state leaves out."""
        if not isinstance(data, dict):
            return data
        out = dict(data)
        for name in get_args(State):
            if isinstance(given := data.get(name), dict):
                known = {key: value for key, value in given.items() if value is not None}
                out[name] = cls.model_fields[name].default.model_dump() | known
        return out

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for i, (one, other) in enumerate(zip(self.forced, self.forced[1:], strict=False), start=1):
            if other.at_s < one.until_s:
                raise reject("begins before the one before it ends", "forced", i, "at_s")
        return self

    def model(self) -> FixStates:
        """The chain."""
        import numpy as np

        from navsim.gnss.fix_states import STATES, FixStates, ForcedState

        each: list[FixStateSection] = [getattr(self, name) for name in STATES]
        return FixStates(
            np.array([one.mean_s for one in each]),
            np.array([[getattr(one.next, name) for name in STATES] for one in each]),
            np.array([[one.horizontal_m, one.vertical_m, one.velocity_m_s] for one in each]),
            np.array([[one.lasting_horizontal_m, one.lasting_vertical_m] for one in each]),
            self.flag_delay_s,
            tuple(
                ForcedState(STATES.index(f.state), f.at_s, f.until_s,
                            None if f.error_ned_m is None else np.array(f.error_ned_m))
                for f in self.forced
            ),
        )  # fmt: skip
