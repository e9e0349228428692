"""Ground stations of landing systems (ILS, MLS, DME): sections `azimuth_station`, `elevation_station`, `dme`.

The sections of the same names in `filter` are the filter's models of them.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.aiding_sensors import AidingSection, FilterAidingSection, Late
from navsim.scenario.events import Error
from navsim.scenario.guidance import BEYOND_END
from navsim.scenario.terrain import terrain_of
from navsim.scenario_files.base import (
    DEG,
    CorrelationTime,
    FlightTime,
    ListOf,
    NonNegative,
    PairOf,
    Section,
    Sigma,
    Signed,
    Triple,
    reject,
)
from navsim.scenario_files.presets import STATION_PRESETS

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing
    from navsim.sensors.ground_stations import GroundStation, StationDesign, StationErrors

Angle = Annotated[float, Field(ge=-90.0, le=90.0)]
AngleSigma = Annotated[float, Field(ge=1e-6, le=10.0)]
AngleError = Annotated[float, Field(ge=0.0, le=10.0)]
Beyond = Annotated[float, Field(ge=-1e5, le=1e5)]


class StationFault(Section):
    """An error that a station radiates for some time, of which the filter knows nothing."""

    at_s: FlightTime = 0.0
    """when it begins, after time 0"""
    until_s: FlightTime | None = None
    """when it ends, after time 0; null: at the end of the flight"""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise reject("must lie after at_s", "until_s")
        if self.size == (0.0, 0.0):
            raise reject("changes nothing: give an error or its rate")
        return self

    @property
    def size(self) -> tuple[float, float]:
        """Error at the beginning, and its rate, in units of the keys."""
        raise NotImplementedError

    def row(self, scale: float) -> tuple[float, float, float, float]:
        """A row of `GroundStation.faults`; scale: SI units of a unit of the keys."""
        error, rate = self.size
        return self.at_s, math.inf if self.until_s is None else self.until_s, scale * error, scale * rate


class DistanceFault(StationFault):
    """A fault of an azimuth station, in metres at the threshold, or of a DME."""

    error_m: Error = 0.0
    """error when it begins"""
    rate_m_s: Error = 0.0
    """how fast it grows"""

    @property
    def size(self) -> tuple[float, float]:
        """m, m/s."""
        return self.error_m, self.rate_m_s


class AngleFault(StationFault):
    """A fault of an elevation station."""

    error_deg: Angle = 0.0
    """error when it begins"""
    rate_deg_s: Angle = 0.0
    """how fast it grows"""

    @property
    def size(self) -> tuple[float, float]:
        """Degrees, degrees per second."""
        return self.error_deg, self.rate_deg_s


class StationSection(AidingSection):
    """A ground station: white noise, a bias that is constant in each run, and bends that change along the flight."""

    # of the section, and of the station
    name: ClassVar[str]
    # end of the keys of its errors
    size: ClassVar[str] = "m"

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 5.0
    """measurements a second"""
    bends_time_s: CorrelationTime = 2.0
    """correlation time of the bends. 2 s: of errors below 0.5 rad/s, which count as path following errors
    (14 CFR 171.303)"""
    beyond_m: Beyond | None = None
    """distance of the station beyond the threshold"""
    height_m: Signed = 0.0
    """height of its antenna above the runway"""
    latency_s: Late = 0.0
    """time from a measurement to its arrival"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """IMU to the antenna that receives it: forward, right, down"""
    off_s: Annotated[ListOf[PairOf[FlightTime]], Field(max_length=100)] = ()
    """outages: pairs of times from which and until which it is off, such as [[30, 40]]"""
    faults: Annotated[ListOf[DistanceFault], Field(max_length=100)] = ()
    """errors that it radiates for some time, unknown to the filter; of an azimuth station at the threshold"""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if isinstance(data, dict):
            return {**STATION_PRESETS[cls.name].get(str(data.get("preset")), {}), **data}
        return data

    @model_validator(mode="after")
    def _check_outages(self) -> Self:
        for i, (start, end) in enumerate(self.off_s):
            if start >= end:
                raise reject(f"ends at {end:g} s, not after its start at {start:g} s", "off_s", i)
        return self

    def check(self, landing: Landing) -> None:
        """Raise for keys of states that there are not."""
        its = self.assumed(landing)
        for key in () if its.errors == "states" else self.error_keys():
            if getattr(its, key) is not None:
                raise reject("is for `errors: states`", "filter", self.name, key)

    def error_keys(self) -> tuple[str, str]:
        """Keys of the errors that a filter may estimate."""
        return f"bias_{self.size}", f"bends_{self.size}"

    def error_without_state(self, landing: Landing) -> str | None:
        """Key of an error, if the filter does not estimate them."""
        if self.assumed(landing).errors == "states":
            return None
        return next((key for key in self.error_keys() if getattr(self, key)), None)

    def names(self) -> tuple[str, ...]:
        """That of its section."""
        return (self.name,)

    def assumed(self, landing: Landing) -> FilterStation:
        """The section of the filter's model of it."""
        its: FilterStation = getattr(landing.filter, self.name)
        return its

    def place(self, landing: Landing) -> tuple[float, float]:
        """Distance beyond the threshold and right of the centre line, m."""
        runway = landing.runway
        return runway.extent_m + BEYOND_END["ils"] if self.beyond_m is None else self.beyond_m, 0.0

    def placing_key(self) -> str:
        """Key to change where the antenna is in the way of the aircraft."""
        return "right_m" if self.beyond_m is None and "right_m" in type(self).model_fields else "beyond_m"

    def scale(self, landing: Landing) -> float:
        """SI units of a measurement in a unit of the keys of its errors."""
        return 1.0

    def nominal_bias(self, landing: Landing) -> float:
        """Bound of its bias without a fault that levels allow for, rad or m."""
        assert landing.integrity is not None
        return self.scale(landing) * float(getattr(landing.integrity, f"b_nom_{self.name}_{self.size}"))

    def limits(self, landing: Landing) -> tuple[float, float]:
        """Smallest and largest measurement, rad or m."""
        return 0.0, math.inf

    def model(self, landing: Landing) -> GroundStation:
        """The station at a runway, and its filter model."""
        import numpy as np

        from navsim.sensors.ground_stations import AzimuthStation, Dme, ElevationStation, StationDesign, StationErrors

        runway, its, scale = landing.runway, self.assumed(landing), self.scale(landing)
        other = self.model_copy(update={key: value for key, value in its if value is not None and key != "errors"})

        def of(section: StationSection, followed: bool = True) -> StationDesign:
            bias, bends = (scale * getattr(section, key) if followed else 0.0 for key in self.error_keys())
            noise = scale * getattr(section, f"noise_{self.size}")
            errors: StationErrors = StationErrors(bias, bends, section.bends_time_s)
            return StationDesign(noise, section.latency_s, np.array(section.lever_arm_m), errors)

        along, right = self.place(landing)
        mine = of(self)
        station = next(kind for kind in (AzimuthStation, ElevationStation, Dme) if kind.name == self.name)
        return station(
            (along, right, runway.rise * along + self.height_m), runway.aim_point_m, runway.ellipsoidal_m,
            self.rate_hz, mine.latency, mine.noise, self.limits(landing), mine.lever_arm,
            np.array(self.off_s).reshape(-1, 2), np.array([fault.row(scale) for fault in self.faults]).reshape(-1, 4),
            mine.errors, functools.partial(terrain_of, landing.terrain), of(other, its.errors == "states"),
        )  # fmt: skip


