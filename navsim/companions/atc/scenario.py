"""`kind: atc-tracking`: range and angles of an aircraft with onboard data, full against decoupled against Singer."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.companions.circuit_section import CircuitSection
from navsim.scenario_files.base import (
    Decay,
    Latency,
    ListOf,
    NonNegative,
    ScanPeriod,
    Section,
    Sigma,
    Utc,
    Version,
    reject,
)


class Sigmas(Section):
    """1 sigma of the measurements of each scan."""

    range_m: Sigma = 30.0
    """1 sigma of the slant range"""
    speed_m_s: Sigma = 1.0
    """1 sigma of the reported speed"""
    path_angle_deg: Sigma = 0.1
    """1 sigma of the reported path angle"""
    track_deg: Sigma = 0.25
    """1 sigma of the reported track"""
    elevation_deg: Sigma = 0.08
    """1 sigma of the elevation"""
    azimuth_deg: Sigma = 0.08
    """1 sigma of the azimuth"""
    speed_rate_m_s2: Sigma = 0.1
    """1 sigma of the reported rate of the speed, where onboard rates are measured"""
    path_angle_rate_deg_s: Sigma = 0.1
    """1 sigma of the reported rate of the path angle"""
    track_rate_deg_s: Sigma = 0.1
    """1 sigma of the reported rate of the track"""


class Group(Section):
    """Exponentially correlated rate."""

    alpha_1_s: Decay
    """decay of the rate, the reciprocal of its correlation time"""
    rate_sigma: Sigma
    """1 sigma of the rate: m/s2 for speed, else deg/s"""


class Groups(Section):
    """The five pairs besides the range."""

    speed: Group = Group(alpha_1_s=0.05, rate_sigma=0.5)
    """speed and its rate"""
    path_angle: Group = Group(alpha_1_s=0.1, rate_sigma=0.3)
    """path angle and its rate"""
    track: Group = Group(alpha_1_s=0.05, rate_sigma=2.0)
    """track and its rate"""
    elevation: Group = Group(alpha_1_s=1.0 / 60.0, rate_sigma=0.1)
    """elevation and its rate"""
    azimuth: Group = Group(alpha_1_s=1.0 / 60.0, rate_sigma=0.5)
    """azimuth and its rate"""


class SingerSection(Section):
    """A Singer acceleration."""

    alpha_1_s: Decay = 0.05
    """decay of the acceleration, the reciprocal of its correlation time"""
    sigma_m_s2: Sigma = 1.074264684
    """1 sigma of the acceleration"""


class DataLink(Section):
    """Reports of speed, path angle, track and their rates by the addressed data link, Mode S: their true age and
    quantisation, and those in the filter model. Steps are those of BDS registers 5,0 and 6,0."""

    latency_s: Latency = 0.0
    """age of a report's content when a scan uses it"""
    quantised: bool = False
    """whether reports are quantised, after the noise"""
    assumed_latency_s: Latency = 0.0
    """age that the filters count with"""
    assumed_quantised: bool = False
    """whether the filters add the variance of the quantisation, a twelfth of the step squared"""
    speed_lsb_m_s: NonNegative = 1.028889
    """least significant bit of the speed, 2 kt (BDS 5,0); 0: not quantised"""
    track_lsb_deg: NonNegative = 0.17578125
    """least significant bit of the track, 90/512 deg (BDS 5,0); 0: not quantised"""
    vertical_rate_lsb_m_s: NonNegative = 0.16256
    """least significant bit of the vertical rate, 32 ft/min (BDS 6,0), which gives the path angle; 0: not quantised"""
    track_rate_lsb_deg_s: NonNegative = 0.03125
    """least significant bit of the track rate, 8/256 deg/s (BDS 5,0); 0: not quantised"""
    study_latencies_s: ListOf[Latency] = (0.0, 0.5, 1.0, 2.0)
    """ages of quantised reports for a cost study, unknown to the filters and known"""
    study_runs: Annotated[int, Field(ge=0, le=10_000)] = 100
    """Monte Carlo runs of the study of the data link; 0: no study"""


class AtcCase(Section):
    """A case computed in addition to the main one."""

    period_s: ScanPeriod
    """time between scans"""
    onboard_rates: bool = False
    """whether the rates of speed, path angle and track are measured as well"""


class Atc(Section):
    """Range and angles of an aircraft in the circuit."""

    kind: Literal["atc-tracking"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    epoch: Utc = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
    """UTC of time 0; nothing depends on it"""
    circuit: CircuitSection = CircuitSection()
    """the flight"""
    period_s: ScanPeriod = 1.0
    """time between scans"""
    onboard_rates: bool = False
    """whether V' and the rates of path angle and track are measured as well"""
    further_cases: ListOf[AtcCase] = (
        AtcCase(period_s=1.0, onboard_rates=True),
        AtcCase(period_s=4.0),
        AtcCase(period_s=4.0, onboard_rates=True),
    )
    """cases computed in addition to the main one"""
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Monte Carlo runs of each case"""
    noise: Literal["as-given", "none"] = "as-given"
    """as-given: values of `sigmas`; none: no noise, no quantisation, no latency; the deterministic run"""
    sigmas: Sigmas = Sigmas()
    """1 sigma of the measurements of each scan"""
    link: DataLink = DataLink()
    """age and quantisation of the reports that come by data link"""
    groups: Groups = Groups()
    """how the rates of the five pairs other than the range vary"""
    residual_m_s2: Sigma = 0.3
    """1 sigma of the range acceleration beyond the formula"""
    start_range_rate_m_s: Sigma = 5.0
    """1 sigma of the range rate at the start of the filter"""
    start_range_acceleration_m_s2: Sigma = 2.0
    """1 sigma of the range acceleration at the start of the filter"""
    singer: SingerSection = SingerSection()
    """the acceleration of the filter of range alone"""
    cartesian: SingerSection = SingerSection(sigma_m_s2=2.5)
    """the acceleration of the Cartesian filter, along each axis"""

    @model_validator(mode="after")
    def _decaying(self) -> Self:
        longest = max([self.period_s, *(case.period_s for case in self.further_cases)])
        for name in Groups.model_fields:
            alpha = getattr(self.groups, name).alpha_1_s
            if alpha * longest > 1.0:
                message = f"{alpha:g} 1/s: a rate decays by 1 - alpha T a scan, so at most 1 / {longest:g} s is allowed"
                raise reject(message, "groups", name, "alpha_1_s")
        return self
