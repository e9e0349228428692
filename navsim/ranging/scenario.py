"""`kind: ranges`: recorded ranges of beacons or pseudolites, without an inertial sensor."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.sky import Files
from navsim.scenario.transmitters import ClockModel
from navsim.scenario_files.base import (
    CorrelationTime,
    Latitude,
    ListOf,
    LogTime,
    Longitude,
    NonNegative,
    PairOf,
    Section,
    Sigma,
    SourceName,
    Triple,
    Utc,
    Version,
    hint,
    reject,
)

RANGE_UNITS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "ns": 0.299792458, "us": 299.792458}
"""Units of ranges, each in m; times are those of the way."""
LENGTH_UNITS = {unit: RANGE_UNITS[unit] for unit in ("m", "km", "cm", "mm", "ft")}
"""Units of positions, each in m."""
RECEIVER = "receiver"
"""Name of the receiver among the clocks."""
RangeUnit = Literal["m", "km", "cm", "mm", "ft", "ns", "us"]
LengthUnit = Literal["m", "km", "cm", "mm", "ft"]
TimeUnit = Literal["s", "ms", "us", "ns"]
AngleUnit = Literal["deg", "rad", "1e-7 deg"]
Share = Annotated[float, Field(ge=1e-6, le=0.5)]
Columns = dict[str, str]


def _known_columns(value: Columns, names: tuple[str, ...]) -> None:
    for name in value:
        if name not in names:
            raise reject(f"{name!r} is no column; {hint(name, list(names))}", "columns")


class RangesSection(Section):
    """The ranges."""

    file: Files
    """table with one range a row: t_s, source, range_m, if known sigma_m and signal_dbm; one file or a list; .gz too"""
    columns: Columns = Field(default_factory=dict)
    """names of these columns in the file where they are others: {source: anchor, ...}"""
    source_columns: dict[str, SourceName] = Field(default_factory=dict)
    """for a table with a column for each source: {name of the column: name of the source}"""
    time_unit: TimeUnit = "s"
    """unit of the times"""
    range_unit: RangeUnit = "m"
    """unit of ranges and their sigmas; ns: time of the way"""
    measurement: Literal["two_way", "one_way"]
    """two_way: the vehicle asks and the beacon answers, no clock; one_way: pseudoranges, with a clock for each source
    and one for the receiver"""
    sigma_m: Sigma | None = None
    """1 sigma of the white noise of a range; left out: tuned. A column sigma_m says how it differs by range"""
    noise: Literal["by_source", "common"] = "by_source"
    """whether tuned sigmas of white noise and wander differ by source, or are common to all"""

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = ("t_s", "source", "range_m", "sigma_m", "signal_dbm")
        _known_columns(self.columns, names)
        if self.source_columns:
            for name in names[1:]:
                if name in self.columns:
                    raise reject("source_columns already says where the ranges are", "columns", name)
        return self


class SourcePosition(Section):
    """A source and its position, in local axes or geodetic."""

    name: SourceName
    """name of the source, as in the table of ranges"""
    position_m: Triple | None = None
    """position in local axes: x, y, z (up)"""
    lat_deg: Latitude | None = None
    """latitude"""
    lon_deg: Longitude | None = None
    """longitude"""
    height_m: Annotated[float, Field(ge=-1e4, le=1e5)] | None = None
    """height above the ellipsoid"""

    @model_validator(mode="after")
    def _check_one_form(self) -> Self:
        geodetic = (self.lat_deg, self.lon_deg, self.height_m)
        if (self.position_m is None) == (None in geodetic) and (self.position_m is None or geodetic != (None,) * 3):
            raise reject("give position_m, or lat_deg, lon_deg and height_m", "position_m")
        if self.position_m is not None and geodetic != (None, None, None):
            raise reject("give position_m, or lat_deg, lon_deg and height_m, not both", "position_m")
        return self


class SourceTable(Section):
    """Positions of the sources: a list, or a table."""

    positions: ListOf[SourcePosition] = ()
    """list of sources"""
    file: str | None = None
    """table with source and x_m, y_m, z_m, or source and lat_deg, lon_deg, h_m; rows may repeat a source"""
    columns: Columns = Field(default_factory=dict)
    """names of these columns in the file where they are others"""
    length_unit: LengthUnit = "m"
    """unit of the lengths in the table"""
    angle_unit: AngleUnit = "deg"
    """unit of latitude and longitude in the table"""

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.file is None) == (not self.positions):
            raise reject("give the positions of the sources as a list, or name a table of them", "file")
        _known_columns(self.columns, ("source", "x_m", "y_m", "z_m", "lat_deg", "lon_deg", "h_m"))
        if len({one.name for one in self.positions}) < len(self.positions):
            raise reject("a source stands twice in the list", "positions")
        return self


class StartPosition(Section):
    """Position at the first range, where it is known."""

    position_m: Triple
    """position in local axes, east, north, up from the middle of the sources if these are geodetic"""
    sigma_m: PairOf[Sigma] = (10.0, 10.0)
    """1 sigma: horizontal per axis, vertical"""


class MotionSection(Section):
    """Motion of the vehicle between ranges."""

    model: Literal["velocity", "acceleration"] = "velocity"
    """constant part of the motion, but for noise. Velocity: walkers and cars; acceleration: aircraft that circle"""
    noise: PairOf[Sigma] | None = None
    """root of the density of that noise, horizontal per axis and vertical: m/s a root second of a velocity, m/s2 a root
    a root second of an acceleration or jerk; left out: tuned"""
    correlation_time_s: CorrelationTime | None = None
    """correlation time of the acceleration, for acceleration; left out: tuned"""
    height: Literal["free", "constant"] = "free"
    """constant: the vehicle stays at the height it starts at, such as a car on level ground"""
    speed_sigma_m_s: Sigma = 10.0
    """1 sigma of the velocity at the start, per axis"""
    start: StartPosition | None = None
    """position at the first range; left out: found from the ranges"""


class Growth(Section):
    """Part of the bias that grows with distance d: s (1 - exp(-d / distance_m))."""

    sigma_m: Sigma
    """1 sigma of s, m"""
    distance_m: Annotated[float, Field(ge=0.1, le=1e6)] = 17.0
    """distance at which it has grown to 63 %"""


class WanderSection(Section):
    """Error of a range that wanders: a Gauss-Markov process."""

    sigma_m: NonNegative
    """1 sigma; 0: none"""
    correlation_time_s: CorrelationTime
    """correlation time"""


class BiasSection(Section):
    """Errors of the ranges that last."""

    sigma_m: NonNegative = 0.1
    """1 sigma of the constant bias of each source, for two_way; pseudoranges have it in the clock"""
    growth: Growth | None = None
    """a further state for each source, for two_way"""
    wander: WanderSection | None = None
    """wandering error of each source, such as reflections; left out: tuned"""
    smoothing_s: NonNegative | None = None
    """time constant of the receiver's smoothing of this wandering error, for one_way; left out: tuned; 0: none"""
    place: WanderSection = WanderSection(sigma_m=0.03, correlation_time_s=30.0)
    """slow error of each source that differs from place to place, such as that of antennas, for two_way. Ranges alone
    hardly show it, so it is never tuned; sigma_m 0: none"""
    common: WanderSection = WanderSection(sigma_m=0.1, correlation_time_s=15.0)
    """wandering error that all ranges share, such as the vehicle's antenna, for two_way. Ranges alone cannot tell it
    from motion, so it is never tuned"""


