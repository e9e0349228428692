"""Inertial sensors: section `imu`, and what the filter assumes of them."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario_files.base import (
    DEG,
    DEG_H,
    DEG_SQRT_H,
    MG,
    CorrelationTime,
    ListOf,
    NonNegative,
    PairOf,
    Section,
    Triple,
    reject,
)
from navsim.scenario_files.presets import IMU_PRESETS, IMU_SHEETS
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.sensors.imu import Triad
    from navsim.sensors.imu_errors import ImuErrorModel, Vibration, Warming


PPM = 1e-6
G = 1e3 * MG
USUAL_TIME = 100.0
"""Correlation time of the bias instability of data sheets, which omit it, s: that of other open simulators
(gnss-ins-sim, NaveGo)."""
USUAL_DAMPING = math.sqrt(0.5)
Frequency = Annotated[float, Field(ge=1e-4, le=1e5)]
Damping = Annotated[float, Field(ge=0.05, le=5.0)]


class Gyro(Section):
    """Errors of three equal gyros; omitted keys come from the preset."""

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
    misalignment_mrad: NonNegative | None = None
    """1 sigma of each gain from one axis to another, drawn per run"""
    markov_deg_h: NonNegative | None = None
    """1 sigma of the exponentially correlated drift; or give bias_instability_deg_h"""
    bias_instability_deg_h: NonNegative | None = None
    """in-run bias stability of the data sheet: the lowest point of the Allan deviation. Up to four exponentially
    correlated terms make flicker noise, which keeps it there from where white noise ends to 1.89 markov_time_s"""
    markov_time_s: CorrelationTime | None = None
    """correlation time of the exponentially correlated drift; with bias_instability_deg_h: default 100 s, which data
    sheets omit"""
    rate_random_walk_deg_h_sqrt_h: NonNegative | None = None
    """rate random walk: the root of the density of the drift's random walk, from 0 on"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        _one_of(self, "noise_deg_h", "arw_deg_sqrt_h", "noise")
        _one_of(self, "markov_deg_h", "bias_instability_deg_h", "correlated drift")
        return self

    def check(self, rate: float | None, *path: str) -> None:
        """Raise, about the section at `path`, for an incomplete correlated drift, or one that the white noise
        contradicts.

        rate: of the samples, Hz, if known.
        """
        _check_markov(self.markov_deg_h, self.markov_time_s, *path)
        _check_lowest(self, "bias_instability_deg_h", "arw_deg_sqrt_h", rate, DEG_H, *path)

    def density(self, rate: float | None) -> float:
        """White noise density, rad/sqrt(s); nan if it is given per sample and their rate (Hz) is unknown."""
        return _density(self.noise_deg_h, DEG_H, _si(self.arw_deg_sqrt_h, DEG_SQRT_H), rate)

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.sensors.imu import Triad

        triad = Triad(
            bias=_si(self.drift_deg_h, DEG_H),
            noise_density=self.density(rate),
            fixed_bias=_scaled(self.drift_fixed_deg_h, DEG_H),
            scale=_si(self.scale_ppm, PPM),
            markov=_si(self.markov_deg_h, DEG_H),
            markov_time=math.inf if self.markov_time_s is None else self.markov_time_s,
            further=self.further(),
        )
        return _with_flicker(triad, self.bias_instability_deg_h, DEG_H, self.markov_time_s, rate)

    def further(self) -> ImuErrorModel:
        """Further errors, in SI units."""
        from navsim.sensors.imu_errors import ImuErrorModel

        walk = _si(self.rate_random_walk_deg_h_sqrt_h, DEG_H) / 60.0
        return ImuErrorModel(walk=walk, misalignment=_si(self.misalignment_mrad, 1e-3))


