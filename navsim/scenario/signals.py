"""Signals, their errors, the receiver: sections `signals`, `receiver`."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from navsim.gnss.constellations.systems import CLOCKS, GLONASS, GPS
from navsim.scenario.fix_states import FixStatesSection
from navsim.scenario.sky import Name
from navsim.scenario_files.base import (
    DEG,
    CorrelationTime,
    Elevation,
    FixLatency,
    ListOf,
    NonNegative,
    Section,
    Sigma,
    Signed,
    Triple,
    as_tuple,
    reject,
)
from navsim.scenario_files.presets import SIGNAL_PRESETS

if TYPE_CHECKING:
    from navsim.gnss import signal_errors
    from navsim.gnss.antenna import AircraftAntenna
    from navsim.gnss.correlated_errors import CorrelatedError, Mapping
    from navsim.gnss.dll import CodeLoop, GroundReflection
    from navsim.gnss.ground_accuracy import GroundStationError
    from navsim.gnss.receiver import Receiver
    from navsim.gnss.signals import ErrorLaw


Klobuchar = Annotated[float, Field(ge=-1e8, le=1e8)]


Four = Annotated[tuple[Klobuchar, Klobuchar, Klobuchar, Klobuchar], BeforeValidator(as_tuple)]


class IonosphereSection(Section):
    """The ionosphere by the model GPS broadcasts, for satellites; off the L1 of GPS with the square of frequency."""

    alpha: Four = (1.1176e-8, 1.4901e-8, -5.9605e-8, -5.9605e-8)
    """coefficients of the message, s, s/semicircle, ...; default: a day of moderate activity"""
    beta: Four = (9.0112e4, 1.6384e4, -1.9661e5, -6.5536e4)
    """coefficients of the period in the message, s, s/semicircle, ..."""
    truth_scale: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.5
    """the real delay is this many times the model's: the model takes off half to two thirds"""
    corrected: bool = True
    """the receiver takes the model off"""

    def model(self) -> signal_errors.Ionosphere:
        """Model of its effect on signals."""
        import numpy as np

        from navsim.gnss import signal_errors

        return signal_errors.Ionosphere(np.array(self.alpha), np.array(self.beta), self.truth_scale, self.corrected)


class TroposphereSection(Section):
    """The troposphere by the seasonal climatology of DO-229 with Niell's mapping, for satellites."""

    truth_scale: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.02
    """the real delay is this many times the climatology's"""
    correction: Literal["none", "saastamoinen", "mops"] = "saastamoinen"
    """the receiver's correction: none, Saastamoinen's standard atmosphere, or the climatology itself"""

    def model(self) -> signal_errors.Troposphere:
        """Model of its effect on signals."""
        from navsim.gnss import signal_errors

        return signal_errors.Troposphere(self.truth_scale, self.correction)


class Ephemeris(Section):
    """Errors of the satellites' messages: drawn per run and satellite, constant over a run."""

    orbit_sigma_m: Triple = (0.3, 1.0, 0.7)
    """1 sigma of the orbit's error: radial, along, across the track"""
    clock_sigma_m: NonNegative = 1.0
    """1 sigma of the error of the satellite's clock, as a range"""

    def model(self) -> signal_errors.SignalInSpaceErrors:
        """The errors of satellites."""
        import numpy as np

        from navsim.gnss import signal_errors

        return signal_errors.SignalInSpaceErrors(np.array(self.orbit_sigma_m), self.clock_sigma_m)


class CorrelatedErrorSection(Section):
    """Time-correlated errors of one kind, drawn for each satellite and run: a Gauss-Markov process."""

    sigma_m: NonNegative
    """1 sigma at the zenith"""
    correlation_time_s: CorrelationTime
    """correlation time"""
    mapping: Literal["none", "ionosphere", "troposphere", "multipath"] | None = None
    """increase towards the horizon: none, or as of the ionosphere, the troposphere or the multipath of an aircraft;
    omitted: by its name, orbits and clocks none"""


class GroundStationErrorSection(Section):
    """Errors of a GBAS ground station's corrections, as large as ICAO Annex 10 allows (tables B-74 and B-75)."""

    receivers: Annotated[int, Field(ge=2, le=4)]
    """number of reference receivers, whose mean is the correction"""
    accuracy_designator: Literal["A", "B", "C"]
    """ground accuracy designator (GAD)"""
    correlation_time_s: CorrelationTime
    """correlation time, for which no standard has a value"""

    def model(self) -> GroundStationError:
        """The errors of the corrections."""
        from navsim.gnss.ground_accuracy import GroundStationError

        return GroundStationError(self.receivers, self.accuracy_designator, self.correlation_time_s)


