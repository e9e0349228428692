"""`kind: mls-elevation`: the elevation filter of an MLS approach, its Monte Carlo proof, its adequacy."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import (
    CorrelationTime,
    ListOf,
    Pair,
    PairOf,
    ScanPeriod,
    Section,
    Utc,
    Variance,
    Version,
    reject,
)

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


class NominalSection(Section):
    """The run on the nominal trajectory, where truth does not follow the filter's model."""

    from_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 60.0
    """start of the run, on the nominal trajectory"""
    to_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 110.0
    """end of the run, on the nominal trajectory"""
    rate_variances_deg2_s2: ListOf[Variance] = (1e-4, 7.462188e-6, 1.19395e-8)
    """the paper's Q, and what its formula gives for accelerations up and along"""

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.to_s <= self.from_s:
            raise reject("must lie after from_s", "to_s")
        if not self.rate_variances_deg2_s2:
            raise reject("an empty list", "rate_variances_deg2_s2")
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

    @property
    def nominal_steps(self) -> int:
        """Measurements of the nominal run."""
        span = self.nominal.to_s - self.nominal.from_s
        return int(span / self.filter.period_s + 1e-9)
