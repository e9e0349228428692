"""Sensors that aid the filter: sections `altimeter`, `radio_altimeter`, `barometric_altimeter`, `magnetometer`.

The sections of the same names in `filter` are the filter's models of them.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.terrain import terrain_of
from navsim.scenario_files.base import (
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
from navsim.scenario_files.presets import MAGNETOMETER_PRESETS

if TYPE_CHECKING:
    import numpy as np

    from navsim.scenario.landing import Landing
    from navsim.sensors.aiding import AidingSensor
    from navsim.sensors.altimeter import Altimeter, Ground, RadioAltimeter
    from navsim.sensors.barometer import BarometricAltimeter
    from navsim.sensors.magnetometer import Magnetometer


class FilterAidingSection(Section):
    """Filter model of a sensor beside the receiver, in the section of its name."""

    # example of the sensor's own section, for a message
    needs: ClassVar[str]


class AidingSection(Section):
    """A sensor beside the receiver. The filter's model of it, if it has one, is the section of the same name in
    `filter`."""

    rate_hz: float
    """measurements a second"""

    def model(self, landing: Landing) -> AidingSensor:
        """The sensor of a landing in SI units, and its filter model."""
        raise NotImplementedError

    def check(self, landing: Landing) -> None:
        """Raise where it does not fit the landing."""

    def error_without_state(self, landing: Landing) -> str | None:
        """Key of a time-correlated error that the filter of a landing has no state for; None without."""
        return None

    def names(self) -> tuple[str, ...]:
        """Names of its transmitters on the ground."""
        return ()


class AltimeterSection(AidingSection):
    """An altimeter for the height of the IMU above the ellipsoid."""

    rate_hz: Annotated[float, Field(ge=0.1, le=100.0)] = 10.0
    """heights a second"""
    sigma_m: Sigma = 1.0
    """1 sigma of its white noise"""
    offset_m: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """how much too high it reads; the filter does not know it"""
    believed_sigma_m: Sigma | None = None
    """1 sigma of the noise in the filter model; default: sigma_m"""

    def model(self, landing: Landing) -> Altimeter:
        """The sensor in SI units."""
        from navsim.sensors.altimeter import Altimeter

        assumed = self.sigma_m if self.believed_sigma_m is None else self.believed_sigma_m
        return Altimeter(self.rate_hz, self.offset_m, self.sigma_m, assumed)


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


class RadioAltimeterSection(AidingSection):
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
    ground_from: Literal["profile", "terrain"] = "profile"
    """terrain: the ground under the antenna by the files of heights under `terrain`, and in the filter model that under
    the centre line, unless filter.radio_altimeter.ground gives another"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if self.lowest_m >= self.highest_m:
            raise reject(f"must be below highest_m, {self.highest_m:g} m", "lowest_m")
        check_profile(self.ground, "ground")
        if self.ground and self.ground_from == "terrain":
            raise reject("is for `ground_from: profile`; give one of both", "ground")
        return self

    def check(self, landing: Landing) -> None:
        """Raise for ground of files that there are not."""
        super().check(landing)
        if self.ground_from == "terrain" and not any(each.file for each in landing.terrain):
            raise reject("there is no `file` of heights under `terrain`", "radio_altimeter", "ground_from")

    def model(self, landing: Landing) -> RadioAltimeter:
        """The sensor in SI units on a runway, and its filter model."""
        import numpy as np

        from navsim.sensors.altimeter import RadioAltimeter, RadioAltimeterDesign

        runway, given, by_terrain = landing.runway, landing.filter.radio_altimeter, self.ground_from == "terrain"
        ground = profile_of(self.ground or runway.surface)
        assumed = RadioAltimeterDesign(
            self.sigma_floor_m if given.sigma_floor_m is None else given.sigma_floor_m,
            self.sigma_share if given.sigma_share is None else given.sigma_share,
            profile_of(given.ground) if given.ground is not None else None if by_terrain else ground,
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
            design=assumed,
            terrain=functools.partial(terrain_of, landing.terrain) if by_terrain else None,
        )


class FilterRadioAltimeter(FilterAidingSection):
    """Filter model of the radio altimeter; omitted keys are as in `radio_altimeter`."""

    needs = "radio_altimeter: {sigma_floor_m: ...}"

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


