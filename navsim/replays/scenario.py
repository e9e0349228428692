"""`kind: replay`: a recorded flight, IMU and GNSS, through the filter."""

# types of units, axes and columns are made from the tables of `conventions`, which mypy cannot follow
# mypy: disable-error-code="valid-type"

from __future__ import annotations

import datetime
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from navsim.formats import conventions
from navsim.formats.conventions import GnssConvention, ImuConvention
from navsim.gnss.constellations.systems import SYSTEMS, USUAL, System
from navsim.ranging.scenario import ClocksSection, Growth, RangesSection, SourceTable
from navsim.scenario.filter import Components, Coupling, Kind
from navsim.scenario.imu import Accelerometer, Gyro, filled
from navsim.scenario.signals import ClockNoise
from navsim.scenario.sky import Checksums, Files, Name
from navsim.scenario.transmitters import ClockModel
from navsim.scenario_files.base import (
    Checksum,
    CorrelationTime,
    DistinctListOf,
    Latitude,
    ListOf,
    LogTime,
    Longitude,
    NonNegative,
    PairOf,
    RecordedLatency,
    Section,
    Sigma,
    SourceName,
    Triple,
    TripleOf,
    Utc,
    Version,
    hint,
    one_or_list,
    one_or_more,
    reject,
)  # fmt: skip
from navsim.scenario_files.presets import SENSOR_CLASSES

Time = Annotated[float, Field(ge=0.0, le=1e12)]
Times = Annotated[tuple[Time, ...], one_or_more(Time), one_or_list]


def _unit(units: dict[str, float]) -> Any:
    """The type of one of these units."""
    return Literal[tuple(units)]


def _axes(axes: tuple[str, str, str]) -> Any:
    """The type of three letters, one for each axis in any order and direction."""

    def known(value: str) -> str:
        if value not in conventions.all_axes(axes):
            ways = " or ".join("/".join(pair) for pair in axes)
            raise ValueError(f"expected three letters, where the columns x, y, z point: each of {ways} once")
        return value

    return Annotated[str, AfterValidator(known)]


BodyAxes, LevelAxes = _axes(conventions.BODY_AXES), _axes(conventions.LEVEL_AXES)


def _columns(names: tuple[str, ...]) -> Any:
    """The type of a mapping from our names of columns to those of the file."""

    def known(value: dict[str, str]) -> dict[str, str]:
        for name in value:
            if name not in names:
                raise ValueError(f"{name!r} is not a column; {hint(name, list(names))}")
        return value

    return Annotated[dict[str, str], AfterValidator(known)]


_Refused = Annotated[SkipJsonSchema[NonNegative | None], Field(exclude=True)]


class RecordedGyro(Gyro):
    """Errors of recorded gyros; lists of keys, schemas and resolved logs leave out those that `Sensors` refuses."""

    noise_deg_h: _Refused = None
    scale_ppm: _Refused = None
    misalignment_mrad: _Refused = None


class RecordedAccelerometer(Accelerometer):
    """The same of accelerometers."""

    noise_mg: _Refused = None
    scale_ppm: _Refused = None
    misalignment_mrad: _Refused = None


