"""`kind: landing`: the sections of a landing scenario and the models they stand for.

Source of structure and defaults: `landing.md`. A section is the only declaration of its parameters; where a
key may be left out, its default is written here and nowhere else.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from navsim.scenario.base import (
    DEG,
    DEG_H,
    DEG_SQRT_H,
    KMH,
    MG,
    Azimuth,
    Checksum,
    Elevation,
    Latitude,
    Longitude,
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
)
from navsim.scenario.presets import IMU_PRESETS

if TYPE_CHECKING:
    import numpy as np

    from navsim.models.imu import Triad
    from navsim.models.kinematics import Frame, Trajectory
    from navsim.models.path import Path
    from navsim.models.sky import Mask

Clock = Literal["glonass", "gps", "own"]
CLOCKS: tuple[Clock, ...] = ("glonass", "gps", "own")
"""Time scales a source may keep; each used one costs a fix one unknown. Their order numbers them."""


class Point(Section):
    """A place on the ellipsoid."""

    lat_deg: Latitude
    """geodetic latitude"""
    lon_deg: Longitude
    """longitude, east positive"""

    @property
    def radians(self) -> tuple[float, float]:
        """Latitude and longitude, rad."""
        return self.lat_deg * DEG, self.lon_deg * DEG


class Runway(Section):
    """The runway and where on it the aircraft touches down."""

    heading_deg: Azimuth = 0.0
    """direction of landing, clockwise from true north"""
    height_m: Annotated[float, Field(ge=-500.0, le=6000.0)] = 0.0
    """height above the WGS-84 ellipsoid"""
    length_m: Positive = 1000.0
    """for drawings only"""
    width_m: Positive = 30.0
    """for drawings only"""
    aim_point_m: Annotated[float, Field(ge=0.0, le=3000.0)] = 0.0
    """touchdown point beyond the threshold"""
    threshold: Point | None = None
    """where the runway begins; leave out to derive it from approach.start"""


class _Approach(Section):
    start: Point | None = None
    """where the simulation begins; leave out to derive it from runway.threshold"""
    start_height_m: Annotated[float, Field(gt=0.0, le=5000.0)] = 153.0
    """height above the runway at the start"""
    glide_slope_deg: Annotated[float, Field(ge=1.0, le=15.0)] = 5.0
    speed_start_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 130.0
    """along the path, over ground"""
    speed_touchdown_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 80.0
    """along the path, over ground"""
    angle_of_attack_deg: Annotated[float, Field(ge=-10.0, le=30.0)] = 3.0
    """constant; pitch = path angle relative to the air + angle of attack"""
    pitch: Literal["path", "level"] = "path"
    """path: the nose follows the path; level: it keeps angle_of_attack_deg above the horizon"""


class STurn(_Approach):
    """Level flight turning right and left, not a landing: for filters to prove themselves in."""

    profile: Literal["s-turn"]
    turn_rate_deg_s: Annotated[float, Field(gt=0.0, le=45.0)] = 6.0
    period_s: Positive = 30.0
    """one turn to the right and one to the left"""
    roll_s: Positive = 2.0
    """time to roll from one side to the other"""

    def path(self) -> Path:
        """The path in the tangent plane of its first point, an hour long. Raises ValueError where there is none."""
        from navsim.models.approach import s_turn

        return s_turn(
            self.speed_start_kmh * KMH,
            self.start_height_m,
            self.turn_rate_deg_s * DEG,
            self.period_s,
            self.roll_s,
            3600.0,
        )


class PaperApproach(_Approach):
    """The paper's profile: uniformly decelerated glide from time 0, then level at the touchdown speed."""

    profile: Literal["paper"]
    corner_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.5
    """time within which the glide turns into level flight (instantaneous in the paper)"""

    def path(self) -> Path:
        """The path in the tangent plane of the touchdown point. Raises ValueError where there is none."""
        from navsim.models.approach import paper_profile

        return paper_profile(
            self.speed_start_kmh * KMH,
            self.speed_touchdown_kmh * KMH,
            self.start_height_m,
            self.glide_slope_deg * DEG,
            self.corner_s,
        )


