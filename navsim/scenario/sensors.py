"""Inertial sensors and where the navigation starts: sections `imu` and `initial_errors`, sensors of others."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import (
    DEG,
    DEG_H,
    DEG_SQRT_H,
    MG,
    CorrelationTime,
    NonNegative,
    Section,
    Sigma,
    Signed,
    Triple,
    list_of,
    pair_of,
    reject,
)
from navsim.scenario.presets import IMU_PRESETS

if TYPE_CHECKING:
    from navsim.models.altimeter import Altimeter, Ground, RadioAltimeter
    from navsim.models.imu import Triad
    from navsim.models.pressure import BarometricAltimeter
    from navsim.scenario.approach import Runway


PPM = 1e-6


class Gyro(Section):
    """Errors of three like gyros; what is left out comes from the preset."""

    drift_deg_h: NonNegative | None = None
    """1 sigma of the constant drift, drawn per run and axis"""
    drift_fixed_deg_h: Triple | None = None
    """the drift itself, instead of drawing it"""
    noise_deg_h: NonNegative | None = None
    """1 sigma of white noise per sample; or give arw_deg_sqrt_h"""
    arw_deg_sqrt_h: NonNegative | None = None
    """angle random walk: the density of the same white noise"""
    scale_ppm: NonNegative | None = None
    """1 sigma of the constant error of the scale factor, drawn per run and axis"""
    markov_deg_h: NonNegative | None = None
    """1 sigma of the exponentially correlated drift"""
    markov_time_s: CorrelationTime | None = None
    """correlation time of the exponentially correlated drift"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        if self.noise_deg_h is not None and self.arw_deg_sqrt_h is not None:
            raise reject("noise_deg_h and arw_deg_sqrt_h are two spellings of one noise; give one", "arw_deg_sqrt_h")
        return self

    def check_markov(self, *path: str) -> None:
        """Raise, about the section at `path`, for a correlated drift without its correlation time."""
        _check_markov(self.markov_deg_h, self.markov_time_s, *path)

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.models.imu import Triad, density_from_sample_sigma

        density = _si(self.arw_deg_sqrt_h, DEG_SQRT_H)
        if self.noise_deg_h is not None:
            density = density_from_sample_sigma(self.noise_deg_h * DEG_H, rate)
        return Triad(
            bias=_si(self.drift_deg_h, DEG_H),
            noise_density=density,
            markov=_si(self.markov_deg_h, DEG_H),
            markov_time=math.inf if self.markov_time_s is None else self.markov_time_s,
            fixed_bias=_scaled(self.drift_fixed_deg_h, DEG_H),
            scale=_si(self.scale_ppm, PPM),
        )


class Accelerometer(Section):
    """Errors of three like accelerometers; what is left out comes from the preset."""

    bias_mg: NonNegative | None = None
    """1 sigma of the constant bias, drawn per run and axis"""
    bias_fixed_mg: Triple | None = None
    """the bias itself, instead of drawing it"""
    noise_mg: NonNegative | None = None
    """1 sigma of white noise per sample; or give vrw_m_s_sqrt_h"""
    vrw_m_s_sqrt_h: NonNegative | None = None
    """velocity random walk: the density of the same white noise"""
    scale_ppm: NonNegative | None = None
    """1 sigma of the constant error of the scale factor, drawn per run and axis"""
    markov_mg: NonNegative | None = None
    """1 sigma of the exponentially correlated bias"""
    markov_time_s: CorrelationTime | None = None
    """correlation time of the exponentially correlated bias"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        if self.noise_mg is not None and self.vrw_m_s_sqrt_h is not None:
            raise reject("noise_mg and vrw_m_s_sqrt_h are two spellings of one noise; give one", "vrw_m_s_sqrt_h")
        return self

    def check_markov(self, *path: str) -> None:
        """Raise, about the section at `path`, for a correlated bias without its correlation time."""
        _check_markov(self.markov_mg, self.markov_time_s, *path)

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.models.imu import Triad, density_from_sample_sigma

        density = _si(self.vrw_m_s_sqrt_h, 1.0) / 60.0
        if self.noise_mg is not None:
            density = density_from_sample_sigma(self.noise_mg * MG, rate)
        return Triad(
            bias=_si(self.bias_mg, MG),
            noise_density=density,
            markov=_si(self.markov_mg, MG),
            markov_time=math.inf if self.markov_time_s is None else self.markov_time_s,
            fixed_bias=_scaled(self.bias_fixed_mg, MG),
            scale=_si(self.scale_ppm, PPM),
        )


def _check_markov(size: float | None, time: float | None, *path: str) -> None:
    if size and time is None:
        raise reject("an exponentially correlated error needs its correlation time", *path, "markov_time_s")


def _si(value: float | None, unit: float) -> float:
    """A size of errors in SI units; an error that neither scenario nor preset names is none."""
    return 0.0 if value is None else value * unit


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


def believed(truth: Gyro | Accelerometer, given: Gyro | Accelerometer) -> Gyro | Accelerometer:
    """The true sensor with the filter's own values put in; one spelling of the noise displaces the other."""
    values = given.model_dump(exclude_none=True)
    for pair in (("noise_deg_h", "arw_deg_sqrt_h"), ("noise_mg", "vrw_m_s_sqrt_h")):
        if values.keys() & set(pair):
            values = {p: None for p in pair if hasattr(truth, p)} | values
    return truth.model_copy(update=values)


