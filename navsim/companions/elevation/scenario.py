"""`kind: mls-elevation`: the elevation filter of an MLS approach, its Monte Carlo proof, its adequacy."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario_files.base import (
    CorrelationTime,
    EndTime,
    FlightTime,
    ListOf,
    Pair,
    PairOf,
    ScanPeriod,
    Section,
    Sigma,
    Utc,
    Variance,
    Version,
    reject,
)

SETTLING = 5.0
"""Time after which runs on the nominal trajectory are evaluated, s."""
LONGEST_PERIOD = 5.0
"""Longest period of the filter, s: the flare of 15 s then has a measurement after settling."""
Steps = Annotated[int, Field(ge=1, le=1_000_000)]


class ElevationFilterSection(Section):
    """The filter; defaults are the paper's table."""

    model: Literal["paper", "full", "singer"] = "paper"
    """paper: process noise of the rate alone; full: with all powers of the period; singer: exact, three states"""
    period_s: ScanPeriod = 0.0247
    """time between measurements"""
    measurement_variance_deg2: Variance = 0.0036
    """variance of a measured angle, the paper's R"""
    rate_variance_deg2_s2: Variance = 1e-4
    """variance of the rate's increment over a period, the paper's Q"""
    correlation_time_s: CorrelationTime = 1.0
    """correlation time of the angle's acceleration, for the singer model"""
    initial_deg: Pair = (2.4, 0.0042)
    """angle, and rate in deg/s, the filter starts with"""
    initial_variance: PairOf[Variance] = (0.625, 0.006)
    """variances of angle, deg2, and rate, deg2/s2, that the filter starts with"""


class MonteCarlo(Section):
    """Experiments of some runs each, as the paper proves its filter."""

    runs: Annotated[int, Field(ge=2, le=1_000_000)] = 50
    """runs of an experiment"""
    steps: Steps = 200
    """measurements of a run"""
    experiments: Annotated[int, Field(ge=1, le=100_000)] = 200
    """number of experiments"""
    band: Annotated[float, Field(ge=0.001, le=0.999)] = 0.2
    """half width of the band about the standard deviation, as a share of it"""
    confidence: Annotated[float, Field(ge=0.001, le=0.999999)] = 0.95
    """probability of being within the band, for which the smallest number of runs is looked up"""


def _check_variances(section: Any) -> None:
    if not section.rate_variances_deg2_s2:
        raise reject("an empty list", "rate_variances_deg2_s2")


def _check_run(section: Any) -> None:
    if section.to_s <= section.from_s:
        raise reject("must lie after from_s", "to_s")
    _check_variances(section)


class NominalSection(Section):
    """The run on the nominal trajectory, where truth does not follow the filter's model."""

    from_s: FlightTime = 60.0
    """start of the run, on the nominal trajectory"""
    to_s: EndTime = 110.0
    """end of the run, on the nominal trajectory"""
    rate_variances_deg2_s2: ListOf[Variance] = (1e-4, 7.462188e-6, 1.19395e-8)
    """the paper's Q, and the values of its formula for accelerations up and along"""
    first_order_variances_deg2: ListOf[Variance] = ()
    """further process noises of the first-order filter, variance of the angle's increment over a period"""

    @model_validator(mode="after")
    def _order(self) -> Self:
        _check_run(self)
        return self