class SmoothApproach(_Approach):
    """A profile an aircraft can fly: level lead-in, capture, decelerated glide, exponential flare, roll-out."""

    profile: Literal["smooth"]
    lead_in_s: Positive = 35.0
    """level flight before the capture of the glide slope"""
    capture_s: Positive = 6.0
    """duration of the transition onto the slope"""
    flare_height_m: Positive = 6.0
    flare_blend_s: Positive = 1.0
    """transition from the slope into the exponential flare"""
    touchdown_sink_m_s: Positive = 0.5
    """rate of descent at touchdown"""
    settle_s: Positive = 1.0
    """time in which the landing gear takes up the sink rate and the brakes come on"""
    rollout_deceleration_m_s2: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5

    def path(self) -> Path:
        """The path in the tangent plane of the touchdown point. Raises ValueError where there is none."""
        from navsim.models.approach import smooth_profile

        return smooth_profile(
            self.speed_start_kmh * KMH,
            self.speed_touchdown_kmh * KMH,
            self.start_height_m,
            self.glide_slope_deg * DEG,
            lead_in=self.lead_in_s,
            capture=self.capture_s,
            flare_height=self.flare_height_m,
            flare_blend=self.flare_blend_s,
            sink_touchdown=self.touchdown_sink_m_s,
            settle=self.settle_s,
            rollout_deceleration=self.rollout_deceleration_m_s2,
        )


class RecordedApproach(Section):
    """A real flight, as `navsim replay` found it, with simulated sensors, satellites and pseudolites."""

    profile: Literal["recorded"]
    file: str
    """result of a replay; smoothed (filter.kind: rts) it is smoothest"""
    file_sha256: Checksum | None = None
    """its checksum; when given, another file is refused"""
    start_s: float | None = None
    """time of the log that becomes time 0; default: the first there is"""
    touchdown_s: float | None = None
    """time of the log at touchdown, for the figures there"""

    @property
    def start(self) -> Point | None:
        """Nothing: the recording says where it starts."""
        return None