class TrueGyro(Gyro):
    """True errors of three equal gyros; omitted keys come from the preset, or mean no error."""

    asymmetry_ppm: NonNegative | None = None
    """1 sigma of the difference of the scale factor from one sense of turning to the other, halved, drawn per run and
    axis"""
    nonlinearity_ppm_deg_s: NonNegative | None = None
    """1 sigma of the change of the scale factor with the rate, ppm a deg/s, drawn per run and axis"""
    g_sensitivity_deg_h_g: NonNegative | None = None
    """1 sigma of each of the nine gains from specific force, drawn per run"""
    ramp_deg_h_h: NonNegative | None = None
    """1 sigma of the slope of the drift, deg/h an hour, drawn per run and axis"""
    temperature_deg_h_k: NonNegative | None = None
    """1 sigma of the drift by a kelvin of imu.temperature, drawn per run and axis"""
    rectification_deg_h_g2: NonNegative | None = None
    """1 sigma of the drift by the mean square of imu.vibration, g2, drawn per run and axis"""
    sine_deg_h: NonNegative | None = None
    """amplitude of a sine in the rate, of random phase"""
    sine_hz: Frequency | None = None
    """frequency of the sine"""
    quantum_urad: NonNegative | None = None
    """quantum of the integral, the angle; the remainder goes into the next sample"""
    range_deg_s: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    """largest rate measured, as the mean over a sample"""
    bandwidth_hz: Frequency | None = None
    """frequency of -3 dB of a response of second order; none: unlimited"""
    damping: Damping | None = None
    """damping ratio of the response; default 0.7071"""

    @model_validator(mode="after")
    def _together(self) -> Self:
        _check_complete(self, "sine_deg_h")
        return self

    def further(self) -> ImuErrorModel:
        """Further errors, in SI units, without those of the mounting point."""
        hour = DEG_H / 3600.0
        return replace(
            super().further(),
            asymmetry=_si(self.asymmetry_ppm, PPM),
            nonlinearity=_si(self.nonlinearity_ppm_deg_s, PPM / DEG),
            g_sensitivity=_si(self.g_sensitivity_deg_h_g, DEG_H / G),
            ramp=_si(self.ramp_deg_h_h, hour),
            temperature=_si(self.temperature_deg_h_k, DEG_H),
            rectification=_si(self.rectification_deg_h_g2, DEG_H / G**2),
            quantum=_si(self.quantum_urad, 1e-6),
            largest=math.inf if self.range_deg_s is None else self.range_deg_s * DEG,
            bandwidth=math.inf if self.bandwidth_hz is None else self.bandwidth_hz,
            damping=USUAL_DAMPING if self.damping is None else self.damping,
            lines=_line(self.sine_deg_h, DEG_H, self.sine_hz),
        )


