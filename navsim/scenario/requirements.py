"""Requirements on a landing: the list `requirements`, each with a verdict at the end of a study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.integrity import OPERATIONS, IntegritySection, LimitsSection, Operation
from navsim.scenario_files.base import HeightName, Section, reject

Share = Annotated[float, Field(gt=0.0, lt=1.0)]
"""Required fraction of runs, or of epochs."""
Risk = Annotated[float, Field(ge=1e-12, le=0.5)]
"""A probability that is allowed."""
Length = Annotated[float, Field(ge=1e-3, le=1e6)]


class RequirementSection(Section):
    """A requirement; `what` selects its kind.

    needs: section or key that it refers to, "" for none.
    """

    needs: ClassVar[str] = ""
    what: str
    """quantity of the requirement"""


class ErrorRequirement(RequirementSection):
    """The filter's error at a height stays below a size in a share of the runs."""

    what: Literal["error"]
    """filter error at a height"""
    of: Literal["lateral", "along", "vertical"]
    """axis of the runway"""
    at: HeightName = "touchdown"
    """height of the IMU's position above the runway at which the error is evaluated, such as 100ft or 30m"""
    below_m: Length
    """size that the error stays below"""
    share: Share = 0.95
    """share of the runs in which it does"""


class RmsRequirement(RequirementSection):
    """Root mean square of the filter's error over the last seconds before touchdown."""

    what: Literal["rms"]
    """RMS error over the last 20 s"""
    of: Literal["horizontal", "vertical"]
    """horizontal: both axes together; or vertical"""
    below_m: Length
    """size that it stays below"""


class BoxRequirement(RequirementSection):
    """A landing ends outside the scenario's box less often than this."""

    needs: ClassVar[str] = "box"
    what: Literal["box"]
    """probability of leaving the box"""
    at_most: Risk
    """probability that is allowed"""


class GoAroundRequirement(RequirementSection):
    """Runs go around after an alarm less often than this."""

    needs: ClassVar[str] = "approach.go_around.on_alarm"
    what: Literal["go_around"]
    """share of runs that go around"""
    at_most: Risk
    """share that is allowed"""


class IndicatorRequirement(RequirementSection):
    """The aircraft's largest deviation from localizer or glide path stays within a part of full scale."""

    needs: ClassVar[str] = "approach.indicator"
    what: Literal["localizer", "glide_path"]
    """largest deviation down to approach.indicator.until_height_m"""
    within: Annotated[float, Field(ge=1e-3, le=100.0)] = 0.5
    """part of full scale; 0.5: half scale, one of two dots"""
    share: Share = 0.95
    """share of the runs in which it stays within, of those that fly the judged part"""


class LevelRequirement(RequirementSection):
    """A protection level of the fixes is within a size at a share of the epochs of the glide."""

    needs: ClassVar[str] = "integrity"
    what: Literal["level"]
    """protection level of the fixes"""
    of: Literal["hpl", "vpl"]
    """horizontal or vertical protection level"""
    below_m: Length
    """size that the level stays within"""
    share: Share = 0.99
    """share of the epochs of the glide at which it does"""


class ThresholdRequirement(RequirementSection):
    """The effective monitor threshold of the fixes is within a size at a share of the epochs of the glide."""

    needs: ClassVar[str] = "integrity"
    what: Literal["emt"]
    """effective monitor threshold"""
    below_m: Length
    """size that the threshold stays within"""
    share: Share = 0.99
    """share of the epochs of the glide at which it does"""


class AccuracyRequirement(RequirementSection):
    """The vertical error is within a size, without a fault, at a share of the epochs of the glide."""

    needs: ClassVar[str] = "integrity"
    what: Literal["accuracy"]
    """vertical error without a fault"""
    below_m: Length
    """size that the error stays within"""
    at_most: Risk = 0.05
    """probability of being beyond that is allowed"""
    share: Share = 0.99
    """share of the epochs of the glide at which it stays so"""


class AvailabilityRequirement(RequirementSection):
    """A share of the epochs of the glide, or of approaches throughout, is available."""

    needs: ClassVar[str] = "integrity.limits"
    what: Literal["availability", "approaches"]
    """available epochs, or fully available approaches"""
    at_least: Share
    """share that is asked for"""


class RiskRequirement(RequirementSection):
    """Continuity is lost within 15 s, or a run misleads, less often than this."""

    needs: ClassVar[str] = "integrity.limits"
    what: Literal["continuity", "misleading"]
    """risk of lost continuity within 15 s, or of misleading information"""
    at_most: Risk
    """probability that is allowed"""