class Sensors(Section):
    """Inertial samples, and the class of their sensors."""

    file: str
    """table with t_s, gx_rad_s, gy_rad_s, gz_rad_s, ax_m_s2, ay_m_s2, az_m_s2, body axes forward-right-down;
    .gz, .bz2, .zip too"""
    file_sha256: Checksum | None = None
    """checksum of the file; when given, another file is refused"""
    columns: _columns(conventions.IMU_COLUMNS) = Field(default_factory=dict)
    """names of the columns in the file if they differ: {gx_rad_s: GyrX, ...}"""
    time_unit: _unit(conventions.TIME_UNITS) = "s"
    """unit of the column t_s"""
    gyro_unit: _unit(conventions.GYRO_UNITS) = "rad/s"
    """unit of the gyro columns"""
    accelerometer_unit: _unit(conventions.ACCELEROMETER_UNITS) = "m/s2"
    """unit of the accelerometer columns"""
    axes: BodyAxes = "FRD"
    """where the columns x, y, z point: F or B, R or L, D or U. FLU: forward, left, up"""
    gyro_axes: BodyAxes | None = None
    """axes of the gyros alone (positive by the right-hand rule), if they differ"""
    accelerometer_axes: BodyAxes | None = None
    """the same for the accelerometers alone; at rest an axis that points up shows +9.8. BLU: a log that has gravity
    instead of specific force"""
    sensor_class: Literal["consumer", "industrial", "tactical"] = "consumer"
    """grade of the sensors: turn-on and in-run biases, and where the tuning of the noise starts"""
    gyro: RecordedGyro = RecordedGyro()
    """errors of the gyros that differ from the class's"""
    accelerometer: RecordedAccelerometer = RecordedAccelerometer()
    """errors of the accelerometers that differ from the class's"""
    samples: Literal["instantaneous", "averaged", "increments"] = "instantaneous"
    """meaning of a sample: the value at its time, the mean since the sample before, or the change of angle and velocity
    since then, in the units times s"""
    longest_gap_s: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    """samples farther apart than this are a gap; default: five sample intervals"""

    @model_validator(mode="after")
    def _white_noise_as_density(self) -> Self:
        if self.gyro.noise_deg_h is not None:
            raise reject("recorded rates differ, so give the density, arw_deg_sqrt_h", "gyro", "noise_deg_h")
        if self.accelerometer.noise_mg is not None:
            raise reject("recorded rates differ, so give the density, vrw_m_s_sqrt_h", "accelerometer", "noise_mg")
        for sensor in ("gyro", "accelerometer"):
            for key, what in (("scale_ppm", "scale factors"), ("misalignment_mrad", "misalignments")):
                if getattr(getattr(self, sensor), key) is not None:
                    raise reject(f"the filter of a recorded flight does not estimate {what}", sensor, key)
        gyro, accelerometer = self.resolved()
        gyro.check(None, "gyro")
        accelerometer.check(None, "accelerometer")
        return self

    def convention(self) -> ImuConvention:
        """Convention of the table."""
        return ImuConvention(
            time_unit=self.time_unit,
            gyro_unit=self.gyro_unit,
            accelerometer_unit=self.accelerometer_unit,
            gyro_axes=self.axes if self.gyro_axes is None else self.gyro_axes,
            accelerometer_axes=self.axes if self.accelerometer_axes is None else self.accelerometer_axes,
            increments=self.samples == "increments",
            columns=self.columns,
        )

    def resolved(self) -> tuple[Gyro, Accelerometer]:
        """The sensors with the class's values for omitted keys."""
        of_class = SENSOR_CLASSES[self.sensor_class]
        gyro = filled(of_class["gyro"], self.gyro.model_dump(exclude_none=True))
        accel = filled(of_class["accelerometer"], self.accelerometer.model_dump(exclude_none=True))
        return Gyro.model_validate(gyro), Accelerometer.model_validate(accel)


class FixError(Section):
    """A time-correlated error of the fixes that the filter estimates: three Gauss-Markov states along north, east and
    down, or as many as the table has columns."""

    correlation_time_s: CorrelationTime
    """correlation time"""
    position_sigma_m: PairOf[Sigma] | None = None
    """1 sigma of the positions by this error: horizontal per axis, vertical; three states"""
    states: Literal[3, 6, 9, 12] | None = None
    """number of states. The table then has the effect of an error of 1 of each state on each fix, in m and m/s. Its
    columns are error1_n, error1_e, error1_d, error1_vn, error1_ve, error1_vd, error2_n, ..."""

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
        if (self.position_sigma_m is None) == (self.states is None):
            raise reject("give one of position_sigma_m and states", "position_sigma_m")
        return self