class Accelerometer(Section):
    """Errors of three equal accelerometers; omitted keys come from the preset."""

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
    misalignment_mrad: NonNegative | None = None
    """1 sigma of each gain from one axis to another, drawn per run"""
    markov_mg: NonNegative | None = None
    """1 sigma of the exponentially correlated bias; or give bias_instability_mg"""
    bias_instability_mg: NonNegative | None = None
    """in-run bias stability of the data sheet: the lowest point of the Allan deviation. Up to four exponentially
    correlated terms make flicker noise, which keeps it there from where white noise ends to 1.89 markov_time_s"""
    markov_time_s: CorrelationTime | None = None
    """correlation time of the exponentially correlated bias; with bias_instability_mg: default 100 s, which data sheets
    omit"""
    bias_random_walk_mg_sqrt_h: NonNegative | None = None
    """root of the density of the bias's random walk, from 0 on"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        _one_of(self, "noise_mg", "vrw_m_s_sqrt_h", "noise")
        _one_of(self, "markov_mg", "bias_instability_mg", "correlated bias")
        return self

    def check(self, rate: float | None, *path: str) -> None:
        """Raise, about the section at `path`, for an incomplete correlated bias, or one that the white noise
        contradicts.

        rate: of the samples, Hz, if known.
        """
        _check_markov(self.markov_mg, self.markov_time_s, *path)
        _check_lowest(self, "bias_instability_mg", "vrw_m_s_sqrt_h", rate, MG, *path)

    def density(self, rate: float | None) -> float:
        """White noise density, m/s/sqrt(s); nan if it is given per sample and their rate (Hz) is unknown."""
        return _density(self.noise_mg, MG, _si(self.vrw_m_s_sqrt_h, 1.0) / 60.0, rate)

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.sensors.imu import Triad

        triad = Triad(
            bias=_si(self.bias_mg, MG),
            noise_density=self.density(rate),
            fixed_bias=_scaled(self.bias_fixed_mg, MG),
            scale=_si(self.scale_ppm, PPM),
            markov=_si(self.markov_mg, MG),
            markov_time=math.inf if self.markov_time_s is None else self.markov_time_s,
            further=self.further(),
        )
        return _with_flicker(triad, self.bias_instability_mg, MG, self.markov_time_s, rate)

    def further(self) -> ImuErrorModel:
        """Further errors, in SI units."""
        from navsim.sensors.imu_errors import ImuErrorModel

        walk = _si(self.bias_random_walk_mg_sqrt_h, MG) / 60.0
        return ImuErrorModel(walk=walk, misalignment=_si(self.misalignment_mrad, 1e-3))


class TrueAccelerometer(Accelerometer):
    """True errors of three equal accelerometers; omitted keys come from the preset, or mean no error."""

    asymmetry_ppm: NonNegative | None = None
    """1 sigma of the difference of the scale factor from one sense to the other, halved, drawn per run and axis"""
    nonlinearity_ug_g2: NonNegative | None = None
    """1 sigma of the error by the square of the specific force, drawn per run and axis"""
    ramp_mg_h: NonNegative | None = None
    """1 sigma of the slope of the bias, mg an hour, drawn per run and axis"""
    temperature_mg_k: NonNegative | None = None
    """1 sigma of the bias by a kelvin of imu.temperature, drawn per run and axis"""
    rectification_ug_g2: NonNegative | None = None
    """1 sigma of the bias by the mean square of imu.vibration, g2, drawn per run and axis"""
    sine_mg: NonNegative | None = None
    """amplitude of a sine in the specific force, of random phase"""
    sine_hz: Frequency | None = None
    """frequency of the sine"""
    quantum_mm_s: NonNegative | None = None
    """quantum of the integral, the velocity; the remainder goes into the next sample"""
    range_g: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    """largest specific force measured, as the mean over a sample"""
    bandwidth_hz: Frequency | None = None
    """frequency of -3 dB of a response of second order; none: unlimited"""
    damping: Damping | None = None
    """damping ratio of the response; default 0.7071"""

    @model_validator(mode="after")
    def _together(self) -> Self:
        _check_complete(self, "sine_mg")
        return self

    def further(self) -> ImuErrorModel:
        """Further errors, in SI units, without those of the mounting point."""
        return replace(
            super().further(),
            asymmetry=_si(self.asymmetry_ppm, PPM),
            nonlinearity=_si(self.nonlinearity_ug_g2, 1e-6 / G),
            ramp=_si(self.ramp_mg_h, MG / 3600.0),
            temperature=_si(self.temperature_mg_k, MG),
            rectification=_si(self.rectification_ug_g2, 1e-6 / G),
            quantum=_si(self.quantum_mm_s, 1e-3),
            largest=math.inf if self.range_g is None else self.range_g * G,
            bandwidth=math.inf if self.bandwidth_hz is None else self.bandwidth_hz,
            damping=USUAL_DAMPING if self.damping is None else self.damping,
            lines=_line(self.sine_mg, MG, self.sine_hz),
        )


class VibrationLine(Section):
    """One frequency of a vibration."""

    amplitude_g: Annotated[float, Field(ge=0.0, le=1e3)]
    """amplitude along each axis; the phase of each is drawn per run"""
    frequency_hz: Frequency
    """frequency; above half of imu.rate_hz it is seen at another (aliasing)"""


class VibrationSection(Section):
    """Vibration at the inertial sensors, the same along each axis. It is in their measurements, not in the path."""

    lines: Annotated[ListOf[VibrationLine], Field(max_length=20)] = ()
    """single frequencies"""
    psd: Annotated[ListOf[PairOf[Annotated[float, Field(ge=1e-9, le=1e5)]]], Field(max_length=50)] = ()
    """random part: pairs of a frequency, Hz, and a one-sided power spectral density, g2/Hz, straight in logarithms
    between them, nothing beyond"""

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if len(self.psd) == 1:
            raise reject("needs two points or more", "psd")
        for i, (before, after) in enumerate(itertools.pairwise(self.psd)):
            if after[0] < 1.001 * before[0]:
                raise reject(f"frequencies must increase: {after[0]:g} Hz comes after {before[0]:g} Hz", "psd", i + 1)
        return self

    def model(self) -> Vibration:
        """In SI units."""
        from navsim.sensors.imu_errors import Vibration

        lines = tuple((line.amplitude_g * G, line.frequency_hz) for line in self.lines)
        return Vibration(lines, tuple((f, s * G**2) for f, s in self.psd))


class TemperatureSection(Section):
    """Rise of the inertial sensors' temperature after the start."""

    ramp_k_min: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """kelvin a minute"""
    warm_up_k: Annotated[float, Field(ge=-200.0, le=200.0)] = 0.0
    """by how much they warm up in the end, in addition to the ramp"""
    warm_up_time_s: CorrelationTime = 300.0
    """time constant of warming up"""

    def model(self) -> Warming:
        """In SI units."""
        from navsim.sensors.imu_errors import Warming

        return Warming(self.ramp_k_min / 60.0, self.warm_up_k, self.warm_up_time_s)


