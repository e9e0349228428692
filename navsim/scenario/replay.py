"""`kind: replay`: a recorded flight, IMU and GNSS, through the filter."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from navsim.scenario.base import (
    Checksum,
    NonNegative,
    Pair,
    Positive,
    Section,
    Triple,
    Utc,
    list_of,
    one_or_list,
    one_or_more,
    reject,
)  # fmt: skip
from navsim.scenario.filter import Gate
from navsim.scenario.presets import SENSOR_CLASSES
from navsim.scenario.sensors import Accelerometer, Gyro

Times = Annotated[
    tuple[NonNegative, ...],
    BeforeValidator(one_or_more),
    PlainSerializer(one_or_list),
]


class Sensors(Section):
    """The inertial samples, and what kind of sensors made them."""

    file: str
    """table with t_s, gx_rad_s, gy_rad_s, gz_rad_s, ax_m_s2, ay_m_s2, az_m_s2, body axes forward-right-down;
    .gz, .bz2, .zip too"""
    file_sha256: Checksum | None = None
    """its checksum; when given, another file is refused"""
    sensor_class: Literal["consumer", "industrial", "tactical"] = "consumer"
    """turn-on and in-run biases, and where the tuning of the noise starts"""
    gyro: Gyro = Gyro()
    """values that differ from the class's"""
    accelerometer: Accelerometer = Accelerometer()
    """values that differ from the class's"""
    samples: Literal["instantaneous", "averaged"] = "instantaneous"
    """what a sample is: the value at its time, or the mean since the sample before"""
    longest_gap_s: Positive | None = None
    """samples farther apart are a gap; default: five sample intervals"""

    @model_validator(mode="after")
    def _white_noise_as_density(self) -> Self:
        if self.gyro.noise_deg_h is not None:
            raise reject("recorded rates differ, so give the density, arw_deg_sqrt_h", "gyro", "noise_deg_h")
        if self.accelerometer.noise_mg is not None:
            raise reject("recorded rates differ, so give the density, vrw_m_s_sqrt_h", "accelerometer", "noise_mg")
        return self

    def resolved(self) -> tuple[Gyro, Accelerometer]:
        """The sensors with the class's values where none are given."""
        of_class = SENSOR_CLASSES[self.sensor_class]
        gyro = of_class["gyro"] | self.gyro.model_dump(exclude_none=True)
        accel = of_class["accelerometer"] | self.accelerometer.model_dump(exclude_none=True)
        return Gyro.model_validate(gyro), Accelerometer.model_validate(accel)


class Gnss(Section):
    """The fixes. What is left out is tuned (`tuning: likelihood`), or as written below without tuning."""

    file: str
    """table with t_s, lat_deg, lon_deg, h_m, vn_m_s, ve_m_s, vd_m_s (velocities may be empty), or NMEA sentences,
    also with a logger's text around them"""
    file_sha256: Checksum | None = None
    """its checksum; when given, another file is refused"""
    latency_s: Annotated[float, Field(ge=0.0, le=2.0)] | None = None
    """from the time a fix is valid to its time in the file; untuned 0"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """IMU to antenna: forward, right, down"""
    velocity_sigma_m_s: Pair | None = None
    """1 sigma: horizontal per axis, vertical; untuned 0.3 and 0.3"""
    position_sigma_m: Pair | None = None
    """1 sigma: horizontal per axis, vertical; default 2.5 s times the velocity's: receivers smooth positions with it"""
    spacing_s: NonNegative = 0.45
    """fixes closer than this to the last one used are left out: their errors are nearly the same"""
    min_satellites: Annotated[int, Field(ge=0)] = 4
    """fixes from fewer (column nsat) are left out"""

    @model_validator(mode="after")
    def _positive(self) -> Self:
        for key in ("velocity_sigma_m_s", "position_sigma_m"):
            pair = getattr(self, key)
            if pair is not None and min(pair) <= 0.0:
                raise reject("standard deviations are positive", key)
        return self


class Alignment(Section):
    """How the attitude is found: level at rest, heading from the changes of velocity once it moves."""

    heading_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    """heading at the start, where it is known; needs a standstill"""
    heading_sigma_deg: Annotated[float, Field(gt=0.0, le=30.0)] = 10.0
    """the heading must be good to this, 1 sigma; with heading_deg: how good it is"""
    longest_s: Annotated[float, Field(ge=5.0, le=600.0)] = 120.0
    """give up an attempt after this time and try later"""


class Filter(Section):
    """The filter."""

    kind: Literal["tfg", "eskf", "left-invariant", "rts", "map"] = "tfg"
    """as in landings; rts and map are smoothers"""
    gate: Gate = Gate(probability=0.0)
    output_rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 10.0


class Outage(Section):
    """Fixes withheld on purpose: one outage for every start and every duration, each flown by itself."""

    start_s: Times
    duration_s: Times
    withhold: bool = False
    """withhold these fixes from the flight itself too"""


class Replay(Section):
    """A recorded flight through the filter."""

    kind: Literal["replay"]
    version: Literal[1]
    title: str = ""
    epoch: Utc = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    """UTC of t_s = 0"""
    imu: Sensors
    gnss: Gnss
    lenient: bool = False
    """take what is whole of damaged files, and warn of what was left out"""
    start_s: float | None = None
    """look for the alignment from here on; default: the first fix"""
    end_s: float | None = None
    alignment: Alignment = Alignment()
    tuning: Literal["likelihood", "none"] = "likelihood"
    """likelihood: noise of fixes and sensors, and latency, as make the innovations of the moving flight most likely"""
    filter: Filter = Filter()
    outages: list_of(Outage) = ()  # type: ignore[valid-type]

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise reject("must come after start_s", "end_s")
        return self