class WindSection(Section):
    """Steady wind. It changes the attitude (crab), not the path, which is given over ground."""

    speed_m_s: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    from_deg: Azimuth = 0.0
    """direction the wind comes from, clockwise from true north"""


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
    markov_deg_h: NonNegative | None = None
    """1 sigma of the exponentially correlated drift"""
    markov_time_s: Positive | None = None
    """its correlation time"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        if self.noise_deg_h is not None and self.arw_deg_sqrt_h is not None:
            raise reject("noise_deg_h and arw_deg_sqrt_h are two spellings of one noise; give one", "arw_deg_sqrt_h")
        return self

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.models.imu import Triad, density_from_sample_sigma

        density = (self.arw_deg_sqrt_h or 0.0) * DEG_SQRT_H
        if self.noise_deg_h is not None:
            density = density_from_sample_sigma(self.noise_deg_h * DEG_H, rate)
        return Triad(
            bias=(self.drift_deg_h or 0.0) * DEG_H,
            noise_density=density,
            markov=(self.markov_deg_h or 0.0) * DEG_H,
            markov_time=self.markov_time_s or math.inf,
            fixed_bias=_scaled(self.drift_fixed_deg_h, DEG_H),
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
    markov_mg: NonNegative | None = None
    """1 sigma of the exponentially correlated bias"""
    markov_time_s: Positive | None = None
    """its correlation time"""

    @model_validator(mode="after")
    def _one_spelling(self) -> Self:
        if self.noise_mg is not None and self.vrw_m_s_sqrt_h is not None:
            raise reject("noise_mg and vrw_m_s_sqrt_h are two spellings of one noise; give one", "vrw_m_s_sqrt_h")
        return self

    def triad(self, rate: float) -> Triad:
        """The error model in SI units at a sample rate (Hz)."""
        from navsim.models.imu import Triad, density_from_sample_sigma

        density = (self.vrw_m_s_sqrt_h or 0.0) / 60.0
        if self.noise_mg is not None:
            density = density_from_sample_sigma(self.noise_mg * MG, rate)
        return Triad(
            bias=(self.bias_mg or 0.0) * MG,
            noise_density=density,
            markov=(self.markov_mg or 0.0) * MG,
            markov_time=self.markov_time_s or math.inf,
            fixed_bias=_scaled(self.bias_fixed_mg, MG),
        )


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


class _Sensors(Section):
    preset: Literal["paper", "perfect"] = "paper"
    """paper: 700 deg/h and 30 deg/h per sample, 1e-3 g and 1e-2 g per sample; perfect: no errors"""
    gyro: Gyro = Gyro()
    accelerometer: Accelerometer = Accelerometer()

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if not isinstance(data, dict):
            return data
        preset = IMU_PRESETS.get(data.get("preset", "paper"))
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
        for name, size in (("gyro", self.gyro.markov_deg_h), ("accelerometer", self.accelerometer.markov_mg)):
            if size and getattr(self, name).markov_time_s is None:
                raise reject("an exponentially correlated error needs its correlation time", name, "markov_time_s")
        return self


class Imu(_Sensors):
    """The inertial sensors as they really are."""

    rate_hz: Annotated[float, Field(ge=10.0, le=2000.0)] = 100.0


class Vectors(Section):
    """One value for each of north, east, down."""

    attitude_deg: Triple = (0.0, 0.0, 0.0)
    position_m: Triple = (0.0, 0.0, 0.0)
    velocity_m_s: Triple = (0.0, 0.0, 0.0)


class InitialErrors(Section):
    """Errors (truth - estimate) the navigation starts with: 1 sigma per axis, drawn per run."""

    attitude_deg: Annotated[float, Field(ge=0.0, le=60.0)] = 5.0
    position_m: NonNegative = 10.0
    velocity_m_s: NonNegative = 1.0
    fixed: Vectors | None = None
    """the errors themselves, instead of drawing them; the filter still starts from the sigmas"""


class Direction(Section):
    """A source in a fixed direction."""

    azimuth_deg: Azimuth
    elevation_deg: Elevation
    clock: Clock = "glonass"


class Interference(Section):
    """A jammed part of the sky: sources inside are lost."""

    azimuth_deg: Pair = (0.0, 360.0)
    """from, to, clockwise; 350 to 10 goes through north"""
    elevation_deg: Pair = (-90.0, 90.0)
    """from, to"""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for key, low, high in (("azimuth_deg", 0.0, 360.0), ("elevation_deg", -90.0, 90.0)):
            pair = getattr(self, key)
            if not all(low <= v <= high for v in pair):
                raise reject(f"both ends must lie within {low:g} to {high:g}", key)
        if self.elevation_deg[0] >= self.elevation_deg[1]:
            raise reject("the lower end comes first", "elevation_deg")
        return self


Four = Annotated[tuple[float, float, float, float], BeforeValidator(one_or_more)]
Files = Annotated[tuple[str, ...], BeforeValidator(one_or_more), PlainSerializer(one_or_list)]
"""A file name or a list of them."""
Checksums = Annotated[tuple[Checksum, ...], BeforeValidator(one_or_more), PlainSerializer(one_or_list)]


class Sky(Section):
    """Where the satellites are, and which of them are received."""

    source: Literal["nominal-glonass", "nominal-gps", "nominal", "almanac", "navigation", "orbits", "directions"] = (
        "nominal-glonass"
    )
    """nominal: design constellations, GPS and GLONASS; almanac, navigation, orbits: real satellites from files"""
    almanac: Files | None = None
    """for `source: almanac`: .agl, .agp, YUMA, SEM, two-line elements; one file or a list"""
    almanac_sha256: Checksums | None = None
    """checksum of the file, or a list in their order; when given, another file is refused"""
    navigation: Files | None = None
    """for `source: navigation`: RINEX 2 or 3 broadcast messages, one file or a list; .gz too"""
    navigation_sha256: Checksums | None = None
    """as almanac_sha256"""
    orbits: Files | None = None
    """for `source: orbits`: SP3 precise orbits, one file or a list; .gz too"""
    orbits_sha256: Checksums | None = None
    """as almanac_sha256"""
    systems: list_of(Literal["glonass", "gps"]) = ()  # type: ignore[valid-type]
    """use these alone; left out: all there are"""
    broadcast: bool = False
    """satellites fly what their messages would say: GLONASS by state vectors each 30 minutes, integrated as receivers
    do; so that files exported from the run are exact"""
    directions: list_of(Direction) = ()  # type: ignore[valid-type]
    """sources X01, X02, ... in fixed directions from the receiver, for `source: directions`"""
    mask_deg: Elevation = 5.0
    """lowest usable elevation"""
    mask_upper_deg: Elevation = 90.0
    """highest usable elevation"""
    interference: list_of(Interference) = ()  # type: ignore[valid-type]
    exclude: list_of(str) = ()  # type: ignore[valid-type]
    """names of satellites not to use, such as R05"""
    use_unhealthy: bool = False
    """use satellites that the almanac marks as unhealthy"""
    almanac_warning_days: Positive = 14.0
    """age of an almanac from which on a warning is given"""

    @model_validator(mode="after")
    def _what_the_source_needs(self) -> Self:
        for source in ("almanac", "navigation", "orbits"):
            if self.source == source and not getattr(self, source):
                raise reject(f"`source: {source}` needs the file name here", source)
        if self.source == "directions" and not self.directions:
            raise reject("`source: directions` needs a list of azimuth_deg and elevation_deg here", "directions")
        if self.mask_deg >= self.mask_upper_deg:
            raise reject("must lie below mask_upper_deg", "mask_deg")
        for index, name in enumerate(self.exclude):
            if not re.fullmatch(r"(R(0[1-9]|1\d|2[0-4])|R\d{3}|G\d{2}|T\d{5}|X\d{2})", name):
                raise reject(f"'{name}' names no source; GLONASS slots are R01 to R24, GPS G01 on", "exclude", index)
        return self

    def mask(self) -> Mask:
        """The mask in radians."""
        from navsim.models.sky import Mask, Sector

        sectors = tuple(
            Sector(
                (s.azimuth_deg[0] * DEG, s.azimuth_deg[1] * DEG),
                (s.elevation_deg[0] * DEG, s.elevation_deg[1] * DEG),
            )
            for s in self.interference
        )
        return Mask(self.mask_deg * DEG, self.mask_upper_deg * DEG, sectors)


class Site(Section):
    """One pseudolite, by s_m and l1_m or by coordinates."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,16}$")] | None = None
    s_m: float | None = None
    """distance from the runway axis, positive to the right in the runway frame"""
    l1_m: float | None = None
    """distance before the threshold"""
    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    height_m: float | None = None
    """above the runway; default pseudolites.height_m"""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        by_runway = (self.s_m is not None, self.l1_m is not None)
        by_point = (self.lat_deg is not None, self.lon_deg is not None)
        if not ((all(by_runway) and not any(by_point)) or (all(by_point) and not any(by_runway))):
            raise reject("give either s_m and l1_m, or lat_deg and lon_deg")
        return self


