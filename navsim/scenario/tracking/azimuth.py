"""`kind: azimuth-tracking`: azimuth from a scanning radar, with and without reported load factors."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal

from pydantic import Field

from navsim.scenario.base import (
    Decay,
    NonNegative,
    ScanPeriod,
    Section,
    Sigma,
    Utc,
    Version,
    list_of,
    pair_of,
)
from navsim.scenario.tracking.circuit import CircuitSection

Latency = Annotated[float, Field(ge=0.0, le=30.0)]


class Radar(Section):
    """The plots."""

    azimuth_sigma_deg: Sigma = 0.08
    range_sigma_m: NonNegative = 30.0


class Report(Section):
    """What the aircraft reports by Mode S: noise, quantisation (after the noise), age."""

    latency_s: Latency = 0.5
    """age of a report's content when a scan uses it"""
    load_factor_sigma_g: NonNegative = 0.02
    roll_sigma_deg: NonNegative = 0.3
    path_angle_sigma_deg: NonNegative = 0.1
    track_sigma_deg: NonNegative = 0.25
    speed_sigma_m_s: NonNegative = 1.0
    track_rate_sigma_deg_s: NonNegative = 0.05
    load_factor_lsb_g: NonNegative = 0.015625
    roll_lsb_deg: NonNegative = 0.17578125
    track_lsb_deg: NonNegative = 0.17578125
    speed_lsb_m_s: NonNegative = 1.028889
    track_rate_lsb_deg_s: NonNegative = 0.03125


class Filters(Section):
    """How the filters are tuned."""

    alpha_1_s: Decay = 0.05
    """decay of Singer's acceleration"""
    singer_sigma_m_s2: pair_of(Sigma) = (1.074264684, 2.504689245)  # type: ignore[valid-type]
    """of S1 (0.2 g in Singer's formula) and S2 (the turn's own g tan 25 deg)"""
    residual_sigma_m_s2: Sigma = 0.2
    """what reported accelerations leave over, L1-L4"""


class Map(Section):
    """The map of Singer over onboard-driven, each with its best tuning."""

    periods_s: list_of(ScanPeriod) = (0.5, 1.0, 2.0, 4.0, 6.0, 10.0)  # type: ignore[valid-type]
    azimuth_sigmas_deg: list_of(Sigma) = (0.03, 0.05, 0.08, 0.15, 0.30)  # type: ignore[valid-type]
    latencies_s: list_of(Latency) = (0.0, 0.25, 0.5, 1.0, 2.0)  # type: ignore[valid-type]
    singer_sigmas_m_s2: list_of(Sigma) = (0.3, 0.5, 0.8, 1.2, 1.8, 2.5, 3.5)  # type: ignore[valid-type]
    residual_sigmas_m_s2: list_of(Sigma) = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.5)  # type: ignore[valid-type]
    runs: Annotated[int, Field(ge=0, le=10_000)] = 60
    """0: no map"""


class Azimuth(Section):
    """Azimuth of an aircraft in the circuit."""

    kind: Literal["azimuth-tracking"]
    version: Version
    title: str = ""
    epoch: Utc = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
    """UTC of time 0; nothing depends on it"""
    circuit: CircuitSection = CircuitSection()
    period_s: ScanPeriod = 1.0
    """of the radar's scan"""
    further_periods_s: list_of(ScanPeriod) = (4.0,)  # type: ignore[valid-type]
    """cases computed beside it"""
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    noise: Literal["as-given", "none"] = "as-given"
    """none: no noise, no quantisation, no latency; the deterministic run"""
    radar: Radar = Radar()
    report: Report = Report()
    filters: Filters = Filters()
    latencies_s: list_of(Latency) = (0.0, 0.5, 1.0, 2.0)  # type: ignore[valid-type]
    """sweep of the age of reports, unknown to the filter and stamped"""
    map: Map = Map()