class Gnss(Section):
    """The fixes. Omitted keys are tuned (`tuning: likelihood`), or have the values below without tuning."""

    file: str
    """table with t_s, lat_deg, lon_deg, h_m, vn_m_s, ve_m_s, vd_m_s (velocities may be empty). It may have nsat and the
    covariance of each fix (sigma_n_m ... corr_ve_vd) or the accuracies that the receiver claims (sigma_horizontal_m,
    sigma_vertical_m, sigma_speed_m_s), and quality. Or NMEA sentences, also with a logger's text around them; with
    `navigation`, RINEX observations"""
    navigation: Files | None = None
    """RINEX navigation files, one or a list: fixes are solved from the ranges of `file`, which `filter.coupling: tight`
    uses directly"""
    navigation_sha256: Checksums | None = None
    """checksums of the navigation files, in order; when given, others are refused"""
    systems: DistinctListOf[Name] = ()
    """use the ranges of these systems, each with its own clock; left out: GPS and GLONASS"""
    mask_deg: Annotated[float, Field(ge=0.0, lt=90.0)] = 10.0
    """satellites lower than this are left out, of RINEX observations"""
    atmosphere: bool = True
    """take troposphere and ionosphere out of RINEX observations; false: of a simulation that has neither"""
    range_sigma_m: Sigma | None = None
    """1 sigma of a pseudorange overhead, for `coupling: tight`; it grows as 1 / sin(elevation); untuned 1"""
    range_rate_sigma_m_s: Sigma | None = None
    """1 sigma of a range rate, for `coupling: tight`; untuned 0.1"""
    clock: ClockNoise = ClockNoise()
    """noise of the receiver's clock, for `coupling: tight`"""
    file_sha256: Checksum | None = None
    """checksum of the file; when given, another file is refused"""
    columns: _columns((*conventions.GNSS_COLUMNS, *conventions.GNSS_OPTIONAL)) = Field(default_factory=dict)
    """names of the columns in the file if they differ; not for NMEA, nor units and axes"""
    time_unit: _unit(conventions.TIME_UNITS) = "s"
    """unit of the column t_s"""
    time_offset_s: LogTime = 0.0
    """added to the times of the fixes: GPS time less UTC is 18 s since 2017"""
    angle_unit: _unit(conventions.ANGLE_UNITS) = "deg"
    """unit of the columns of latitude and longitude"""
    position_axes: Literal["NE", "NW", "SE", "SW"] = "NE"
    """directions in which the columns of latitude and longitude increase: N or S, E or W. NW: west longitudes are
    positive; SW: hemisphere letters S and W were lost"""
    height_unit: _unit(conventions.HEIGHT_UNITS) = "m"
    """unit of the column of height"""
    speed_unit: _unit(conventions.SPEED_UNITS) = "m/s"
    """unit of the velocity columns"""
    vertical_speed_unit: _unit(conventions.VERTICAL_SPEED_UNITS) | None = None
    """unit of the vertical velocity if it differs, such as ft/min"""
    velocity_axes: LevelAxes = "NED"
    """where the columns vn, ve, vd point: N or S, E or W, D or U. ENU: east, north, up"""
    latency_s: RecordedLatency | None = None
    """delay from the time a fix is valid to its time in the file, negative for fixes that are stamped too early; left
    out: tuned, untuned 0"""
    velocity_latency_s: RecordedLatency | None = None
    """the same for the velocities, which some receivers smooth; left out: as latency_s, or tuned where the fixes show
    another"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """lever arm from the IMU to the antenna: forward, right, down"""
    velocity_sigma_m_s: PairOf[Sigma] | None = None
    """1 sigma of velocities: horizontal per axis, vertical, of fixes that have none in the table; left out: tuned,
    untuned 0.3 and 0.3"""
    position_sigma_m: PairOf[Sigma] | None = None
    """1 sigma of positions: horizontal per axis, vertical, of fixes that have none in the table; default 2.5 s times
    the velocity's, or tuned where fixes have accuracies or errors that last"""
    errors: Annotated[ListOf[FixError], Field(max_length=4)] = ()
    """time-correlated errors of the fixes (satellite orbits, atmosphere), which the filter estimates as states, in
    addition to the noise of each fix; for `coupling: loose`. Left out: from the receiver's accuracies, or tuned
    where the fixes show one"""
    spacing_s: NonNegative = 0.45
    """fixes closer than this to the last one used are omitted: their errors are nearly the same"""
    min_satellites: Annotated[int, Field(ge=0, le=1000)] = 4
    """fixes from fewer (column nsat) are left out"""
    simulator_fixes: bool = False
    """accept NMEA fixes that the receiver marks as a simulator's (quality 8, mode S)"""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if not self.navigation:
            for key in (
                "navigation_sha256",
                "systems",
                "range_sigma_m",
                "range_rate_sigma_m_s",
                "mask_deg",
                "clock",
                "atmosphere",
            ):
                if getattr(self, key) != type(self).model_fields[key].default:
                    raise reject("is for RINEX observations: give `navigation`", key)
            return self
        if self.of_table:
            raise reject("RINEX observations have no columns of effects: give position_sigma_m", "errors")
        default = type(self)(file=self.file).convention()
        if replace(self.convention(), time_offset=0.0) != default:
            raise reject("RINEX fixes the units; you can only shift its times", "file")
        return self

    @property
    def of_table(self) -> int:
        """Number of time-correlated errors with columns of their effects."""
        return sum(error.states or 0 for error in self.errors)

    def wanted(self) -> tuple[System, ...]:
        """The systems whose ranges are taken."""
        return tuple(system for system in SYSTEMS if system.name in self.systems) or USUAL

    def convention(self) -> GnssConvention:
        """Convention of the table."""
        return GnssConvention(
            time_unit=self.time_unit,
            time_offset=self.time_offset_s,
            angle_unit=self.angle_unit,
            position_axes=self.position_axes,
            height_unit=self.height_unit,
            speed_unit=self.speed_unit,
            vertical_speed_unit=self.vertical_speed_unit,
            velocity_axes=self.velocity_axes,
            columns=self.columns,
            errors=self.of_table,
        )