class Ionosphere(Section):
    """The ionosphere by the model GPS broadcasts, for satellites; off the L1 of GPS with the square of frequency."""

    alpha: Four = (1.1176e-8, 1.4901e-8, -5.9605e-8, -5.9605e-8)
    """coefficients of the message, s, s/semicircle, ...; default: a day of moderate activity"""
    beta: Four = (9.0112e4, 1.6384e4, -1.9661e5, -6.5536e4)
    truth_scale: NonNegative = 1.5
    """the real delay is this many times the model's: the model takes off half to two thirds"""
    corrected: bool = True
    """the receiver takes the model off"""


class Troposphere(Section):
    """The troposphere by the seasonal climatology of DO-229 with Niell's mapping, for satellites."""

    truth_scale: NonNegative = 1.02
    """the real delay is this many times the climatology's"""
    correction: Literal["none", "saastamoinen", "mops"] = "saastamoinen"
    """what the receiver takes off: nothing, Saastamoinen's standard atmosphere, or the climatology itself"""


class Ephemeris(Section):
    """Errors of the satellites' messages: drawn per run and satellite, constant over a run."""

    orbit_sigma_m: Triple = (0.3, 1.0, 0.7)
    """radial, along, across the track"""
    clock_sigma_m: NonNegative = 1.0