def _one_of(section: Section, first: str, second: str, what: str) -> None:
    if getattr(section, first) is not None and getattr(section, second) is not None:
        raise reject(f"{first} and {second} are two spellings of one {what}; give one", second)


def _check_markov(size: float | None, time: float | None, *path: str) -> None:
    if size and time is None:
        raise reject("an exponentially correlated error needs its correlation time", *path, "markov_time_s")


def _check_lowest(
    sensor: Gyro | Accelerometer, key: str, noise: str, rate: float | None, unit: float, *path: str
) -> None:
    from navsim.sensors.imu import MARKOV_PEAK, markov_of_lowest

    lowest, time = getattr(sensor, key), sensor.markov_time_s or USUAL_TIME
    density = sensor.density(rate)
    if lowest and math.isnan(density):
        raise reject(f"it needs white noise too: give {noise}", *path, key)
    if lowest and math.isnan(markov_of_lowest(lowest * unit, density, time)):
        alone = density / math.sqrt(MARKOV_PEAK[0] * time) / unit
        longer = (density / (lowest * unit)) ** 2 / MARKOV_PEAK[0]
        raise reject(
            f"the white noise alone has an Allan deviation of {digits(alone)} after 1.89 correlation times of "
            f"{time:g} s: {lowest:g} is reached later; give a markov_time_s above {digits(longer)} s, or less "
            "noise", *path, key,
        )  # fmt: skip


def _density(per_sample: float | None, unit: float, density: float, rate: float | None) -> float:
    from navsim.sensors.imu import density_from_sample_sigma

    if per_sample is None:
        return density
    if rate is None:
        return math.nan if per_sample else 0.0
    return density_from_sample_sigma(per_sample * unit, rate)


def _with_flicker(triad: Triad, lowest: float | None, unit: float, time: float | None, rate: float) -> Triad:
    """A triad with flicker noise of a bias instability for samples of a rate, Hz; unchanged without one."""
    from navsim.sensors.imu import flicker_of_lowest

    if not lowest:
        return triad
    terms = flicker_of_lowest(lowest * unit, triad.noise_density, time or USUAL_TIME, 1.0 / rate)
    (sigma, slowest), *others = terms
    further = replace(triad.further, flicker=tuple(others))
    return replace(triad, markov=sigma, markov_time=slowest, further=further)


def _check_complete(sensor: TrueGyro | TrueAccelerometer, sine: str) -> None:
    if (getattr(sensor, sine) is None) != (sensor.sine_hz is None):
        raise reject("a sine needs its amplitude and its frequency", "sine_hz" if sensor.sine_hz is None else sine)
    if sensor.damping is not None and sensor.bandwidth_hz is None:
        raise reject("is for sensors with a bandwidth_hz", "damping")


def _line(amplitude: float | None, unit: float, frequency: float | None) -> tuple[tuple[float, float], ...]:
    return () if not amplitude or frequency is None else ((amplitude * unit, frequency),)


def _si(value: float | None, unit: float) -> float:
    """A size of errors in SI units; an error that neither scenario nor preset names is none."""
    return 0.0 if value is None else value * unit


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


