"""What pseudolites and beacons have in common: sites, clocks, the air between them and the aircraft."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario_files.base import Latitude, Longitude, Section, Signed, SourceName, reject

if TYPE_CHECKING:
    from navsim.gnss import signal_errors


class Site(Section):
    """One pseudolite or beacon, by s_m and l1_m or by coordinates."""

    name: SourceName | None = None
    """name; left out: PL or B and its number"""
    s_m: Signed | None = None
    """distance from the runway axis, positive to the right in the runway frame"""
    l1_m: Signed | None = None
    """distance before the threshold"""
    lat_deg: Latitude | None = None
    """geodetic latitude"""
    lon_deg: Longitude | None = None
    """longitude, east positive"""
    height_m: Signed | None = None
    """height of the antenna above the runway; left out: height_m of the section"""

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
        by_runway = (self.s_m is not None, self.l1_m is not None)
        by_point = (self.lat_deg is not None, self.lon_deg is not None)
        if not ((all(by_runway) and not any(by_point)) or (all(by_point) and not any(by_runway))):
            raise reject("give either s_m and l1_m, or lat_deg and lon_deg")
        return self


Oscillator = Literal["quartz", "tcxo", "ocxo", "rubidium"]


class ClockModel(Section):
    """Noise of a clock: an oscillator, or Allan variance coefficients."""

    oscillator: Oscillator | None = None
    """a usual oscillator"""
    h0: Annotated[float, Field(ge=0.0, le=1e-12)] | None = None
    """white frequency noise, Allan variance coefficient, s; h0/(2 t) of the Allan variance"""
    h_minus2: Annotated[float, Field(ge=0.0, le=1e-12)] | None = None
    """random walk of the frequency, Allan variance coefficient, 1/s; (2 pi)^2 h_minus2 t/6 of the Allan variance"""

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = (self.h0 is not None, self.h_minus2 is not None)
        if any(given) != all(given) or (self.oscillator is None) != all(given):
            raise reject("give an oscillator, or h0 and h_minus2", "oscillator")
        return self

    def densities(self) -> tuple[float, float]:
        """Densities of the white noises of phase, m2/s, and frequency, m2/s3."""
        from navsim.gnss.clock_noise import OSCILLATORS, densities

        if self.oscillator is not None:
            return densities(*OSCILLATORS[self.oscillator])
        return densities(float(self.h0 or 0.0), float(self.h_minus2 or 0.0))


class GroundAirSection(Section):
    """Delay by the air between pseudolites and the aircraft; refractivity falls with height by the reference atmosphere
    of ITU-R P.453."""

    truth_refractivity_n: Annotated[float, Field(ge=0.0, le=600.0)] = 320.0
    """true refractivity at the runway; 77.6 p/T + 3.73e5 e/T2 of the pressure p and that of water vapour e, hPa, at the
    temperature T, K"""
    correction: Literal["none", "refractivity"] = "none"
    """the receiver's correction: none, or the delay by corrected_refractivity_n"""
    corrected_refractivity_n: Annotated[float, Field(ge=0.0, le=600.0)] = 315.0
    """refractivity at the runway that the receiver assumes"""
    refractivity_sigma_n: Annotated[float, Field(ge=0.0, le=200.0)] = 0.0
    """1 sigma of the true refractivity at the runway from run to run, the same on all paths; 30 to 60 from day to day.
    truth_refractivity_n is its mean"""

    @model_validator(mode="after")
    def _used(self) -> Self:
        assumed = type(self).model_fields["corrected_refractivity_n"].default
        if self.correction == "none" and self.corrected_refractivity_n != assumed:  # stored scenarios have every key
            raise reject("is for `correction: refractivity`", "corrected_refractivity_n")
        return self

    def model(self, height: float) -> signal_errors.GroundAir:
        """Model of its effect; height: of the runway, ellipsoidal, m."""
        from navsim.gnss import signal_errors

        corrected = 0.0 if self.correction == "none" else self.corrected_refractivity_n
        return signal_errors.GroundAir(self.truth_refractivity_n, corrected, height)
