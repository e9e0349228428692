"""Inertial sensors and where the navigation starts: sections `imu` and `initial_errors`, sensors of others."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.base import (
    DEG_H,
    DEG_SQRT_H,
    MG,
    CorrelationTime,
    NonNegative,
    Section,
    Sigma,
    Triple,
    reject,
)
from navsim.scenario.presets import IMU_PRESETS

if TYPE_CHECKING:
    from navsim.models.altimeter import Altimeter
    from navsim.models.imu import Triad


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
        return Altimeter(self.rate_hz, self.offset_m, (self.sigma_m,), (believed,))


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
