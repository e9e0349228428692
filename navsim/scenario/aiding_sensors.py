"""Sensors of height: sections `altimeter`, `radio_altimeter`, `barometric_altimeter`, and what the filter assumes."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import (
    DEG,
    CorrelationTime,
    ListOf,
    NonNegative,
    PairOf,
    Section,
    Sigma,
    Signed,
    Triple,
    reject,
)

if TYPE_CHECKING:
    from navsim.scenario.approach import Runway
    from navsim.sensors.altimeter import Altimeter, Ground, RadioAltimeter
    from navsim.sensors.barometer import BarometricAltimeter


class AltimeterSection(Section):
    """An altimeter for the height of the IMU above the ellipsoid."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_m: Sigma = 1.0
    """1 sigma of its white noise"""
    offset_m: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """how much too high it reads; the filter does not know it"""
    believed_sigma_m: Sigma | None = None
    """1 sigma of the noise in the filter model; default: sigma_m"""

    def model(self) -> Altimeter:
        """The sensor in SI units."""
        from navsim.sensors.altimeter import Altimeter

        believed = self.sigma_m if self.believed_sigma_m is None else self.believed_sigma_m
        return Altimeter(self.rate_hz, self.offset_m, self.sigma_m, believed)


Share = Annotated[float, Field(ge=0.0, le=0.5)]
Late = Annotated[float, Field(ge=0.0, le=5.0)]


def check_profile(ground: tuple[tuple[float, float], ...], *path: str) -> None:
    """Raise, about the key at `path`, for a profile whose distances do not increase."""
    for i, (before, after) in enumerate(itertools.pairwise(ground)):
        if after[0] < before[0] + 0.01:
            raise reject(
                f"distances beyond the threshold must increase, by 0.01 m at least; {after[0]:g} m comes after "
                f"{before[0]:g} m", *path, i + 1,
            )  # fmt: skip


def profile_of(ground: tuple[tuple[float, float], ...]) -> Ground:
    """Profile through these points; without points level with the threshold."""
    import numpy as np

    from navsim.sensors.altimeter import Ground

    points = np.array(ground or ((0.0, 0.0),))
    return Ground(points[:, 0].copy(), points[:, 1].copy())


class RadioAltimeterSection(Section):
    """A radio altimeter: the height of its antenna above the ground under it."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_floor_m: Sigma
    """1 sigma of its white noise near the ground"""
    sigma_share: Share = 0.0
    """1 sigma as a share of the height, where that is more"""
    lowest_m: Annotated[float, Field(ge=-100.0, le=1e4)] = 0.0
    """height above ground below which it measures nothing"""
    highest_m: Annotated[float, Field(ge=1.0, le=1e4)] = 750.0
    """height above ground above which it measures nothing"""
    attitude_limit_deg: Annotated[float, Field(ge=1.0, le=90.0)] = 30.0
    """angle between the aircraft's vertical axis and the vertical above which it measures nothing"""
    latency_s: Late = 0.0
    """time from a measurement to its arrival"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """IMU to its antenna: forward, right, down"""
    ground: Annotated[ListOf[PairOf[Signed]], Field(max_length=200)] = ()
    """profile of the ground along the approach: pairs of distance and height from the threshold, with straight lines
    between them and level ground beyond. Distances before the threshold are negative. Left out: the runway's own slope,
    and level ground before and beyond it"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if self.lowest_m >= self.highest_m:
            raise reject(f"must be below highest_m, {self.highest_m:g} m", "lowest_m")
        check_profile(self.ground, "ground")
        return self

    def model(self, runway: Runway, given: FilterRadioAltimeter) -> RadioAltimeter:
        """The sensor in SI units on a runway, and its filter model."""
        import numpy as np

        from navsim.sensors.altimeter import RadioAltimeter, RadioBeliefs

        ground = profile_of(self.ground or runway.surface)
        believed = RadioBeliefs(
            self.sigma_floor_m if given.sigma_floor_m is None else given.sigma_floor_m,
            self.sigma_share if given.sigma_share is None else given.sigma_share,
            ground if given.ground is None else profile_of(given.ground),
            np.array(self.lever_arm_m if given.lever_arm_m is None else given.lever_arm_m),
            self.latency_s if given.latency_s is None else given.latency_s,
            -math.inf if given.from_m is None else given.from_m,
        )
        return RadioAltimeter(
            rate=self.rate_hz,
            floor=self.sigma_floor_m,
            share=self.sigma_share,
            lowest=self.lowest_m,
            highest=self.highest_m,
            tilt=self.attitude_limit_deg * DEG,
            latency=self.latency_s,
            ground=ground,
            lever_arm=np.array(self.lever_arm_m),
            aim_point=runway.aim_point_m,
            height=runway.ellipsoidal_m,
            believed=believed,
        )