class CorrelatedErrorsSection(Section):
    """Time-correlated errors of satellites in the pseudoranges that the receiver uses; omitted kinds are absent, except
    the preset's."""

    orbit_clock: CorrelatedErrorSection | None = None
    """residual errors of broadcast orbits and clocks"""
    ionosphere: CorrelatedErrorSection | None = None
    """residual errors after the receiver's model of the ionosphere"""
    troposphere: CorrelatedErrorSection | None = None
    """residual errors after the receiver's model of the troposphere"""
    multipath: CorrelatedErrorSection | None = None
    """reflections, of the aircraft itself and of the ground"""
    ground_station: GroundStationErrorSection | None = None
    """errors of the corrections of a GBAS ground station, for satellites of GPS and GLONASS"""

    def models(self) -> tuple[CorrelatedError | GroundStationError, ...]:
        """Kinds of errors that are present."""
        from navsim.gnss.correlated_errors import CorrelatedError

        own: dict[str, Mapping] = {
            "orbit_clock": "none", "ionosphere": "ionosphere", "troposphere": "troposphere", "multipath": "multipath",
        }  # fmt: skip
        out: list[CorrelatedError | GroundStationError] = []
        for name, mapping in own.items():
            section: CorrelatedErrorSection | None = getattr(self, name)
            if section is not None and section.sigma_m > 0.0:
                out.append(
                    CorrelatedError(name, section.sigma_m, section.correlation_time_s, section.mapping or mapping)
                )
        return (*out, *(() if self.ground_station is None else (self.ground_station.model(),)))


class CodeTrackingSection(Section):
    """The code loop; with `range_law: cn0` it makes the noise of satellite ranges, and of multipath the error."""

    spacing_chips: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.5
    """spacing of the early and the late correlator"""
    bandwidth_hz: Annotated[float, Field(ge=1e-4, le=1e4)] = 1.0
    """one-sided noise bandwidth of the code loop"""
    integration_s: Annotated[float, Field(ge=1e-6, le=1.0)] = 0.02
    """coherent integration time of the correlators"""
    gain_horizon_db: Annotated[float, Field(ge=-40.0, le=0.0)] = -10.0
    """gain of the receiving antenna at its horizon relative to the zenith, where cn0_dbhz is meant"""

    def loop(self) -> CodeLoop:
        """The code loop."""
        from navsim.gnss.dll import CodeLoop

        return CodeLoop(self.spacing_chips, self.bandwidth_hz, self.integration_s)


class GroundMultipath(Section):
    """Reflection of the pseudolites' signals by flat ground at the runway's height: two rays, Fresnel's coefficients,
    antenna gain. The code is off by it, and the carrier to noise density ratio fades; masts are as high as
    `height_m`."""

    permittivity: Annotated[float, Field(ge=1.0, le=100.0)] = 15.0
    """relative permittivity of the ground; ITU-R P.527: 3 dry sand, 15 medium soil, 30 wet soil, 80 water"""
    conductivity_s_m: NonNegative = 0.035
    """conductivity of the ground: 1e-3 dry, 0.035 medium, 0.1 wet"""
    polarisation: Literal["circular", "vertical", "horizontal"] = "circular"
    """of the signals and both antennas; circular: the part of the reflection of the same sense is received"""

    def model(self, height: float, horizon_db: float) -> GroundReflection:
        """The reflection by ground at a height, m, into an antenna of this gain at its horizon."""
        from navsim.gnss.dll import GroundReflection

        return GroundReflection(height, self.permittivity, self.conductivity_s_m, horizon_db, self.polarisation)


Gain = Annotated[float, Field(ge=-100.0, le=100.0)]
"""Antenna gain, dB."""


def check_rising(values: tuple[float, ...], key: str) -> None:
    for i, (one, other) in enumerate(itertools.pairwise(values), 1):
        if other <= one:
            raise reject(f"{other:g} does not come after {one:g}: they have to rise", key, i)