class ReferenceAttitude(Section):
    """The attitude by another system, such as an autopilot. The filter does not use it."""

    file: str
    """table with t_s, roll_deg, pitch_deg, yaw_deg, by the clock of the samples: attitude.csv of `navsim import`"""
    file_sha256: Checksum | None = None
    """checksum of the file; when given, another file is refused"""


class HeadingSection(Section):
    """Measured headings, which the filter uses beside the fixes, also to align."""

    file: str
    """table with t_s, heading_deg (clockwise from north) and, if known, sigma_heading_deg, by the clock of the samples.
    Rows without a heading do not count: the table of the fixes may have these columns"""
    file_sha256: Checksum | None = None
    """checksum of the file; when given, another file is refused"""
    columns: _columns(conventions.HEADING_COLUMNS) = Field(default_factory=dict)
    """names of the columns in the file if they differ"""
    time_unit: _unit(conventions.TIME_UNITS) = "s"
    """unit of the column t_s"""
    source: Literal["magnetic", "antennas", "other"] = "magnetic"
    """magnetic: from magnetic north; antennas: of the line between two antennas, from true north, and missing where
    fixes are withheld; other: of any other instrument, from true north"""
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    """declination of the field, east positive, for `source: magnetic`; left out: by the World Magnetic Model at the
    first fix and the epoch, which needs the extra `magnetic`"""
    mounting_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0
    """direction of the measured axis, clockwise from the nose as seen from above: 90 for antennas of which the second
    is to the right of the first"""
    latency_s: RecordedLatency = 0.0
    """delay from the time a heading is valid to its time in the file"""
    spacing_s: NonNegative = 0.45
    """headings closer than this to the last one used are omitted: their errors are nearly the same"""
    sigma_deg: Annotated[float, Field(ge=1e-4, le=90.0)] | None = None
    """1 sigma of the noise of headings that have none in the table; left out: 2, and the tuning scales all"""
    error_sigma_deg: Annotated[float, Field(ge=0.0, le=90.0)] | None = None
    """1 sigma of an error that lasts, which the filter estimates; left out: 5 for `source: magnetic`, otherwise 0"""
    correlation_time_s: CorrelationTime = 300.0
    """its correlation time"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if self.declination_deg is not None and self.source != "magnetic":
            raise reject("headings from true north have none; leave it out", "declination_deg")
        lasts = self.source == "magnetic" if self.error_sigma_deg is None else self.error_sigma_deg > 0.0
        if not lasts and self.correlation_time_s != type(self).model_fields["correlation_time_s"].default:
            raise reject("is of an error that lasts: give error_sigma_deg, or leave this out", "correlation_time_s")
        return self


class Standstills(Section):
    """Zero velocity, and zero rotation, while the samples show that the vehicle is at rest."""

    velocity_sigma_m_s: Sigma = 0.02
    """1 sigma of the velocity at rest, each axis"""
    rotation: bool = True
    """the gyros show the Earth's rate and their biases alone"""