class _Sensors(Section):
    preset: Literal["paper", "perfect"] = "paper"
    """paper: 700 deg/h and 30 deg/h per sample, 1e-3 g and 1e-2 g per sample; perfect: no errors"""
    gyro: Gyro = Gyro()
    """errors of the gyros, in place of the preset's"""
    accelerometer: Accelerometer = Accelerometer()
    """errors of the accelerometers, in place of the preset's"""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if not isinstance(data, dict):
            return data
        preset = IMU_PRESETS.get(str(data.get("preset", "paper")))  # anything may stand there, a list too
        if preset is None:
            return data
        filled = dict(data)
        for sensor, values in preset.items():
            given = data.get(sensor, {})
            if isinstance(given, dict):
                white = {"noise_deg_h", "arw_deg_sqrt_h", "noise_mg", "vrw_m_s_sqrt_h"}
                spoken_for = white if white & given.keys() else set()
                filled[sensor] = {k: v for k, v in values.items() if k not in spoken_for} | given
        return filled

    @model_validator(mode="after")
    def _whole_markov(self) -> Self:
        for name in ("gyro", "accelerometer"):
            getattr(self, name).check_markov(name)
        return self


class Imu(_Sensors):
    """The inertial sensors as they really are."""

    rate_hz: Annotated[float, Field(ge=10.0, le=2000.0)] = 100.0
    """samples of the inertial sensors a second"""