class AntennaSection(Section):
    """The aircraft's antenna, which turns with the aircraft: gain by elevation over its own horizon."""

    mount: Literal["top", "belly"] = "top"
    """top: its axis is up in body axes; belly: down"""
    elevation_deg: Annotated[ListOf[Elevation], Field(min_length=2, max_length=200)] = (0.0, 90.0)
    """elevations over its own horizon, increasing; linear between them, constant beyond the last"""
    gain_dbi: Annotated[ListOf[Gain], Field(min_length=2, max_length=200)] = (0.0, 0.0)
    """gain at each of them. Satellites have the difference to that at 90, where cn0_dbhz is meant"""
    mask_deg: Elevation = -90.0
    """elevation over its own horizon below which the aircraft shadows it: nothing is received; -90: nowhere"""

    @model_validator(mode="after")
    def _table(self) -> Self:
        if len(self.gain_dbi) != len(self.elevation_deg):
            raise reject(f"has {len(self.gain_dbi)} values, elevation_deg has {len(self.elevation_deg)}", "gain_dbi")
        check_rising(self.elevation_deg, "elevation_deg")
        return self

    def model(self) -> AircraftAntenna:
        """The antenna."""
        import numpy as np

        from navsim.gnss.antenna import AircraftAntenna

        up = np.array([0.0, 0.0, -1.0 if self.mount == "top" else 1.0])
        return AircraftAntenna(np.array(self.elevation_deg) * DEG, np.array(self.gain_dbi), up, self.mask_deg * DEG)


class SignalsSection(Section):
    """Errors of the ranging signals of satellites."""

    preset: Literal["white", "open-sky", "sbas", "differential"] = "white"
    """defaults of range_sigma_m, range_law and errors. In order: the paper's white noise; a receiver alone; one with
    satellite-based augmentation; one with corrections of a station at the aerodrome"""
    from_: str | None = Field(default=None, alias="from", exclude=True)
    """result of `navsim replay` with white noise and lasting errors of the receiver, where no key gives them. The
    stored scenario has the numbers"""
    hdop: Annotated[float, Field(ge=0.1, le=100.0)] | None = None
    """horizontal dilution of precision (HDOP) during that recording, for results of `coupling: loose`: a range has
    sqrt(2) / HDOP of the error of a position along north or east"""
    range_sigma_m: Sigma = 2.23606797749979
    """1 sigma of the white noise of pseudoranges at the zenith (the paper's variance of 5 m2)"""
    range_law: Literal["constant", "inverse-sine", "exponential", "cn0"] = "inverse-sine"
    """growth towards the horizon; cn0: thermal noise of the code loop, from cn0_dbhz and the antenna's gain"""
    range_scale_deg: Annotated[float, Field(ge=0.1, le=1000.0)] = 10.0
    """scale of the exponential law"""
    range_rate_sigma_m_s: Sigma = 0.1
    """1 sigma of the white noise of range rates of satellites"""
    cn0_dbhz: Annotated[float, Field(ge=10.0, le=80.0)] = 45.0
    """carrier to noise density ratio, reported with the measurements; with `range_law: cn0` at the zenith"""
    tracking: CodeTrackingSection = CodeTrackingSection()
    """the code loop of the receiver"""
    ionosphere: IonosphereSection | None = None
    """delay of the ionosphere; left out: none"""
    troposphere: TroposphereSection | None = None
    """delay of the troposphere; left out: none"""
    ephemeris: Ephemeris | None = None
    """errors of orbits and clocks; left out: none"""
    errors: CorrelatedErrorsSection = CorrelatedErrorsSection()
    """time-correlated errors from any cause, in place of the preset's"""
    gps_offset_ns: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    """GPS time less GLONASS time, which a receiver with a clock unknown for each does not notice"""
    system_offsets_ns: dict[Name, Annotated[float, Field(ge=-1e9, le=1e9)] | Literal["broadcast"]] = Field(
        default_factory=dict
    )
    """time of other systems less GLONASS time, by name, with the receiver's own bias between their signals. The word
    broadcast, without such a bias: gps_offset_ns, and for galileo or qzss the header of sky.navigation. The stored
    scenario has the number"""
    system_offset_sigma_ns: NonNegative = 0.0
    """1 sigma of the random offset, in each run, of each system from the first of the sky; for `single_clock`"""

    @model_validator(mode="after")
    def _others(self) -> Self:
        if self.hdop is not None:
            raise reject("is for signals.from", "hdop")
        for system, why in ((GLONASS, "the others are counted from it"), (GPS, "that of GPS is signals.gps_offset_ns")):
            if system.name in self.system_offsets_ns:
                raise reject(why, "system_offsets_ns", system.name)
        return self

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if not isinstance(data, dict):
            return data
        preset = SIGNAL_PRESETS.get(str(data.get("preset", "white")))  # any value is possible, also a list
        if not preset:
            return data
        errors = data.get("errors", {})
        filled = {**preset, **data}
        if isinstance(errors, dict):
            filled["errors"] = {
                name: {**values, **errors.get(name, {})} if isinstance(errors.get(name, {}), dict) else errors[name]
                for name, values in preset["errors"].items()
            }
            filled["errors"] |= {name: given for name, given in errors.items() if name not in preset["errors"]}
        return filled

    def law(self) -> ErrorLaw:
        """Increase of the noise of satellite signals towards the horizon."""
        from navsim.gnss.signals import ErrorLaw

        scale = self.range_scale_deg * DEG
        return ErrorLaw(self.range_law, self.range_sigma_m, scale, self.range_rate_sigma_m_s, self.cn0_dbhz)

    def offsets(self) -> tuple[float, ...]:
        """Offsets of time scales in the pseudoranges of each clock, m."""
        from navsim.geodesy.earth import SPEED_OF_LIGHT

        # a clock ahead of the other makes its signals seem to come earlier
        ahead = {GPS.name: self.gps_offset_ns}
        for name, value in self.system_offsets_ns.items():
            assert value != "broadcast", "files have been read"
            ahead[name] = value
        return tuple(-SPEED_OF_LIGHT * ahead[c] * 1e-9 if c in ahead else 0.0 for c in CLOCKS)