class FilterRadioAltimeter(Section):
    """Filter model of the radio altimeter; omitted keys are as in `radio_altimeter`."""

    sigma_floor_m: Sigma | None = None
    """1 sigma of the noise near the ground in the filter model"""
    sigma_share: Share | None = None
    """1 sigma as a share of the height in the filter model"""
    latency_s: Late | None = None
    """latency in the filter model"""
    lever_arm_m: Triple | None = None
    """lever arm of the antenna in the filter model"""
    ground: Annotated[ListOf[PairOf[Signed]], Field(max_length=200)] | None = None
    """profile of the ground in the filter model; []: level with the threshold"""
    from_m: Signed | None = None
    """distance beyond the threshold from which on the filter uses heights above ground; 0: over the runway alone;
    left out: everywhere"""

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        check_profile(self.ground or (), "ground")
        return self


Warmer = Annotated[float, Field(ge=-80.0, le=60.0)]
Lag = Annotated[float, Field(ge=0.0, le=10.0)]


class BarometricAltimeterSection(Section):
    """A barometric altimeter: height above sea level from the static pressure at the IMU."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_m: Sigma
    """1 sigma of its white noise"""
    lag_s: Lag = 0.0
    """lag of first order of the pressure in its tubes"""
    isa_deviation_k: Warmer = 0.0
    """by how much the air is warmer than the standard atmosphere, at all heights"""
    qnh_error_hpa: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """by how much it is set too high, about 8.3 m each; the filter knows it only with
    filter.barometric_altimeter.errors"""
    qnh_sigma_hpa: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """1 sigma of the setting error in each run, in addition to qnh_error_hpa"""
    drift_m: NonNegative = 0.0
    """1 sigma of a Gauss-Markov error that drifts"""
    drift_time_s: CorrelationTime = 600.0
    """its correlation time"""

    @model_validator(mode="after")
    def _drifts(self) -> Self:
        # a drift of 0 is one too, as in a sweep of its size or in a stored scenario, which has every key
        if "drift_time_s" in self.model_fields_set and "drift_m" not in self.model_fields_set:
            raise reject("there is no drift: give drift_m", "drift_time_s")
        return self

    def lasting(self, given: FilterBarometricAltimeter) -> tuple[float, float, float]:
        """1 sigma of the setting error, hPa, including the known one, and of the drift, m, with its correlation time,
        s.

        For the model of a filter that estimates them.
        """
        setting = math.hypot(self.qnh_error_hpa, self.qnh_sigma_hpa)
        return (
            setting if given.qnh_sigma_hpa is None else given.qnh_sigma_hpa,
            self.drift_m if given.drift_m is None else given.drift_m,
            self.drift_time_s if given.drift_time_s is None else given.drift_time_s,
        )

    def model(self, runway: Runway, given: FilterBarometricAltimeter) -> BarometricAltimeter:
        """The sensor in SI units at a runway, and its filter model."""
        from navsim.sensors.barometer import SLOPE, AirColumn, BarometricAltimeter, PressureBeliefs

        warmer = self.isa_deviation_k if given.isa_deviation_k is None else given.isa_deviation_k
        setting, drift, drift_time = self.lasting(given)
        believed = PressureBeliefs(
            self.sigma_m if given.sigma_m is None else given.sigma_m,
            self.lag_s if given.lag_s is None else given.lag_s,
            AirColumn(runway.elevation_m, warmer),
            runway.undulation_m if given.geoid_undulation_m is None else given.geoid_undulation_m,
            *((SLOPE * setting, drift, drift_time) if given.errors == "states" else ()),
        )
        air = AirColumn(runway.elevation_m, self.isa_deviation_k)
        return BarometricAltimeter(
            self.rate_hz, self.sigma_m, self.lag_s, air, runway.undulation_m, self.qnh_error_hpa, believed,
            self.qnh_sigma_hpa, self.drift_m, self.drift_time_s,
        )  # fmt: skip


class FilterBarometricAltimeter(Section):
    """Filter model of the barometric altimeter; omitted keys are as in `barometric_altimeter`."""

    sigma_m: Sigma | None = None
    """1 sigma of the noise in the filter model"""
    lag_s: Lag | None = None
    """lag in the filter model"""
    isa_deviation_k: Warmer | None = None
    """how much warmer than the standard atmosphere the filter assumes the air to be; 0: no correction"""
    geoid_undulation_m: Annotated[float, Field(ge=-120.0, le=100.0)] | None = None
    """height of the geoid above the ellipsoid in the filter model; default: runway.geoid_undulation_m"""
    errors: Literal["states", "none"] = "none"
    """how the filter handles time-correlated errors: states: estimate the setting and the drift, if they are in its
    model, with a state each; none: not at all"""
    qnh_sigma_hpa: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    """1 sigma of the setting error in the filter model; default: qnh_error_hpa and qnh_sigma_hpa together"""
    drift_m: NonNegative | None = None
    """1 sigma of the drift in the filter model"""
    drift_time_s: CorrelationTime | None = None
    """correlation time of the drift in the filter model"""