class Tracking(Section):
    """The code loop; with `range_law: cn0` it makes the noise of satellite ranges, and of multipath the error."""

    spacing_chips: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """early to late"""
    bandwidth_hz: Positive = 1.0
    """one-sided"""
    integration_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    gain_horizon_db: Annotated[float, Field(ge=-40.0, le=0.0)] = -10.0
    """gain of the receiving antenna at its horizon relative to the zenith, where cn0_dbhz is meant"""


class GroundMultipath(Section):
    """Reflection of the pseudolites' signals by flat ground: two rays, Fresnel's coefficients, antenna gain."""

    permittivity: Annotated[float, Field(ge=1.0, le=100.0)] = 15.0
    """of the ground, relative; ITU-R P.527: 3 dry sand, 15 medium soil, 30 wet soil, 80 water"""
    conductivity_s_m: NonNegative = 0.035
    """1e-3 dry, 0.035 medium, 0.1 wet"""


class Differential(Section):
    """Corrections from a station at the pseudolite's site: what it sees wrong of each satellite."""

    latency_s: Annotated[float, Field(ge=0.0, le=60.0)] = 1.0
    """age of the corrections"""
    sigma_m: NonNegative = 0.3
    """1 sigma of the station's own noise in them"""
    site: str | None = None
    """name of the pseudolite whose site has the station; default: the first"""


class Pseudolites(Section):
    """Ground transmitters beside the runway: none, one at +S, two at +-S, or any number by `sites`."""

    count: Literal[0, 1, 2] = 0
    """one stands at +s_m, two stand at +s_m and -s_m, l1_m before the threshold"""
    s_m: float | None = None
    """distance from the runway axis"""
    l1_m: float | None = None
    """distance from the threshold"""
    sites: list_of(Site) = ()  # type: ignore[valid-type]
    """instead of count, s_m and l1_m: each pseudolite by itself"""
    frame: Literal["table1", "runway"] = "runway"
    """table1: the coordinates the paper's Table 1 computes from s_m and l1_m; runway: s_m across, l1_m along"""
    height_m: float = 0.0
    """above the runway"""
    clock: Clock = "glonass"
    """time scale the pseudolites keep; own: one unknown more"""
    clock_offset_ns: float = 0.0
    """of the transmitters against that scale, unknown to the receiver"""
    survey_error_m: Triple = (0.0, 0.0, 0.0)
    """north, east, down: true minus surveyed position"""
    range_sigma_m: Positive = 2.23606797749979
    range_rate_sigma_m_s: Positive = 0.1
    cn0_dbhz: Annotated[float, Field(ge=10.0, le=80.0)] = 45.0
    """carrier to noise density ratio, reported with the measurements"""
    cn0_reference_m: Positive | None = None
    """distance at which cn0_dbhz is meant; it then falls with distance. Left out: the same everywhere"""
    multipath: GroundMultipath | None = None
    """reflection by the ground; left out: none"""
    differential: Differential | None = None
    """corrections for satellites; left out: none"""

    @model_validator(mode="after")
    def _station(self) -> Self:
        if self.differential is not None:
            if not self.placed():
                raise reject("corrections come from a pseudolite's site, and there is none", "differential")
            site = self.differential.site
            if site is not None and site not in self.names():
                raise reject(f"no pseudolite is named '{site}'; there are {', '.join(self.names())}", "differential",
                             "site")  # fmt: skip
        return self

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.sites:
            for key in ("count", "s_m", "l1_m"):
                if getattr(self, key):
                    raise reject("not together with sites", key)
            names = self.names()
            for i, name in enumerate(names):
                if name in names[:i]:
                    raise reject(f"two pseudolites are named '{name}'", "sites", i)
        elif self.count:
            for key in ("s_m", "l1_m"):
                if getattr(self, key) is None:
                    raise reject(f"{self.count} pseudolites need both s_m and l1_m", key)
        return self

    def placed(self) -> tuple[Site, ...]:
        """Every pseudolite as a site of its own."""
        if self.sites:
            return self.sites
        return tuple(Site(s_m=sign * (self.s_m or 0.0), l1_m=self.l1_m) for sign in (1.0, -1.0)[: self.count])

    def names(self) -> tuple[str, ...]:
        """PL1, PL2, ... or the names given."""
        return tuple(site.name or f"PL{i}" for i, site in enumerate(self.placed(), 1))


