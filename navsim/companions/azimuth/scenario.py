"""`kind: azimuth-tracking`: azimuth from a scanning radar, with and without reported load factors."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal

from pydantic import Field

from navsim.companions.circuit_section import CircuitSection
from navsim.scenario_files.base import (
    Decay,
    Latency,
    ListOf,
    NonNegative,
    PairOf,
    ScanPeriod,
    Section,
    Sigma,
    Utc,
    Version,
)


class Radar(Section):
    """The plots."""

    azimuth_sigma_deg: Sigma = 0.08
    """1 sigma of the azimuth of a plot"""
    range_sigma_m: NonNegative = 30.0
    """1 sigma of the range of a plot"""


class Report(Section):
    """Mode S reports of the aircraft: noise, quantisation (after the noise), age."""

    latency_s: Latency = 0.5
    """age of a report's content when a scan uses it"""
    load_factor_sigma_g: NonNegative = 0.02
    """1 sigma of each reported load factor"""
    roll_sigma_deg: NonNegative = 0.3
    """1 sigma of the reported roll"""
    path_angle_sigma_deg: NonNegative = 0.1
    """1 sigma of the reported path angle"""
    track_sigma_deg: NonNegative = 0.25
    """1 sigma of the reported track"""
    speed_sigma_m_s: NonNegative = 1.0
    """1 sigma of the reported speed"""
    track_rate_sigma_deg_s: NonNegative = 0.05
    """1 sigma of the reported track rate"""
    load_factor_lsb_g: NonNegative = 0.015625
    """least significant bit of load factors; 0: not quantised"""
    roll_lsb_deg: NonNegative = 0.17578125
    """least significant bit of the roll; 0: not quantised"""
    track_lsb_deg: NonNegative = 0.17578125
    """least significant bit of the track; 0: not quantised"""
    speed_lsb_m_s: NonNegative = 1.028889
    """least significant bit of the speed; 0: not quantised"""
    track_rate_lsb_deg_s: NonNegative = 0.03125
    """least significant bit of the track rate; 0: not quantised"""


class Filters(Section):
    """Tuning of the filters."""

    alpha_1_s: Decay = 0.05
    """decay of Singer's acceleration"""
    singer_sigma_m_s2: PairOf[Sigma] = (1.074264684, 2.504689245)
    """1 sigma of Singer's acceleration of S1 (0.2 g in Singer's formula) and S2 (the turn's own g tan 25 deg)"""
    residual_sigma_m_s2: Sigma = 0.2
    """1 sigma of the acceleration that reports do not contain, L1-L4"""


class Map(Section):
    """The map of Singer over onboard-driven, each with its best tuning."""

    periods_s: ListOf[ScanPeriod] = (0.5, 1.0, 2.0, 4.0, 6.0, 10.0)
    """scan periods of the map"""
    azimuth_sigmas_deg: ListOf[Sigma] = (0.03, 0.05, 0.08, 0.15, 0.30)
    """azimuth errors of the map, 1 sigma, at the age of reports of `report`"""
    latencies_s: ListOf[Latency] = (0.0, 0.25, 0.5, 1.0, 2.0)
    """ages of reports of the map, at the azimuth error of `radar`"""
    singer_sigmas_m_s2: ListOf[Sigma] = (0.3, 0.5, 0.8, 1.2, 1.8, 2.5, 3.5)
    """tunings of Singer among which the best is taken"""
    residual_sigmas_m_s2: ListOf[Sigma] = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.5)
    """tunings of L4 among which the best is taken"""
    runs: Annotated[int, Field(ge=0, le=10_000)] = 60
    """Monte Carlo runs of each point of the map; 0: no map"""


class Azimuth(Section):
    """Azimuth of an aircraft in the circuit."""

    kind: Literal["azimuth-tracking"]
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
    """time between scans of the radar"""
    further_periods_s: ListOf[ScanPeriod] = (4.0,)
    """scan periods of cases computed in addition to the main one"""
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Monte Carlo runs of each case"""
    noise: Literal["as-given", "none"] = "as-given"
    """none: no noise, no quantisation, no latency; the deterministic run"""
    radar: Radar = Radar()
    """the plots"""
    report: Report = Report()
    """Mode S reports of the aircraft"""
    filters: Filters = Filters()
    """how the filters are tuned"""
    latencies_s: ListOf[Latency] = (0.0, 0.5, 1.0, 2.0)
    """sweep of the age of reports, unknown to the filter and stamped"""
    map: Map = Map()
    """the map of Singer over onboard-driven filters"""