class BarometricAltimeterSection(AidingSection):
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

    def correlated(self, given: FilterBarometricAltimeter) -> tuple[float, float, float]:
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

    def check(self, landing: Landing) -> None:
        """Raise without the height of the geoid, and for states of errors that there are not."""
        its, name = landing.filter.barometric_altimeter, "barometric_altimeter"
        if landing.runway.geoid_undulation_m is None:
            text = "heights by pressure are above sea level: give the height of the geoid above the ellipsoid"
            raise reject(text, "runway", "geoid_undulation_m")
        if its.errors == "states":
            setting, drift, _ = self.correlated(its)
            if setting == drift == 0.0:
                text = "there are none: give barometric_altimeter.qnh_sigma_hpa or drift_m, or those of the filter"
                raise reject(text, "filter", name, "errors")
            if its.drift_time_s is not None and its.drift_m is None and "drift_m" not in self.model_fields_set:
                text = "there is no drift: give barometric_altimeter.drift_m, or that of the filter"
                raise reject(text, "filter", name, "drift_time_s")
            return
        for key in ("qnh_sigma_hpa", "drift_m", "drift_time_s"):
            if getattr(its, key) is not None:
                raise reject("is for `errors: states`", "filter", name, key)

    def error_without_state(self, landing: Landing) -> str | None:
        """Key of the setting's error or of the drift, without states for them."""
        if landing.filter.barometric_altimeter.errors == "states":
            return None
        return next((key for key in ("qnh_sigma_hpa", "drift_m") if getattr(self, key)), None)

    def model(self, landing: Landing) -> BarometricAltimeter:
        """The sensor in SI units at a runway, and its filter model."""
        from navsim.sensors.barometer import SLOPE, AirColumn, BarometricAltimeter, PressureDesign

        runway, given = landing.runway, landing.filter.barometric_altimeter
        warmer = self.isa_deviation_k if given.isa_deviation_k is None else given.isa_deviation_k
        setting, drift, drift_time = self.correlated(given)
        assumed = PressureDesign(
            self.sigma_m if given.sigma_m is None else given.sigma_m,
            self.lag_s if given.lag_s is None else given.lag_s,
            AirColumn(runway.elevation_m, warmer),
            runway.undulation_m if given.geoid_undulation_m is None else given.geoid_undulation_m,
            *((SLOPE * setting, drift, drift_time) if given.errors == "states" else ()),
        )
        air = AirColumn(runway.elevation_m, self.isa_deviation_k)
        return BarometricAltimeter(
            self.rate_hz, self.sigma_m, self.lag_s, air, runway.undulation_m, self.qnh_error_hpa, assumed,
            self.qnh_sigma_hpa, self.drift_m, self.drift_time_s,
        )  # fmt: skip


class FilterBarometricAltimeter(FilterAidingSection):
    """Filter model of the barometric altimeter; omitted keys are as in `barometric_altimeter`."""

    needs = "barometric_altimeter: {sigma_m: ...}"

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


Percent = Annotated[float, Field(ge=0.0, le=50.0)]
Mrad = Annotated[float, Field(ge=0.0, le=500.0)]
MicroTesla = Annotated[float, Field(ge=0.0, le=1000.0)]