class Signals(Section):
    """Errors of the ranging signals of satellites."""

    range_sigma_m: Positive = 2.23606797749979
    """1 sigma at the zenith (the paper's variance of 5 m2)"""
    range_law: Literal["constant", "inverse-sine", "exponential", "cn0"] = "inverse-sine"
    """growth towards the horizon; cn0: thermal noise of the code loop, from cn0_dbhz and the antenna's gain"""
    range_scale_deg: Positive = 10.0
    """scale of the exponential law"""
    range_rate_sigma_m_s: Positive = 0.1
    cn0_dbhz: Annotated[float, Field(ge=10.0, le=80.0)] = 45.0
    """carrier to noise density ratio, reported with the measurements; with `range_law: cn0` at the zenith"""
    tracking: Tracking = Tracking()
    ionosphere: Ionosphere | None = None
    """left out: none"""
    troposphere: Troposphere | None = None
    """left out: none"""
    ephemeris: Ephemeris | None = None
    """errors of orbits and clocks; left out: none"""
    gps_offset_ns: float = 0.0
    """GPS time less GLONASS time, which a receiver with a clock unknown for each does not notice"""


class Receiver(Section):
    """The satellite receiver: epochs, antenna, clock."""

    rate_hz: Annotated[float, Field(gt=0.0, le=100.0)] = 10.0
    """fixes a second"""
    latency_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0
    """from the time a fix is valid to the time the filter gets it"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """IMU to antenna: forward, right, down"""
    clock_offset_us: float = 100.0
    clock_drift_ppb: float = 50.0
    smoothing_s: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """memory of the carrier-smoothed code; 0: bare code"""
    one_clock: bool = False
    """take all time scales for one: one unknown less, and gps_offset_ns is felt"""


class FilterInitial(Section):
    """1 sigma the filter starts from; what is left out is that of initial_errors."""

    attitude_deg: Positive | None = None
    position_m: Positive | None = None
    velocity_m_s: Positive | None = None


class FilterSensors(Section):
    """Sensor errors the filter believes in; a sensor left out is as `imu` says."""

    gyro: Gyro | None = None
    accelerometer: Accelerometer | None = None


class Gate(Section):
    """Rejection of fixes that cannot be true."""

    probability: Annotated[float, Field(ge=0.0, lt=0.5)] = 1e-6
    """chance of rejecting a good fix; 0: no gate"""
    max_rejected: Annotated[int, Field(ge=0)] = 10
    """rejections in a row after which a fix is taken nevertheless"""


class Filter(Section):
    """What the filter does and believes; what is left out follows from the truth."""

    kind: Literal["tfg", "eskf", "left-invariant", "rts", "map"] = "tfg"
    """tfg: two-frames group; eskf: error-state; left-invariant: SE2(3); all with exact covariance reset. rts and map:
    smoothers, each output from all fixes: one backward pass, or iterated to the maximum a posteriori"""
    velocity: bool = True
    """use the velocity of the fixes beside their position"""
    latency_s: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    """default: receiver.latency_s"""
    lever_arm_m: Triple | None = None
    """default: receiver.lever_arm_m"""
    fix_sigma_scale: Positive = 1.0
    """factor on the receiver's own 1 sigma"""
    initial: FilterInitial = FilterInitial()
    imu: FilterSensors = FilterSensors()
    gate: Gate = Gate()