class AzimuthStationSection(StationSection):
    """Localizer of an ILS, or approach azimuth of an MLS: angle from the vertical plane of the centre line."""

    name = "azimuth_station"

    preset: Literal["none", "ils-1", "ils-2", "ils-3", "mls"] = "none"
    """limits of ICAO Annex 10. Localizers of category I, II and III have bias_m, bends_m, and as half_width_m their
    linear sector, 124.1 m; give their noise_m. An MLS azimuth has bias_m and noise_m"""
    bias_m: NonNegative = 0.0
    """1 sigma of the bias, at the threshold"""
    bends_m: NonNegative = 0.0
    """1 sigma of the bends, at the threshold"""
    noise_m: Sigma
    """1 sigma of the white noise, at the threshold"""
    half_width_m: Annotated[float, Field(ge=1.0, le=1e5)] | None = None
    """distance from the centre line at the threshold up to which it measures; null: to all sides of the approach"""

    @model_validator(mode="before")
    @classmethod
    def _refuse_offset(cls, data: Any) -> Any:
        if isinstance(data, dict) and "right_m" in data:
            raise reject("an azimuth station stands on the centre line: navsim simulates no offset", "right_m")
        return data

    def check(self, landing: Landing) -> None:
        """Also raise for an antenna that is not beyond the threshold."""
        super().check(landing)
        if self.place(landing)[0] < 1.0:
            raise reject("the antenna must stand beyond the threshold", "azimuth_station", "beyond_m")

    def scale(self, landing: Landing) -> float:
        """Angle of a metre at the threshold, rad."""
        return 1.0 / self.place(landing)[0]

    def limits(self, landing: Landing) -> tuple[float, float]:
        """Smallest and largest angle, rad."""
        wide = math.pi / 2 if self.half_width_m is None else math.atan(self.half_width_m * self.scale(landing))
        return -wide, wide