class MagnetometerSection(AidingSection):
    """A magnetometer: the magnetic field along three axes. Its errors are constant in each run and drawn for each axis,
    but for noise and disturbance."""

    preset: Literal["none", "bmm150", "hmc5983"] = "none"
    """noise, and rate, of a data sheet; none: the keys here"""
    rate_hz: Annotated[float, Field(ge=0.1, le=1000.0)] = 10.0
    """measurements a second"""
    noise_ut: Annotated[float, Field(ge=1e-6, le=1000.0)]
    """1 sigma of the white noise of each axis"""
    hard_iron_ut: MicroTesla
    """1 sigma of the offset of each axis, by magnetised parts of the aircraft, that calibration left"""
    scale_percent: Percent = 0.0
    """soft iron: 1 sigma of the scale factor of each axis"""
    misalignment_mrad: Mrad = 0.0
    """soft iron: 1 sigma of the sensitivity of each axis to the field along each other one"""
    mounting_deg: Triple = (0.0, 0.0, 0.0)
    """roll, pitch, yaw of the axes of the sensor against those of the aircraft"""
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    """declination of the field, east positive; left out with dip_deg and intensity_ut: by the World Magnetic Model at
    the runway and the epoch, which needs the extra `magnetic`"""
    dip_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    """dip (inclination) of the field, down positive"""
    intensity_ut: Annotated[float, Field(ge=1.0, le=100.0)] | None = None
    """total intensity of the field"""
    field_error_ut: MicroTesla = 0.14
    """1 sigma of the error of the field model along north, east and down each; 0.14: the World Magnetic Model's own
    figure"""
    disturbance_ut: MicroTesla = 0.0
    """1 sigma of the field of steel in the runway, vehicles and buildings, along north, east and down each, at the
    ground"""
    disturbance_height_m: Annotated[float, Field(ge=0.1, le=1e4)] = 10.0
    """height above the runway in which the disturbance falls to 1 / e"""
    disturbance_time_s: CorrelationTime = 2.0
    """correlation time of the disturbance as the aircraft passes"""
    latency_s: Late = 0.0
    """time from a measurement to its arrival"""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if isinstance(data, dict):
            return {**MAGNETOMETER_PRESETS.get(str(data.get("preset")), {}), **data}
        return data

    @model_validator(mode="after")
    def _check_field(self) -> Self:
        parts = {key: getattr(self, key) for key in ("declination_deg", "dip_deg", "intensity_ut")}
        missing = [key for key, value in parts.items() if value is None]
        if 0 < len(missing) < len(parts):
            raise reject("the field is given by declination_deg, dip_deg and intensity_ut together", missing[0])
        return self

    def check(self, landing: Landing) -> None:
        """Raise without a model of the field, and for keys of states that there are not."""
        self.field_ned(landing)
        its = landing.filter.magnetometer
        for key in () if its.errors == "states" else ERRORS_OF_MAGNETOMETER:
            if getattr(its, key) is not None:
                raise reject("is for `errors: states`", "filter", "magnetometer", key)

    def error_without_state(self, landing: Landing) -> str | None:
        """Key of an error, if the filter does not estimate them."""
        if landing.filter.magnetometer.errors == "states":
            return None
        return next((key for key in ERRORS_OF_MAGNETOMETER if getattr(self, key)), None)

    def field_ned(self, landing: Landing) -> np.ndarray:
        """Field of the Earth at the runway of a landing (3,), NED, uT. Raises without a model of it."""
        import numpy as np

        from navsim.geodesy.magnetic import NoMagneticModel, field_ned

        if self.declination_deg is not None and self.dip_deg is not None and self.intensity_ut is not None:
            d, i = self.declination_deg * DEG, self.dip_deg * DEG
            level = math.cos(i)
            return self.intensity_ut * np.array([level * math.cos(d), level * math.sin(d), math.sin(i)])
        place = landing.runway.threshold or landing.approach.start
        assert place is not None
        year = landing.epoch.year + (landing.epoch.timetuple().tm_yday - 1) / 365.25
        try:
            return field_ned(place.lat_deg, place.lon_deg, landing.runway.ellipsoidal_m, year)
        except NoMagneticModel as error:
            text = f"{error}: declination_deg, dip_deg and intensity_ut"
            raise reject(text, "magnetometer", "declination_deg") from None

    def model(self, landing: Landing) -> Magnetometer:
        """The sensor at a runway, and its filter model."""
        import numpy as np

        from navsim.geodesy.attitude import dcm_from_rpy
        from navsim.sensors.magnetometer import MagneticDesign, MagneticErrors, Magnetometer

        its, field = landing.filter.magnetometer, self.field_ned(landing)
        given = {key: value for key, value in its if value is not None and key in MagnetometerSection.model_fields}
        other = self.model_copy(update=given)

        def errors(section: MagnetometerSection) -> MagneticErrors:
            return MagneticErrors(
                section.hard_iron_ut, section.field_error_ut, 0.01 * section.scale_percent,
                1e-3 * section.misalignment_mrad, section.disturbance_ut, section.disturbance_time_s,
            )  # fmt: skip

        def mounting(section: MagnetometerSection) -> np.ndarray:
            return np.asarray(dcm_from_rpy(np.array(section.mounting_deg) * DEG).T)

        off = its.declination_error_deg * DEG
        turned = np.array([[math.cos(off), -math.sin(off), 0.0], [math.sin(off), math.cos(off), 0.0], [0.0, 0.0, 1.0]])
        followed = errors(other) if its.errors == "states" else MagneticErrors(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        assumed = MagneticDesign(
            other.noise_ut, mounting(other), other.latency_s, turned @ field, other.disturbance_height_m, followed
        )
        return Magnetometer(
            self.rate_hz, self.latency_s, self.noise_ut, mounting(self), field, landing.runway.ellipsoidal_m,
            self.disturbance_height_m, errors(self), assumed,
        )  # fmt: skip


ERRORS_OF_MAGNETOMETER = ("hard_iron_ut", "scale_percent", "misalignment_mrad", "field_error_ut", "disturbance_ut")
"""Keys of the errors that a filter may estimate."""


class FilterMagnetometer(FilterAidingSection):
    """Filter model of the magnetometer; omitted keys are as in `magnetometer`."""

    needs = "magnetometer: {noise_ut: ..., hard_iron_ut: ...}"
    errors: Literal["states", "none"] = "states"
    """what the filter does about hard and soft iron, the error of the field model and the disturbance: states: estimate
    those that it assumes, three states each, nine for soft iron; none: nothing"""
    noise_ut: Annotated[float, Field(ge=1e-6, le=1000.0)] | None = None
    """1 sigma of the noise in the filter model"""
    hard_iron_ut: MicroTesla | None = None
    """1 sigma of the hard iron in the filter model"""
    scale_percent: Percent | None = None
    """1 sigma of the scale factors in the filter model"""
    misalignment_mrad: Mrad | None = None
    """1 sigma of the misalignments in the filter model"""
    mounting_deg: Triple | None = None
    """roll, pitch, yaw of the sensor in the filter model"""
    field_error_ut: MicroTesla | None = None
    """1 sigma of the error of the field model in the filter model"""
    disturbance_ut: MicroTesla | None = None
    """1 sigma of the disturbance at the ground in the filter model"""
    latency_s: Late | None = None
    """latency in the filter model"""
    declination_error_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0
    """error of the declination in the filter model, east positive"""