_SPELLINGS = (
    ("noise_deg_h", "arw_deg_sqrt_h"), ("noise_mg", "vrw_m_s_sqrt_h"),
    ("markov_deg_h", "bias_instability_deg_h"), ("markov_mg", "bias_instability_mg"),
)  # fmt: skip
"""Alternative keys of a sensor."""


def filled(values: dict[str, float], given: dict[str, Any]) -> dict[str, Any]:
    """Given keys of a sensor, completed with values; a given key displaces its alternatives."""
    spoken_for = {key for pair in _SPELLINGS if set(pair) & given.keys() for key in pair}
    return {key: value for key, value in values.items() if key not in spoken_for} | given


def assumed_sensor(truth: Gyro | Accelerometer, given: Gyro | Accelerometer) -> Gyro | Accelerometer:
    """The true sensor with the filter's own values put in; one spelling of the noise displaces the other."""
    values = given.model_dump(exclude_none=True)
    for pair in _SPELLINGS:
        if values.keys() & set(pair):
            values = {p: None for p in pair if hasattr(truth, p)} | values
    return truth.model_copy(update=values)


def lone_correlation_times(prefix: str, gyro: Gyro, accelerometer: Accelerometer) -> list[str]:
    """Correlation times of Markov noise that a sensor doesn't have, as messages."""
    drawn = (
        ("gyro", gyro, ("markov_deg_h", "bias_instability_deg_h")),
        ("accelerometer", accelerometer, ("markov_mg", "bias_instability_mg")),
    )
    return [
        f"{prefix}.{name}.markov_time_s changes nothing: give {prefix}.{name}.{keys[0]} or {keys[1]}"
        for name, sensor, keys in drawn
        if sensor.markov_time_s is not None and not any(getattr(sensor, key) for key in keys)
    ]


ImuPreset = Literal[
    "paper", "perfect", "none", "hg9900", "hg1700", "stim300", "adis16495-1", "adis16488", "adis16505-1", "adis16470",
    "mti-1", "icm-42688-p",
]  # fmt: skip
NEEDED = {
    "gyro": (("drift_deg_h", "drift_fixed_deg_h"), ("arw_deg_sqrt_h", "noise_deg_h"),
             ("bias_instability_deg_h", "markov_deg_h")),
    "accelerometer": (("bias_mg", "bias_fixed_mg"), ("vrw_m_s_sqrt_h", "noise_mg"),
                      ("bias_instability_mg", "markov_mg")),
}  # fmt: skip
"""Required properties of a sensor, each by its alternative keys; the last is required only of a data sheet."""


class _Sensors(Section):
    preset: ImuPreset = "paper"
    """paper: 700 deg/h and 30 deg/h per sample, 1e-3 g and 1e-2 g per sample. `perfect`: no errors. `none`: only the
    errors under gyro and accelerometer, which must give constant errors and white noise, even if 0. All others: the
    values of the sensor's data sheet; you must give those that it lacks. Omitted: none if gyro or accelerometer has
    keys, else paper"""
    gyro: TrueGyro = TrueGyro()
    """errors of the gyros, in place of the preset's"""
    accelerometer: TrueAccelerometer = TrueAccelerometer()
    """errors of the accelerometers, in place of the preset's"""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if not isinstance(data, dict):
            return data
        sections = [data.get(sensor) for sensor in NEEDED]
        own = any(value is not None for part in sections if isinstance(part, dict) for value in part.values())
        preset = str(data.get("preset", "none" if own else "paper"))  # any value is possible, also a list
        if preset == "none":
            return {"preset": "none", **data}
        if preset not in IMU_PRESETS:
            return data
        out = dict(data)
        for sensor, values in IMU_PRESETS[preset].items():
            given = data.get(sensor, {})
            if isinstance(given, dict):
                out[sensor] = filled(values, given)
        return out

    @model_validator(mode="after")
    def _check_complete(self) -> Self:
        sheet = self.preset in IMU_SHEETS
        missing = [
            (sensor, keys)
            for sensor, needed in NEEDED.items()
            for keys in (needed if sheet else needed[:2])
            if all(getattr(getattr(self, sensor), key) is None for key in keys)
        ]
        if missing:
            (sensor, (key, other)), *others = missing
            taken = [one for one in (key, other) if one in IMU_PRESETS.get(self.preset, {}).get(sensor, {})]
            if taken:
                other = other if taken[0] == key else key
                text = f"removes a value of preset {self.preset}; give it or {other}, 0 or more, 0 for none"
                raise reject(text, sensor, taken[0])
            also = "".join(f", imu.{name}.{keys[0]} (or {keys[1]})" for name, keys in others)
            whose = f"is not printed in the data sheet of {self.preset}" if sheet else "is needed"
            rest = "" if sheet else "; `imu.preset: paper` fills omitted keys from the paper, perfect sets them to 0"
            raise reject(
                f"{whose}: give it or {other}, 0 or more, 0 for none"
                f"{also and '; missing as well: ' + also[2:]}{rest}", sensor, key,
            )  # fmt: skip
        return self