class SideSlip(Section):
    """A vehicle on wheels: no velocity to the side and none up or down, in its own axes."""

    sigma_m_s: PairOf[Sigma] = (0.1, 0.5)
    """1 sigma of that velocity: lateral, vertical"""
    spacing_s: Annotated[float, Field(ge=0.01, le=1e3)] = 1.0
    """interval of these measurements: slip and springs make errors that last as long"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """from the IMU to the middle of the axle that does not steer: forward, right, down"""
    lever_arm_sigma_m: Annotated[float, Field(ge=0.0, le=100.0)] = 1.0
    """1 sigma of each component, which the filter then estimates; 0: known"""
    mounting_deg: Triple = (0.0, 0.0, 0.0)
    """roll, pitch, yaw of the axes of the IMU against those of the vehicle"""
    mounting_sigma_deg: Annotated[float, Field(ge=0.0, le=15.0)] = 2.0
    """1 sigma of each of them, which the filter then estimates; 0: known"""


class BeaconRanges(RangesSection):
    """Ranges to beacons or pseudolites, which the filter uses beside the fixes, also where these are withheld."""

    measurement: Literal["two_way", "one_way"] = "two_way"
    """two_way: the vehicle asks and the beacon answers, without a clock; one_way: pseudoranges, with a clock for each
    source and one for the receiver, in `clocks`"""
    time_offset_s: LogTime = 0.0
    """added to the times of the ranges, which then count as those of the samples"""
    sigma_m: Sigma
    """1 sigma of the white noise of a range, of all alike: a column sigma_m is not used"""
    bias_sigma_m: NonNegative = 0.1
    """1 sigma of the constant bias of each beacon, which the filter estimates; 0: none, as for one_way, where the clock
    contains it"""
    growth: Growth | None = None
    """a further state of each beacon, for two_way: a bias that grows with distance"""
    survey_sigma_m: NonNegative = 0.0
    """1 sigma of each beacon's position, each axis, which the filter estimates; 0: known"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """from the IMU to the antenna of the ranges: forward, right, down"""
    latency_s: RecordedLatency = 0.0
    """delay from the time a range is valid to its time in the file"""

    @model_validator(mode="before")
    @classmethod
    def _no_bias_beside_a_clock(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("measurement") == "one_way":
            return {"bias_sigma_m": 0.0, **data}
        return data

    @model_validator(mode="after")
    def _clock_contains_biases(self) -> Self:
        if self.measurement == "one_way":
            if self.bias_sigma_m > 0.0:
                raise reject("the source's clock contains a constant bias; leave it out", "bias_sigma_m")
            if self.growth is not None:
                raise reject("pseudoranges do not show the distance; leave growth out", "growth")
        return self


class OneWayClocks(ClocksSection):
    """Clocks of one-way ranges. Ranges show only their differences, so one clock is the reference, against which the
    others are counted."""

    datum: SourceName
    """source whose clock is the reference, or `receiver`"""
    sources: ClockModel
    """noise of each source's clock"""
    receiver: ClockModel
    """noise of the receiver's clock"""

    @model_validator(mode="before")
    @classmethod
    def _has_a_reference(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("datum") is None:
            raise reject(NO_REFERENCE, "datum")
        return data


NO_REFERENCE = (
    "one-way ranges show only differences of clocks: an offset of all sources' clocks looks like one of the receiver's"
    ". Name the clock against which the others are counted: a source, or receiver"
)
"""Why one clock has to be the reference."""


class KnownSection(Section):
    """Known navigation state at a time of the recording: the filter starts there without alignment."""

    time_s: LogTime
    """time of the recording at which the state is known, and the filter starts"""
    lat_deg: Latitude
    """latitude of the IMU"""
    lon_deg: Longitude
    """longitude of the IMU"""
    height_m: Annotated[float, Field(ge=-1e4, le=1e5)]
    """height of the IMU above the WGS-84 ellipsoid"""
    velocity_m_s: Triple
    """velocity over ground: north, east, down"""
    attitude_deg: TripleOf[Annotated[float, Field(ge=-360.0, le=360.0)]]
    """roll, pitch, yaw (heading)"""
    gyro_bias_deg_h: Triple = (0.0, 0.0, 0.0)
    """bias of the gyros; its 1 sigma is that of imu.gyro"""
    accelerometer_bias_mg: Triple = (0.0, 0.0, 0.0)
    """bias of the accelerometers; its 1 sigma is that of imu.accelerometer"""
    position_sigma_m: TripleOf[NonNegative]
    """1 sigma of the position: north, east, down"""
    velocity_sigma_m_s: TripleOf[NonNegative]
    """1 sigma of the velocity: north, east, down"""
    attitude_sigma_deg: TripleOf[NonNegative]
    """1 sigma of the attitude: about north, east, down; that about down is the heading's"""


class AlignmentSection(Section):
    """Initial alignment: level at rest, heading from the changes of velocity once it moves."""

    known: KnownSection | None = None
    """navigation state at a time, instead of an alignment; the other keys then serve a restart of a lost filter"""
    heading_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    """known heading at the start; needs a standstill"""
    heading_sigma_deg: Annotated[float, Field(ge=1e-6, le=30.0)] = 10.0
    """the heading must be good to this, 1 sigma; with heading_deg: how good it is"""
    longest_s: Annotated[float, Field(ge=5.0, le=600.0)] = 120.0
    """give up an attempt after this time and try later"""

    @model_validator(mode="after")
    def _one_start(self) -> Self:
        if self.known is not None and self.heading_deg is not None:
            raise reject("the heading at the start is that of alignment.known; leave one of them out", "heading_deg")
        return self


class ReplayGate(Section):
    """Rejection of implausible fixes, and restart of a lost filter."""

    probability: Annotated[float, Field(ge=0.0, lt=0.5)] = 1e-6
    """chance of rejecting a good fix; 0: no gate"""
    restart_s: Annotated[float, Field(ge=1.0, le=1e9)] = 10.0
    """a filter that rejects its fixes, or most ranges of each epoch, for so long restarts from them; longer than the
    flight: never"""
    max_rejected: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    """rejections in a row after which a fix, or a source's range, is taken nevertheless; left out: none is"""


class ReplayFilterSection(Section):
    """The filter."""

    kind: Kind = "tfg"
    """kind of the filter, as in landings; rts and map are smoothers"""
    coupling: Coupling = "loose"
    """loose: fixes are measurements; tight: pseudoranges and range rates of each satellite (needs gnss.navigation)"""
    gate: ReplayGate = ReplayGate()
    """rejection of fixes, or of ranges, that cannot be true"""
    steady_force: bool = True
    """in steady flight, couple attitude errors to velocity errors by the steady part of the specific force alone, as in
    landings; not where no fix has a velocity"""
    gaussian_sum: Components = Components()
    """the components of `kind: gaussian-sum`"""
    output_rate_hz: Annotated[float, Field(ge=1e-3, le=1000.0)] | Literal["fixes"] = 10.0
    """outputs of the filter a second; fixes: one whenever a fix comes"""


class Outage(Section):
    """Simulated outages: one for every start and every duration, each in a separate pass."""

    start_s: Times
    """time of the recording at which fixes are withheld from on; one or a list"""
    duration_s: Times
    """how long they are withheld; one or a list"""
    withhold: bool = False
    """withhold these fixes from the flight itself too"""


class Replay(Section):
    """A recorded flight through the filter."""

    kind: Literal["replay"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    epoch: Utc = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    """UTC of t_s = 0"""
    imu: Sensors
    """inertial samples, and the class of their sensors"""
    gnss: Gnss
    """the fixes, or the observations they are solved from"""
    skip_bad_records: bool = False
    """use the intact part of damaged files, and warn of the rest"""
    start_s: LogTime | None = None
    """look for the alignment from here on; default: the first fix"""
    end_s: LogTime | None = None
    """time of the recording at which to stop; default: its end"""
    checks: Literal["refuse", "warn", "off"] = "refuse"
    """reaction to a recording that seems to have wrong units, axes, signs or times"""
    alignment: AlignmentSection = AlignmentSection()
    """how the attitude at the start is found"""
    tuning: Literal["likelihood", "none"] = "likelihood"
    """likelihood: noise of fixes and sensors, and latency, as make the innovations of the fixes in motion most likely;
    where hardly any moves nothing is tuned"""
    filter: ReplayFilterSection = ReplayFilterSection()
    """the filter"""
    heading: HeadingSection | None = None
    """measured headings"""
    standstill: Standstills | None = None
    """velocity and rotation are zero at rest; {}: with the defaults"""
    side_slip: SideSlip | None = None
    """wheels do not slip sideways; {}: with the defaults"""
    ranges: BeaconRanges | None = None
    """ranges to beacons or pseudolites"""
    sources: SourceTable | None = None
    """geodetic positions of these beacons"""
    clocks: OneWayClocks | None = None
    """clocks of `ranges.measurement: one_way`"""
    outages: ListOf[Outage] = ()
    """fixes withheld on purpose, to see the drift"""
    reference: ReferenceAttitude | None = None
    """attitude by another system, with which the filter's is compared"""

    @property
    def begin(self) -> float | None:
        """Start of the flight, s, if the log has one."""
        return self.start_s if self.alignment.known is None else self.alignment.known.time_s

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.start_s is not None and self.alignment.known is not None:
            raise reject("the flight begins at alignment.known.time_s; leave one of them out", "start_s")
        if (known := self.alignment.known) is not None and self.end_s is not None and self.end_s <= known.time_s:
            raise reject("must come after alignment.known.time_s", "end_s")
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise reject("must come after start_s", "end_s")
        if (self.ranges is None) != (self.sources is None):
            missing = "ranges" if self.ranges is None else "sources"
            raise reject("ranges and the positions of their sources belong together; give both", missing)
        one_way = self.ranges is not None and self.ranges.measurement == "one_way"
        if one_way and self.clocks is None:
            raise reject(f"{NO_REFERENCE}, such as clocks: {{datum: receiver, sources: {{oscillator: ocxo}}, "
                         "receiver: {oscillator: tcxo}}", "clocks")  # fmt: skip
        if not one_way and self.clocks is not None:
            raise reject("only ranges with `measurement: one_way` have clocks; leave this section out", "clocks")
        if self.ranges is not None and self.filter.kind in ("first-estimates", "observability-constrained"):
            raise reject("it takes each correction by a range for a change of specific force; use another", "filter",
                         "kind")  # fmt: skip
        if self.filter.coupling == "tight" and not self.gnss.navigation:
            raise reject("fixes are all there is: give RINEX observations and gnss.navigation", "filter", "coupling")
        if self.filter.coupling == "tight" and self.gnss.errors:
            raise reject("a tightly coupled filter takes ranges, not fixes: leave it out", "gnss", "errors")
        return self