class ClockNoise(Section):
    """Noise of a receiver's oscillator by its Allan variance coefficients; left out: a TCXO (Brown & Hwang)."""

    h0: Annotated[float, Field(ge=0.0, le=1e-12)] = 2e-19
    """white frequency noise, Allan variance coefficient, s"""
    h_minus2: Annotated[float, Field(ge=0.0, le=1e-12)] = 2e-20
    """random walk of the frequency, Allan variance coefficient, 1/s"""

    def densities(self) -> tuple[float, float]:
        """Densities of the white noises of phase, m2/s, and frequency, m2/s3."""
        from navsim.gnss.clock_noise import densities

        return densities(self.h0, self.h_minus2)


class ReceiverSection(Section):
    """The satellite receiver: epochs, antenna, clock."""

    rate_hz: Annotated[float, Field(ge=1e-3, le=100.0)] = 10.0
    """fixes a second"""
    latency_s: FixLatency = 0.0
    """delay from the time a fix is valid to the time the filter gets it"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """lever arm from the IMU to the antenna: forward, right, down"""
    clock_offset_us: Signed = 100.0
    """offset of the receiver's clock at time 0"""
    clock_drift_ppb: Signed = 50.0
    """constant frequency offset of the receiver's clock"""
    clock: ClockNoise | None = None
    """noise of the clock; omitted: that of `{}` if the filter is tightly coupled, else none, since every fix solves for
    the clock anew"""
    smoothing_s: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """memory of the carrier-smoothed code; 0: bare code"""
    noise_figure_db: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    """noise figure of the receiver and its cables, over 290 K, the reference of carrier-to-noise density ratios"""
    antenna: AntennaSection | None = None
    """the antenna's gain in body axes; left out: that of signals.tracking.gain_horizon_db, however the aircraft lies"""
    single_clock: bool = False
    """treat all time scales as one: one unknown less, and gps_offset_ns has an effect"""
    fix_states: FixStatesSection | None = None
    """fixes of a receiver with carrier ambiguities (RTK), whose state changes; null: fixes follow from the ranges"""

    def model(self, clock: ClockNoise | None = None) -> Receiver:
        """The receiver in SI units; clock: its noise where the section leaves it out, if any."""
        from navsim.gnss.receiver import Receiver

        clock = self.clock or clock

        return Receiver(
            self.rate_hz,
            self.latency_s,
            self.clock_offset_us * 1e-6,
            self.clock_drift_ppb * 1e-9,
            (0.0, 0.0) if clock is None else clock.densities(),
            None if self.fix_states is None else self.fix_states.model(),
        )