class AltimeterSection(Section):
    """An altimeter beside the receiver: the height of the IMU above the ellipsoid."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_m: Sigma = 1.0
    """1 sigma of its white noise"""
    offset_m: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """how much too high it reads; the filter knows nothing of it"""
    believed_sigma_m: Sigma | None = None
    """1 sigma of the noise that the filter believes in; default: sigma_m"""

    def model(self) -> Altimeter:
        """The sensor in SI units."""
        from navsim.models.altimeter import Altimeter

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
    """The profile that a key stands for; level with the runway where it has no points."""
    import numpy as np

    from navsim.models.altimeter import Ground

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
    ground: Annotated[list_of(pair_of(Signed)), Field(max_length=200)] = ()  # type: ignore[valid-type]
    """profile of the ground along the approach, pairs of a distance beyond the threshold in the direction of landing
    (before it: negative) and a height above the runway, straight between them, level beyond; none: all is level
    with the runway"""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.lowest_m >= self.highest_m:
            raise reject(f"must be below highest_m, {self.highest_m:g} m", "lowest_m")
        check_profile(self.ground, "ground")
        return self

    def model(self, runway: Runway, given: FilterRadioAltimeter) -> RadioAltimeter:
        """The sensor in SI units on a runway, and what a filter takes it for."""
        import numpy as np

        from navsim.models.altimeter import RadioAltimeter, RadioBeliefs

        believed = RadioBeliefs(
            self.sigma_floor_m if given.sigma_floor_m is None else given.sigma_floor_m,
            self.sigma_share if given.sigma_share is None else given.sigma_share,
            profile_of(self.ground if given.ground is None else given.ground),
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
            ground=profile_of(self.ground),
            lever_arm=np.array(self.lever_arm_m),
            aim_point=runway.aim_point_m,
            height=runway.ellipsoidal_m,
            believed=believed,
        )


class FilterRadioAltimeter(Section):
    """What the filter takes the radio altimeter for; what is left out is as `radio_altimeter` says."""

    sigma_floor_m: Sigma | None = None
    """1 sigma of the noise near the ground that the filter believes in"""
    sigma_share: Share | None = None
    """1 sigma as a share of the height that the filter believes in"""
    latency_s: Late | None = None
    """latency that the filter believes in"""
    lever_arm_m: Triple | None = None
    """lever arm of the antenna that the filter believes in"""
    ground: Annotated[list_of(pair_of(Signed)), Field(max_length=200)] | None = None  # type: ignore[valid-type]
    """profile of the ground that the filter believes in; []: all is level with the runway"""
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
    """A barometric altimeter: the height above sea level that the static pressure at the IMU stands for."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_m: Sigma
    """1 sigma of its white noise"""
    lag_s: Lag = 0.0
    """lag of first order of the pressure in its tubes"""
    isa_deviation_k: Warmer = 0.0
    """by how much the air is warmer than the standard atmosphere, at all heights"""
    qnh_error_hpa: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """by how much it is set too high, about 8.3 m each; the filter knows nothing of it"""
    qnh_sigma_hpa: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """1 sigma of what comes to qnh_error_hpa in each run; the filter knows nothing of it"""
    drift_m: NonNegative = 0.0
    """1 sigma of a Gauss-Markov error that drifts; the filter knows nothing of it"""
    drift_time_s: CorrelationTime = 600.0
    """its correlation time"""

    @property
    def lasts(self) -> bool:
        """Whether runs have errors that last."""
        return self.qnh_sigma_hpa > 0.0 or self.drift_m > 0.0

    def model(self, runway: Runway, given: FilterBarometricAltimeter) -> BarometricAltimeter:
        """The sensor in SI units at a runway, and what a filter takes it for."""
        from navsim.models.pressure import AirColumn, BarometricAltimeter, PressureBeliefs

        warmer = self.isa_deviation_k if given.isa_deviation_k is None else given.isa_deviation_k
        believed = PressureBeliefs(
            self.sigma_m if given.sigma_m is None else given.sigma_m,
            self.lag_s if given.lag_s is None else given.lag_s,
            AirColumn(runway.elevation_m, warmer),
            runway.undulation_m if given.geoid_undulation_m is None else given.geoid_undulation_m,
        )
        air = AirColumn(runway.elevation_m, self.isa_deviation_k)
        return BarometricAltimeter(
            self.rate_hz, self.sigma_m, self.lag_s, air, runway.undulation_m, self.qnh_error_hpa, believed,
            self.qnh_sigma_hpa, self.drift_m, self.drift_time_s,
        )  # fmt: skip


class FilterBarometricAltimeter(Section):
    """What the filter takes the barometric altimeter for; what is left out is as `barometric_altimeter` says."""

    sigma_m: Sigma | None = None
    """1 sigma of the noise that the filter believes in"""
    lag_s: Lag | None = None
    """lag that the filter believes in"""
    isa_deviation_k: Warmer | None = None
    """by how much the filter believes the air warmer than the standard atmosphere; 0: heights as they are shown"""
    geoid_undulation_m: Annotated[float, Field(ge=-120.0, le=100.0)] | None = None
    """height of the geoid above the ellipsoid that the filter believes in; default: runway.geoid_undulation_m"""


class Vectors(Section):
    """One value for each of north, east, down."""

    attitude_deg: Triple = (0.0, 0.0, 0.0)
    """attitude error, a rotation vector"""
    position_m: Triple = (0.0, 0.0, 0.0)
    """position error"""
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    """velocity error"""


class InitialErrorsSection(Section):
    """Errors (truth - estimate) the navigation starts with: 1 sigma per axis, drawn per run."""

    attitude_deg: Annotated[float, Field(ge=0.0, le=60.0)] = 5.0
    """1 sigma of the attitude error about each axis"""
    position_m: NonNegative = 10.0
    """1 sigma of the position error along each axis"""
    velocity_m_s: NonNegative = 1.0
    """1 sigma of the velocity error along each axis"""
    fixed: Vectors | None = None
    """the errors themselves, instead of drawing them; the filter still starts from the sigmas"""