class AzimuthChannel(Section):
    """The azimuth, measured from beyond the runway, while the aircraft turns onto the centre line; the filter's model
    and start are those of the elevation."""

    period_s: ScanPeriod = 0.0741
    """time between measurements, 13.5 Hz"""
    measurement_variance_deg2: Variance = 0.0036
    """variance of a measured azimuth; the paper has one for all angles"""
    rate_variances_deg2_s2: ListOf[Variance] = (3e-4, 7.0e-6)
    """Q of the filter: the noise density of the paper's Q over this period; for accelerations across at 9 km"""
    initial_deg: Pair = (3.5, -0.1)
    """azimuth, and rate in deg/s, the filter starts with"""
    on_line_s: FlightTime = 75.0
    """time of the nominal trajectory from which on the aircraft is on the centre line"""
    cross_speed_m_s: Annotated[float, Field(ge=0.1, le=200.0)] = 30.0
    """speed across, towards the centre line, before the turn"""
    cross_acceleration_m_s2: Annotated[float, Field(ge=0.01, le=50.0)] = 1.96133
    """acceleration across in the turn, 0.2 g"""
    from_s: FlightTime = 40.0
    """start of the run, on the nominal trajectory"""
    to_s: EndTime = 110.0
    """end of the run, on the nominal trajectory"""

    @model_validator(mode="after")
    def _order(self) -> Self:
        _check_run(self)
        return self


class FlareSection(Section):
    """The flare, guided from beyond the runway: by the angle of a station, or by a range and a radio altimeter."""

    range_sigma_m: Sigma = 15.0
    """1 sigma of the range to the station beyond the runway, white"""
    height_sigma_floor_m: Sigma = 0.5
    """1 sigma of the radio altimeter near the ground, white"""
    height_sigma_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """1 sigma of the radio altimeter as a share of the height, where that is more"""
    rate_variances_deg2_s2: ListOf[Variance] = (1e-4, 8.46e-6)
    """Q of the filter: the paper's, and for accelerations upwards at the start of the flare"""
    initial_deg: Pair = (0.365, -0.06)
    """angle, and rate in deg/s, the filter starts with"""
    allowed_deg: Annotated[float, Field(ge=1e-6, le=10.0)] = 0.032
    """allowed standard deviation of the angle at touchdown, the paper's"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        _check_variances(self)
        return self


class Elevation(Section):
    """The elevation angle of an aircraft on an MLS approach."""

    kind: Literal["mls-elevation"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    epoch: Utc = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
    """UTC of time 0; nothing depends on it"""
    filter: ElevationFilterSection = ElevationFilterSection()
    """the filter; defaults are the paper's table"""
    montecarlo: MonteCarlo = MonteCarlo()
    """the experiments that prove the filter"""
    nominal: NominalSection = NominalSection()
    """the run on the nominal trajectory"""
    correlation_times_s: ListOf[CorrelationTime] = (10.0, 1.0, 0.1, 0.01, 0.001)
    """correlation times of the angle's acceleration for which the exact model is compared with its two limits"""
    azimuth: AzimuthChannel = AzimuthChannel()
    """the azimuth, while the aircraft turns onto the centre line"""
    flare: FlareSection = FlareSection()
    """the flare, guided from beyond the runway"""

    @model_validator(mode="after")
    def _judged(self) -> Self:
        """Every run has a measurement behind its settling; the flare has one by its length."""
        for name, section, period in (
            ("nominal", self.nominal, self.filter.period_s), ("azimuth", self.azimuth, self.azimuth.period_s),
        ):  # fmt: skip
            if _steps(section, period) * period < SETTLING:
                message = f"{section.to_s:g} s: errors are judged {SETTLING:g} s after from_s; write at least"
                raise reject(f"{message} {section.from_s + SETTLING + period:g} s", name, "to_s")
        if self.filter.period_s > LONGEST_PERIOD:
            message = f"{self.filter.period_s:g} s: the flare lasts 15 s and is judged after {SETTLING:g} s"
            raise reject(f"{message}; write at most {LONGEST_PERIOD:g} s", "filter", "period_s")
        return self

    @property
    def nominal_steps(self) -> int:
        """Measurements of the nominal run."""
        return _steps(self.nominal, self.filter.period_s)

    @property
    def azimuth_steps(self) -> int:
        """Measurements of the azimuth's run."""
        return _steps(self.azimuth, self.azimuth.period_s)


def _steps(section: NominalSection | AzimuthChannel, period: float) -> int:
    return int((section.to_s - section.from_s) / period + 1e-9)