class ElevationStationSection(StationSection):
    """Glide path of an ILS, or approach elevation of an MLS: angle above the horizontal plane at the station."""

    name, size = "elevation_station", "deg"

    preset: Literal["none", "ils", "mls"] = "none"
    """limits of 14 CFR 171. A glide path of 3 degrees gets bias_deg, and its full scale as low_deg, 2.28, and high_deg,
    3.72. An MLS elevation gets bias_deg, bends_deg, noise_deg, and low_deg, 0.9"""
    faults: Annotated[ListOf[AngleFault], Field(max_length=100)] = ()  # type: ignore[assignment]  # a DME's are in metres
    """errors that it radiates for some time, unknown to the filter"""
    right_m: Beyond = 120.0
    """distance of the station right of the centre line; without beyond_m it stands abeam of the touchdown point"""
    bias_deg: AngleError = 0.0
    """1 sigma of the bias"""
    bends_deg: AngleError = 0.0
    """1 sigma of the bends"""
    noise_deg: AngleSigma
    """1 sigma of the white noise"""
    low_deg: Angle = 0.0
    """angle below which it measures nothing"""
    high_deg: Angle = 90.0
    """angle above which it measures nothing"""

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        if self.low_deg >= self.high_deg:
            raise reject(f"must be below high_deg, {self.high_deg:g}", "low_deg")
        return self

    def place(self, landing: Landing) -> tuple[float, float]:
        """Distance beyond the threshold and right of the centre line, m."""
        return landing.runway.aim_point_m if self.beyond_m is None else self.beyond_m, self.right_m

    def scale(self, landing: Landing) -> float:
        """A degree, rad."""
        return DEG

    def limits(self, landing: Landing) -> tuple[float, float]:
        """Smallest and largest angle, rad."""
        return self.low_deg * DEG, self.high_deg * DEG


class DmeSection(StationSection):
    """Distance measuring equipment beside the azimuth station."""

    name = "dme"

    preset: Literal["none", "dme-n", "dme-p"] = "none"
    """limits of ICAO Annex 10 as bias: of DME/N, or of DME/P at the threshold (standard 1), also with its noise"""
    right_m: Beyond = 0.0
    """distance of the station right of the centre line"""
    bias_m: NonNegative = 0.0
    """1 sigma of the bias"""
    bends_m: NonNegative = 0.0
    """1 sigma of the error that changes along the flight"""
    noise_m: Sigma
    """1 sigma of the white noise"""

    def place(self, landing: Landing) -> tuple[float, float]:
        """Distance beyond the threshold and right of the centre line, m."""
        return super().place(landing)[0], self.right_m


class FilterStation(FilterAidingSection):
    """Filter model of a ground station; omitted keys are those of the station."""

    errors: Literal["states", "none"] = "states"
    """what the filter does about bias and bends: states: estimate those that it assumes, a state each; none: nothing"""
    bends_time_s: CorrelationTime | None = None
    """correlation time of the bends in the filter model"""
    latency_s: Late | None = None
    """latency in the filter model"""
    lever_arm_m: Triple | None = None
    """lever arm in the filter model"""


class FilterAzimuthStation(FilterStation):
    """Filter model of the azimuth station; omitted keys are as in `azimuth_station`."""

    needs = "azimuth_station: {noise_m: ...}"

    bias_m: NonNegative | None = None
    """1 sigma of the bias in the filter model"""
    bends_m: NonNegative | None = None
    """1 sigma of the bends in the filter model"""
    noise_m: Sigma | None = None
    """1 sigma of the noise in the filter model"""


class FilterElevationStation(FilterStation):
    """Filter model of the elevation station; omitted keys are as in `elevation_station`."""

    needs = "elevation_station: {noise_deg: ...}"

    bias_deg: AngleError | None = None
    """1 sigma of the bias in the filter model"""
    bends_deg: AngleError | None = None
    """1 sigma of the bends in the filter model"""
    noise_deg: AngleSigma | None = None
    """1 sigma of the noise in the filter model"""


class FilterDme(FilterAzimuthStation):
    """Filter model of the DME; omitted keys are as in `dme`."""

    needs = "dme: {noise_m: ...}"