class AlertRequirement(RequirementSection):
    """An alarm comes within this time wherever an error was beyond its limit, and the level within it."""

    needs: ClassVar[str] = "integrity.limits"
    what: Literal["time_to_alert"]
    """longest time to an alarm"""
    within_s: Annotated[float, Field(ge=0.0, le=60.0)]
    """time to alert that is allowed"""


CONTINUITY, INTEGRITY = 8e-6, 2e-7
"""Continuity risk in 15 s and integrity risk of an approach: ICAO Annex 10, volume I, table 3.7.2.4-1 (of continuity
the larger end of the range)."""


EMT = 15.0
"""Effective monitor threshold that LPV-200 asks for, m: WG-C ARAIM TSG, Reference Airborne Algorithm Description,
version 3.0 (2017)."""
ACCURACY: dict[Operation, dict[float, float]] = {
    "APV-I": {0.05: 20.0},
    "APV-II": {0.05: 8.0},
    "LPV-200": {0.05: 4.0, 1e-7: 10.0},
    "CAT-I": {0.05: 4.0},
}
"""Vertical error without a fault, m, by the probability of being beyond: doi:10.1186/s43020-020-00010-2, table 1 (95 %;
of CAT I the smaller of 4 to 6 m), and for LPV-200 the same description of ARAIM."""


class PresetRequirement(RequirementSection):
    """Requirements of an operation: its alert limits at a fraction of the epochs, vertical accuracy without a fault,
    continuity, integrity, and for LPV-200 the effective monitor threshold. Horizontal accuracy (16 m, 95 %) and the
    time to alert are not included."""

    needs: ClassVar[str] = "integrity.limits"
    what: Literal["preset"]
    """all requirements of an operation"""
    operation: Operation
    """the operation"""
    availability: Share = 0.99
    """share of the epochs that have levels within the alert limits; Annex 10 has 0.99 to 0.99999"""

    @model_validator(mode="after")
    def _of_approaches(self) -> Self:
        if self.operation in ("NPA", "GBAS-D"):
            raise reject(
                "continuity and integrity of NPA and GBAS D are by the hour or by parts of the approach; give single "
                "requirements",
                "operation",
            )
        return self

    def counts_by(self, limits: LimitsSection | None) -> bool:
        """Whether continuity and hazardously misleading information are counted with its own limits, if these are the
        given ones. Of these operations only CAT I has limits that grow with the distance, with GBAS."""
        if limits is None or limits.limits() != OPERATIONS[self.operation]:
            return False
        return self.operation == "CAT-I" or not limits.grow_with_distance

    def levels_are_its_own(self, section: IntegritySection) -> bool:
        """Whether levels are computed for no more risk than its integrity allows an approach."""
        return section.risk_of_levels() <= INTEGRITY * (1.0 + 1e-9)

    def parts(self) -> tuple[AnySingle, ...]:
        """The single requirements."""
        horizontal, vertical = OPERATIONS[self.operation]
        levels = [LevelRequirement(what="level", of="hpl", below_m=horizontal, share=self.availability)]
        if vertical is not None:
            levels.append(LevelRequirement(what="level", of="vpl", below_m=vertical, share=self.availability))
        further: list[AnySingle] = []
        if self.operation == "LPV-200":
            further.append(ThresholdRequirement(what="emt", below_m=EMT, share=self.availability))
        further += [
            AccuracyRequirement(what="accuracy", below_m=size, at_most=risk, share=self.availability)
            for risk, size in ACCURACY.get(self.operation, {}).items()
        ]
        return (
            *levels,
            *further,
            RiskRequirement(what="continuity", at_most=CONTINUITY),
            RiskRequirement(what="misleading", at_most=INTEGRITY),
        )


AnySingle = (
    ErrorRequirement | RmsRequirement | BoxRequirement | GoAroundRequirement | IndicatorRequirement | LevelRequirement
    | ThresholdRequirement | AccuracyRequirement | AvailabilityRequirement | RiskRequirement | AlertRequirement
)  # fmt: skip
"""A requirement that is one statement."""
AnyRequirement = Annotated[AnySingle | PresetRequirement, Field(discriminator="what")]
"""An entry of `requirements`."""


def singles(requirements: Sequence[AnySingle | PresetRequirement]) -> list[tuple[str, AnySingle]]:
    """Single requirements, presets as their parts, with a prefix in words."""
    out: list[tuple[str, AnySingle]] = []
    for one in requirements:
        if isinstance(one, PresetRequirement):
            out += [(f"{one.operation}: ", part) for part in one.parts()]
        else:
            out.append(("", one))
    return out