_PUSHED = ("drift_", "bias_mg", "bias_fixed", "noise_", "arw_", "vrw_", "scale_", "markov_", "bias_instability")
_ANALYSED = (*_PUSHED, "misalignment_", "g_sensitivity_", "range_")
"""Prefixes of the error keys that importance sampling and the covariance analysis include; the analysis checks the
range."""


class Imu(_Sensors):
    """The inertial sensors as they really are."""

    from_: str | None = Field(default=None, alias="from", exclude=True)
    """result of `navsim replay` with the sensors, instead of a preset: white noise of its standstill, else of its
    sensor class; bias as estimated; in-run errors of the class. The stored scenario has the numbers"""
    rate_hz: Annotated[float, Field(ge=10.0, le=2000.0)] = 100.0
    """samples of the inertial sensors a second"""
    vibration: VibrationSection | None = None
    """vibration at the sensors"""
    temperature: TemperatureSection | None = None
    """how much warmer they become"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        for name in ("gyro", "accelerometer"):
            sensor = getattr(self, name)
            sensor.check(self.rate_hz, name)
            for part, section in (("temperature", self.temperature), ("rectification", self.vibration)):
                key = next((key for key in type(sensor).model_fields if key.startswith(part)), "")
                if getattr(sensor, key) and section is None:
                    needed = "temperature" if part == "temperature" else "vibration"
                    raise reject(f"is by imu.{needed}, and there is none: give that", name, key)
        return self

    def monte_carlo_only(self, rare: bool) -> tuple[str, ...] | None:
        """The first key of an error that the covariance analysis does not know, or, rare, that pushed runs do not; None
        of none."""
        for name in ("gyro", "accelerometer"):
            sensor, known = getattr(self, name), _PUSHED if rare else _ANALYSED
            for key in type(sensor).model_fields:
                if getattr(sensor, key) and not key.startswith(known):
                    return name, key
        given = (name for name in ("vibration", "temperature") if getattr(self, name) is not None)
        return next(((name,) for name in given), None)

    def unused(self) -> list[str]:
        """Keys without effect, as messages."""
        return lone_correlation_times("imu", self.gyro, self.accelerometer)

    def warms(self) -> bool:
        """Whether a sensor has errors that go with its temperature."""
        given = (sensor.model_dump(exclude_none=True).items() for sensor in (self.gyro, self.accelerometer))
        return any(key.startswith("temperature") and value for pairs in given for key, value in pairs)

    def limited(self) -> bool:
        """Whether a sensor has a range."""
        return self.gyro.range_deg_s is not None or self.accelerometer.range_g is not None

    def triads(self, gyro: Gyro | None = None, accelerometer: Accelerometer | None = None) -> tuple[Triad, Triad]:
        """True error models of gyros and accelerometers in SI units, or with the values of the filter model."""
        from navsim.sensors.imu_errors import Vibration, Warming

        vibration = Vibration() if self.vibration is None else self.vibration.model()
        warming = Warming() if self.temperature is None else self.temperature.model()
        of_gyro, of_accel = (
            (true if given is None else assumed_sensor(true, given)).triad(self.rate_hz)
            for true, given in ((self.gyro, gyro), (self.accelerometer, accelerometer))
        )
        mine, its = (replace(t.further, vibration=vibration, warming=warming) for t in (of_gyro, of_accel))
        its = replace(its, shaken=vibration.white_density())
        return replace(of_gyro, further=mine), replace(of_accel, further=its)