class ClocksSection(Section):
    """Clocks of pseudoranges. Ranges show only their differences, so one clock is the datum."""

    datum: SourceName | None = None
    """source whose clock is the datum, or `receiver`; left out: the first source of the table"""
    sources: ClockModel | None = None
    """noise of each source's clock; left out: tuned"""
    receiver: ClockModel | None = None
    """noise of the receiver's clock; left out: tuned"""
    offset_sigma_m: Sigma = 100.0
    """1 sigma of each source's clock offset at the start"""
    rate_sigma_m_s: Sigma = 1.0
    """1 sigma of each source's clock rate at the start; 1 m/s is 3.3 parts in 1e9"""


class OutlierSection(Section):
    """Ranges with another noise than the usual, as shares of a mixture; what is left out is tuned."""

    share: Share | None = None
    """share of outliers to both sides"""
    sigma_m: Sigma | None = None
    """1 sigma of these"""
    long_share: Share | None = None
    """share of ranges that are too long, by a reflection or without line of sight"""
    long_m: Sigma | None = None
    """mean and 1 sigma of how much they are too long"""


class ReferenceSection(Section):
    """True positions, to compare with."""

    file: str
    """table with t_s and x_m, y_m, z_m, or lat_deg, lon_deg, h_m"""
    columns: Columns = Field(default_factory=dict)
    """names of these columns in the file where they are others"""
    time_unit: TimeUnit = "s"
    """unit of the times"""
    length_unit: LengthUnit = "m"
    """unit of the lengths"""
    angle_unit: AngleUnit = "deg"
    """unit of latitude and longitude"""
    time_offset_s: LogTime | None = None
    """added to the times of the table; left out: the offset up to 1 s at which the ranges fit the table best"""

    @model_validator(mode="after")
    def _known(self) -> Self:
        _known_columns(self.columns, ("t_s", "x_m", "y_m", "z_m", "lat_deg", "lon_deg", "h_m"))
        return self


class RecordedRanges(Section):
    """Recorded ranges through a filter of position, clocks and biases."""

    kind: Literal["ranges"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    epoch: Utc = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    """UTC of t_s = 0"""
    ranges: RangesSection
    """the ranges"""
    sources: SourceTable
    """positions of the sources"""
    motion: MotionSection = MotionSection()
    """motion of the vehicle"""
    bias: BiasSection = BiasSection()
    """errors of the ranges that last"""
    clocks: ClocksSection = ClocksSection()
    """clocks, for one_way"""
    outliers: OutlierSection = OutlierSection()
    """ranges with another noise than the usual"""
    reference: ReferenceSection | None = None
    """true positions, to compare with"""
    start_s: LogTime | None = None
    """first time to use; default: the first range"""
    end_s: LogTime | None = None
    """last time to use; default: the last range"""
    tuning: Literal["likelihood", "none"] = "likelihood"
    """likelihood: settings of the noise that are left out make the ranges most likely; none: they stay where the tuning
    would start"""
    smoother: bool = True
    """estimate each position from all ranges too, not only from those before it"""

    @model_validator(mode="after")
    def _fit(self) -> Self:
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise reject("must come after start_s", "end_s")
        one_way = self.ranges.measurement == "one_way"
        if one_way and self.bias.growth is not None:
            raise reject("pseudoranges do not show the distance; leave growth out", "bias", "growth")
        if self.motion.model == "velocity" and self.motion.correlation_time_s is not None:
            raise reject("the velocity model has no acceleration; leave it out", "motion", "correlation_time_s")
        if not one_way and self.bias.smoothing_s is not None:
            raise reject("two-way ranges are measured one by one; leave it out", "bias", "smoothing_s")
        if self.bias.smoothing_s and self.bias.wander is not None and self.bias.wander.sigma_m == 0.0:
            raise reject("bias.wander leaves no error to smooth; leave it out", "bias", "smoothing_s")
        if not one_way and self.clocks != ClocksSection():
            raise reject("two-way ranges have no clocks; leave this section out", "clocks")
        return self
