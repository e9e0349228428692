"""`kind: atc-tracking`: range and angles of an aircraft with onboard data, full against decoupled against Singer."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import Decay, ScanPeriod, Section, Sigma, Utc, Version, list_of, reject
from navsim.scenario.tracking.circuit import CircuitSection


class Sigmas(Section):
    """1 sigma of what is measured each scan."""

    range_m: Sigma = 30.0
    speed_m_s: Sigma = 1.0
    path_angle_deg: Sigma = 0.1
    track_deg: Sigma = 0.25
    elevation_deg: Sigma = 0.08
    azimuth_deg: Sigma = 0.08
    speed_rate_m_s2: Sigma = 0.1
    """this and the next two where onboard rates are measured"""
    path_angle_rate_deg_s: Sigma = 0.1
    track_rate_deg_s: Sigma = 0.1


class Group(Section):
    """How a rate varies: exponentially correlated."""

    alpha_1_s: Decay
    """decay"""
    rate_sigma: Sigma
    """1 sigma of the rate: m/s2 for speed, else deg/s"""


class Groups(Section):
    """The five pairs beside the range."""

    speed: Group = Group(alpha_1_s=0.05, rate_sigma=0.5)
    path_angle: Group = Group(alpha_1_s=0.1, rate_sigma=0.3)
    track: Group = Group(alpha_1_s=0.05, rate_sigma=2.0)
    elevation: Group = Group(alpha_1_s=1.0 / 60.0, rate_sigma=0.1)
    azimuth: Group = Group(alpha_1_s=1.0 / 60.0, rate_sigma=0.5)


class SingerSection(Section):
    """A Singer acceleration."""

    alpha_1_s: Decay = 0.05
    sigma_m_s2: Sigma = 1.074264684


class AtcCase(Section):
    """A case computed beside the main one."""

    period_s: ScanPeriod
    onboard_rates: bool = False


class Atc(Section):
    """Range and angles of an aircraft in the circuit."""

    kind: Literal["atc-tracking"]
    version: Version
    title: str = ""
    epoch: Utc = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
    """UTC of time 0; nothing depends on it"""
    circuit: CircuitSection = CircuitSection()
    period_s: ScanPeriod = 1.0
    onboard_rates: bool = False
    """whether V' and the rates of path angle and track are measured as well"""
    further_cases: list_of(AtcCase) = (  # type: ignore[valid-type]
        AtcCase(period_s=1.0, onboard_rates=True),
        AtcCase(period_s=4.0),
        AtcCase(period_s=4.0, onboard_rates=True),
    )
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    noise: Literal["as-given", "none"] = "as-given"
    """none: the deterministic run"""
    sigmas: Sigmas = Sigmas()
    groups: Groups = Groups()
    residual_m_s2: Sigma = 0.3
    """1 sigma of the range acceleration beyond the formula"""
    start_range_rate_m_s: Sigma = 5.0
    start_range_acceleration_m_s2: Sigma = 2.0
    singer: SingerSection = SingerSection()
    cartesian: SingerSection = SingerSection(sigma_m_s2=2.5)

    @model_validator(mode="after")
    def _decaying(self) -> Self:
        longest = max([self.period_s, *(case.period_s for case in self.further_cases)])
        for name in Groups.model_fields:
            alpha = getattr(self.groups, name).alpha_1_s
            if alpha * longest > 1.0:
                message = f"{alpha:g} 1/s: a rate decays by 1 - alpha T a scan, so at most 1 / {longest:g} s is allowed"
                raise reject(message, "groups", name, "alpha_1_s")
        return self