class Landing(Section):
    """A landing: INS corrected by satellites and pseudolites."""

    kind: Literal["landing"]
    version: Literal[1]
    title: str = ""
    epoch: Utc
    """UTC of time 0"""
    duration_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 120.0
    method: Literal["monte-carlo", "covariance"] = "monte-carlo"
    """monte-carlo: fly the runs; covariance: the same accuracy to first order from matrices, with an error budget"""
    runway: Runway = Runway()
    approach: Annotated[PaperApproach | SmoothApproach | STurn | RecordedApproach, Field(discriminator="profile")]
    wind: WindSection = WindSection()
    imu: Imu = Imu()
    initial_errors: InitialErrors = InitialErrors()
    sky: Sky = Sky()
    pseudolites: Pseudolites = Pseudolites()
    signals: Signals = Signals()
    receiver: Receiver = Receiver()
    filter: Filter = Filter()

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.approach.start is None) == (self.runway.threshold is None):
            raise reject(
                "give exactly one of approach.start and runway.threshold; the other follows from it",
                "approach",
                "start",
            )
        if self.receiver.rate_hz > self.imu.rate_hz:
            raise reject("fixes cannot come faster than the IMU's samples (imu.rate_hz)", "receiver", "rate_hz")
        if self.method == "covariance":
            for what, on in (("ephemeris", self.signals.ephemeris), ("smoothing_s", self.receiver.smoothing_s)):
                if on:
                    section = "signals" if what == "ephemeris" else "receiver"
                    raise reject("the covariance analysis knows no errors correlated in time; fly runs", section, what)
        if self.duration_s * self.imu.rate_hz < 2.0:
            raise reject("shorter than two samples of the IMU", "duration_s")
        if isinstance(self.approach, RecordedApproach):
            if self.pseudolites.frame == "table1":
                raise reject("the paper's frame needs the paper's approach", "pseudolites", "frame")
            if self.wind.speed_m_s:
                raise reject("a recorded flight has had its wind", "wind", "speed_m_s")
            return self
        try:
            path = self.approach.path()
        except ValueError as error:
            raise reject(f"no such path: {error}", "approach") from error
        self._checked_speed(path)
        self._checked_pseudolites()
        return self

    def _checked_speed(self, path: Path) -> None:
        import numpy as np

        times = np.linspace(0.0, self.duration_s, 400)
        slowest = np.min(np.linalg.norm(path.jet(times)[:, 1], axis=1))
        if slowest < 2.0:
            key = "rollout_deceleration_m_s2" if isinstance(self.approach, SmoothApproach) else "profile"
            raise reject(
                f"the aircraft falls to {slowest:.1f} m/s within duration_s; its attitude follows from its path, "
                "so it must keep 2 m/s",
                "approach",
                key,
            )

    def _checked_pseudolites(self) -> None:
        import numpy as np

        if self.pseudolites.frame == "table1" and self.approach.start is None and self.pseudolites.placed():
            raise reject("the paper's frame is counted from approach.start, which is not given", "pseudolites", "frame")
        trajectory = self.trajectory()
        times = np.arange(0.0, self.duration_s, 0.1)
        track = trajectory.path.jet(times)[:, 0] @ trajectory.frame.axes.T + trajectory.frame.origin
        from navsim.core.wgs84 import ecef_from_llh

        for index, llh in enumerate(self.pseudolite_positions(trajectory.frame)):
            distance = float(np.min(np.linalg.norm(track - ecef_from_llh(llh), axis=1)))
            if distance < 10.0:
                path = ("sites", index) if self.pseudolites.sites else ("s_m",)
                raise reject(
                    f"pseudolite {self.pseudolites.names()[index]} comes within {distance:.1f} m of the aircraft; "
                    "it must stay 10 m away",
                    "pseudolites",
                    *path,
                )

    # --- the models the sections stand for

    def slant(self) -> float:
        """Length of the paper's glide path, m: start height over the sine of the slope."""
        assert not isinstance(self.approach, RecordedApproach)
        return self.approach.start_height_m / math.sin(self.approach.glide_slope_deg * DEG)

    def trajectory(self) -> Trajectory:
        """The aircraft's motion over the Earth; recorded approaches are read elsewhere."""
        import numpy as np

        from navsim.models.approach import FLARE, TOUCHDOWN
        from navsim.models.kinematics import Trajectory, Wind, touchdown_from_start, touchdown_from_threshold

        assert not isinstance(self.approach, RecordedApproach)
        path = self.approach.path()
        heading = self.runway.heading_deg * DEG
        if self.approach.start is not None:
            begin = path.jet(np.zeros(1))[0, 0]
            frame = touchdown_from_start(self.approach.start.radians, self.runway.height_m, heading, begin)
        else:
            assert self.runway.threshold is not None
            frame = touchdown_from_threshold(
                self.runway.threshold.radians, self.runway.height_m, heading, self.runway.aim_point_m
            )
        towards = (self.wind.from_deg + 180.0) * DEG - heading
        speed = self.wind.speed_m_s
        wind = np.array([speed * math.cos(towards), speed * math.sin(towards), 0.0])
        events = path.events
        return Trajectory(
            path,
            frame,
            Wind(wind, events.get(FLARE), events[TOUCHDOWN] if FLARE in events else None),
            self.approach.angle_of_attack_deg * DEG,
            self.approach.pitch == "path",
        )

    def threshold(self, frame: Frame) -> np.ndarray:
        """Threshold of the runway (rad, rad, m) whose touchdown point is the origin of `frame`."""
        import numpy as np

        from navsim.core.wgs84 import llh_from_ecef

        llh = llh_from_ecef(frame.origin - self.runway.aim_point_m * frame.axes[:, 0])
        return np.array([llh[0], llh[1], self.runway.height_m])

    def pseudolite_positions(self, frame: Frame) -> np.ndarray:
        """Surveyed positions (p, 3), rad, rad, m."""
        import numpy as np

        from navsim.models.pseudolite import runway_position, table1_position

        out = np.empty((len(self.pseudolites.placed()), 3))
        for row, site in zip(out, self.pseudolites.placed(), strict=True):
            above = self.pseudolites.height_m if site.height_m is None else site.height_m
            height = self.runway.height_m + above
            if site.lat_deg is not None and site.lon_deg is not None:
                row[:] = site.lat_deg * DEG, site.lon_deg * DEG, height
                continue
            assert site.s_m is not None
            assert site.l1_m is not None
            if self.pseudolites.frame == "table1":
                assert self.approach.start is not None
                row[:2] = table1_position(np.array(self.approach.start.radians), self.slant(), site.s_m, site.l1_m)
                row[2] = height
            else:
                heading = self.runway.heading_deg * DEG
                row[:] = runway_position(self.threshold(frame), heading, site.s_m, site.l1_m, above)
        return out
