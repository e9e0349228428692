"""Pseudolites: places, clocks, signals, corrections that they send: section `pseudolites`."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.gnss.constellations.systems import CLOCKS, first_time_scale
from navsim.scenario.signals import Gain, GroundMultipath, check_rising
from navsim.scenario.sky import Clock
from navsim.scenario.transmitters import ClockModel, GroundAirSection, Site
from navsim.scenario_files.base import (
    DEG,
    Azimuth,
    DistinctListOf,
    Elevation,
    ListOf,
    NonNegative,
    Section,
    Sigma,
    Signed,
    Size,
    Triple,
    reject,
    whole,
)

if TYPE_CHECKING:
    import numpy as np

    from navsim.gnss import signal_errors
    from navsim.gnss.antenna import GroundPattern
    from navsim.gnss.pseudolite_clock import TransmitterErrors
    from navsim.gnss.signals import Pseudolites


class CorrectionLinkSection(Section):
    """The data link of the corrections: pseudolites send them, and they arrive while one of these is received."""

    senders: Annotated[DistinctListOf[str], Field(min_length=1)] | None = None
    """names of the pseudolites that send them; default: all"""
    rate_hz: Annotated[float, Field(ge=0.01, le=20.0)] = 1.0
    """messages a second, each with the corrections of all satellites"""
    max_age_s: Annotated[float, Field(gt=0.0, le=600.0)] = 30.0
    """the receiver uses no older corrections, and its ranges then keep their whole errors"""
    loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """share of messages that are lost, drawn for each run"""


class Differential(Section):
    """Corrections from a station at the pseudolite's site: the errors that it measures for each satellite."""

    latency_s: Annotated[float, Field(ge=0.0, le=60.0)] = 1.0
    """age of the corrections"""
    sigma_m: NonNegative = 0.3
    """1 sigma of the station's own noise in them"""
    site: str | None = None
    """name of the pseudolite whose site has the station; default: the first"""
    link: CorrectionLinkSection | None = None
    """how they reach the aircraft; left out: at all times"""

    @model_validator(mode="after")
    def _check_ages(self) -> Self:
        if self.link is not None and not self.link.max_age_s > self.latency_s:
            raise reject(
                f"{self.link.max_age_s:g} s: corrections arrive {self.latency_s:g} s old (latency_s), so none would "
                "be used; give more", "link", "max_age_s",
            )  # fmt: skip
        return self

    def model(self, pseudolites: Pseudolites) -> signal_errors.DifferentialStation:
        """The station among these pseudolites."""
        from navsim.gnss import signal_errors

        at = pseudolites.names.index(self.site) if self.site else 0
        link = None
        if self.link is not None:
            from navsim.gnss.correction_link import CorrectionLink

            senders = tuple(pseudolites.names) if self.link.senders is None else self.link.senders
            link = CorrectionLink(senders, 1.0 / self.link.rate_hz, self.link.max_age_s, self.link.loss)
        return signal_errors.DifferentialStation(pseudolites.llh[at], self.latency_s, self.sigma_m, link)


class PatternSection(Section):
    """Antenna pattern of pseudolites: gain by azimuth and elevation, relative to eirp_dbm."""

    azimuth_deg: Annotated[ListOf[Azimuth], Field(min_length=1, max_length=360)] = (0.0,)
    """azimuths from north, rising, within one turn; straight between them, all around; one: the same everywhere"""
    elevation_deg: Annotated[ListOf[Elevation], Field(min_length=2, max_length=200)]
    """elevations, increasing; linear between them, constant beyond the last"""
    gain_db: Annotated[ListOf[ListOf[Gain]], Field(min_length=1, max_length=360)]
    """for each azimuth a list, of each elevation"""

    @model_validator(mode="after")
    def _table(self) -> Self:
        check_rising(self.azimuth_deg, "azimuth_deg")
        check_rising(self.elevation_deg, "elevation_deg")
        if self.azimuth_deg[-1] - self.azimuth_deg[0] >= 360.0:
            raise reject("360 is 0 again: leave it out", "azimuth_deg", len(self.azimuth_deg) - 1)
        if len(self.gain_db) != len(self.azimuth_deg):
            raise reject(f"has {len(self.gain_db)} lists, azimuth_deg has {len(self.azimuth_deg)} values", "gain_db")
        for i, row in enumerate(self.gain_db):
            if len(row) != len(self.elevation_deg):
                raise reject(f"has {len(row)} values, elevation_deg has {len(self.elevation_deg)}", "gain_db", i)
        return self

    def model(self) -> GroundPattern:
        """The pattern."""
        import numpy as np

        from navsim.gnss.antenna import GroundPattern

        return GroundPattern(
            np.array(self.azimuth_deg) * DEG, np.array(self.elevation_deg) * DEG, np.array(self.gain_db)
        )


class ClockNoiseSection(ClockModel):
    """Noise of each pseudolite's clock, by its oscillator or the Allan variance coefficients of that; it begins
    clock_age_s before time 0, and is drawn for each run and pseudolite. The receiver weights ranges and range rates by
    it."""

    @model_validator(mode="after")
    def _some(self) -> Self:
        if self.h0 == self.h_minus2 == 0.0:
            raise reject("clocks without noise do not wander: leave clock_noise out", "h0")
        return self


class FilterPseudolites(Section):
    """Errors of pseudolites in the filter model; omitted keys: those of `pseudolites`."""

    survey_sigma_m: NonNegative | None = None
    """1 sigma, along each axis, of the position error of each pseudolite"""
    range_bias_sigma_m: NonNegative | None = None
    """1 sigma of the constant error of each pseudolite's ranges"""
    clock_sigma_ns: NonNegative | None = None
    """1 sigma of each clock error that is constant over a run"""
    clock_drift_sigma_ppb: NonNegative | None = None
    """1 sigma of each clock's frequency error when it was set"""
    clock_noise: ClockNoiseSection | None = None
    """noise of each clock"""
    refractivity_sigma_n: Annotated[float, Field(ge=0.0, le=200.0)] | None = None
    """1 sigma of the refractivity that the receiver's correction leaves, the same for all pseudolites; needs
    pseudolites.air"""


class PseudolitesSection(Section):
    """Transmitters at the runway: none, one at +S, two at +-S, or any number by `sites`."""

    count: Annotated[Literal[0, 1, 2], whole] = 0
    """one at +s_m, two at +s_m and -s_m, all l1_m before the threshold"""
    s_m: Signed | None = None
    """distance from the runway axis, with `count`"""
    l1_m: Signed | None = None
    """distance before the threshold, with `count`"""
    sites: ListOf[Site] = ()
    """instead of count, s_m and l1_m: a list of pseudolites"""
    frame: Literal["table1", "runway"] = "runway"
    """table1: the coordinates the paper's Table 1 computes from s_m and l1_m; runway: s_m across, l1_m along"""
    height_m: Signed = 0.0
    """height of the antennas above the runway (its threshold), not above the ellipsoid or sea level"""
    clock: Clock | None = None
    """time scale the pseudolites keep; own: a separate one, with its own clock unknown; left out: that of the
    satellites in use, of several systems the first in the order GLONASS, GPS, Galileo, BeiDou, QZSS"""
    clock_offset_ns: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    """offset of the transmitters' clocks from that scale, unknown to the receiver"""
    survey_error_m: Triple = (0.0, 0.0, 0.0)
    """true minus surveyed position: north, east, down"""
    survey_sigma_m: NonNegative = 0.0
    """1 sigma, along each axis, of the random true minus surveyed position of each pseudolite in each run, in addition
    to survey_error_m; the receiver weights the ranges with it"""
    clock_sigma_ns: NonNegative = 0.0
    """1 sigma of each pseudolite's clock error after calibration, drawn for each run; the receiver weights their ranges
    by it"""
    range_bias_sigma_m: NonNegative = 0.0
    """1 sigma of the constant error of each pseudolite's ranges (hardware delay, calibration), drawn for each run; the
    receiver weights their ranges by it"""
    clock_drift_sigma_ppb: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    """1 sigma of the frequency error that each pseudolite's clock was set with, drawn for each run; the receiver
    weights ranges and range rates by it"""
    clock_noise: ClockNoiseSection | None = None
    """how the pseudolites' clocks wander from where calibration left them; null: not at all"""
    clock_age_s: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    """how long before time 0 the clocks were set, offset and rate, with clock_noise or clock_drift_sigma_ppb; left out:
    0"""
    range_sigma_m: Sigma = 2.23606797749979
    """1 sigma of the white noise of their pseudoranges"""
    range_law: Literal["constant", "cn0"] = "constant"
    """constant: range_sigma_m; cn0: thermal noise of the code loop at their carrier to noise density ratio"""
    range_rate_sigma_m_s: Sigma = 0.1
    """1 sigma of the white noise of their range rates"""
    cn0_dbhz: Annotated[float, Field(ge=10.0, le=80.0)] = 45.0
    """carrier to noise density ratio, reported with the measurements; without eirp_dbm"""
    cn0_reference_m: Size | None = None
    """distance at which cn0_dbhz is meant; it then falls with distance. Left out: the same everywhere"""
    eirp_dbm: Annotated[float, Field(ge=-150.0, le=100.0)] | None = None
    """equivalent isotropically radiated power, of pulses while they last: the carrier to noise density ratio follows
    from it, the distance, both antennas and receiver.noise_figure_db. Omitted: cn0_dbhz"""
    pattern: PatternSection | None = None
    """antenna pattern, with eirp_dbm; omitted: isotropic"""
    carrier_mhz: Annotated[float, Field(ge=1000.0, le=2000.0)] = 1575.42
    """carrier of their signals, which have the chips of GPS"""
    multipath: GroundMultipath | None = None
    """reflection by the ground; left out: none"""
    air: GroundAirSection | None = None
    """delay by the air on the way to the aircraft; left out: none"""
    differential: Differential | None = None
    """corrections for satellites; left out: none"""

    @model_validator(mode="before")
    @classmethod
    def _counted(cls, data: Any) -> Any:
        """Say how more than two are given."""
        count = data.get("count") if isinstance(data, dict) else None
        if isinstance(count, int) and count > 2:
            text = f"{count} is not allowed: s_m and l1_m place one or two"
            raise reject(f"{text}; list more in `sites: [{{s_m: ..., l1_m: ...}}, ...]`", "count")
        return data

    @model_validator(mode="after")
    def _strength(self) -> Self:
        if self.eirp_dbm is None and self.pattern is not None:
            raise reject("is relative to eirp_dbm, which is not given", "pattern")
        if self.clock_noise is None and not self.clock_drift_sigma_ppb and self.clock_age_s is not None:
            raise reject("is for clock_noise or clock_drift_sigma_ppb; give one, or leave it out", "clock_age_s")
        if self.eirp_dbm is not None and self.cn0_reference_m is not None:
            raise reject("is for cn0_dbhz; with eirp_dbm the strength follows from that", "cn0_reference_m")
        return self

    @model_validator(mode="after")
    def _station(self) -> Self:
        if self.differential is not None:
            if not self.placed():
                raise reject("corrections come from a pseudolite's site, and there is none", "differential")
            link, there_are = self.differential.link, ", ".join(self.names())
            named = [(self.differential.site, "site")]
            named += [] if link is None else [(name, "link") for name in link.senders or ()]
            for name, key in named:
                if name is not None and name not in self.names():
                    raise reject(f"no pseudolite is named '{name}'; there are {there_are}", "differential", key)
        return self

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
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
                    raise reject(f"count {self.count} needs both s_m and l1_m", key)
        return self

    def with_clock(self, used: Collection[str]) -> Self:
        """Copy with a time scale: by default the first of the satellites', by the names of those in use."""
        return self if self.clock else self.model_copy(update={"clock": first_time_scale(used)})

    @property
    def strength_known(self) -> bool:
        """Whether it is known how strong they are at any distance."""
        return self.eirp_dbm is not None or self.cn0_reference_m is not None

    def unused(self) -> list[str]:
        """Keys without effect, or that suppress signals, as messages."""
        out = []
        if self.eirp_dbm is not None and self.cn0_dbhz != type(self).model_fields["cn0_dbhz"].default:
            out.append("pseudolites.cn0_dbhz: not used, the strength follows from eirp_dbm")
        if self.multipath is not None:
            heights = [self.height_m if site.height_m is None else site.height_m for site in self.placed()]
            if low := [name for name, height in zip(self.names(), heights, strict=True) if height <= 0.0]:
                out.append(
                    f"pseudolites.multipath: {', '.join(low)} at no height above the ground, whose reflection takes "
                    "most of such a signal; give height_m of the antenna"
                )
        return out

    def placed(self) -> tuple[Site, ...]:
        """Every pseudolite as a separate site."""
        if self.sites:
            return self.sites
        if not self.count:
            return ()
        assert self.s_m is not None  # checked with count
        return tuple(Site(s_m=sign * self.s_m, l1_m=self.l1_m) for sign in (1.0, -1.0)[: self.count])

    def names(self) -> tuple[str, ...]:
        """PL1, PL2, ... or the names given."""
        return tuple(site.name or f"PL{i}" for i, site in enumerate(self.placed(), 1))

    @property
    def drawn(self) -> tuple[str, ...]:
        """Keys of errors that are drawn and last over a run, of pseudolites that are there or that a study adds."""
        keys = ("survey_sigma_m", "range_bias_sigma_m", "clock_sigma_ns", "clock_drift_sigma_ppb", "clock_noise")
        own = ("air.refractivity_sigma_n",) if self.air is not None and self.air.refractivity_sigma_n else ()
        return (*(key for key in keys if getattr(self, key)), *own)

    def errors(self, given: FilterPseudolites | None = None) -> TransmitterErrors:
        """Sizes of the errors that are drawn for each run; given: those in a filter model."""
        from navsim.geodesy.earth import SPEED_OF_LIGHT
        from navsim.gnss.pseudolite_clock import TransmitterErrors

        def size(key: str) -> float:
            its = None if given is None else getattr(given, key)
            return float(getattr(self, key) if its is None else its)

        noise = self.clock_noise if given is None or given.clock_noise is None else given.clock_noise
        return TransmitterErrors(
            size("survey_sigma_m"), SPEED_OF_LIGHT * size("clock_sigma_ns") * 1e-9,
            SPEED_OF_LIGHT * size("clock_drift_sigma_ppb") * 1e-9,
            (0.0, 0.0) if noise is None else noise.densities(), 0.0 if self.clock_age_s is None else self.clock_age_s,
            size("range_bias_sigma_m"), self._refractivity_sigma(given),
        )  # fmt: skip

    def _refractivity_sigma(self, given: FilterPseudolites | None) -> float:
        """1 sigma of the drawn refractivity, N-units; given: that in a filter model."""
        if self.air is None:
            return 0.0
        its = None if given is None else given.refractivity_sigma_n
        return self.air.refractivity_sigma_n if its is None else its

    def model(self, llh: np.ndarray) -> Pseudolites:
        """The transmitters at surveyed positions (p, 3), rad, rad, m."""
        import numpy as np

        from navsim.geodesy.earth import SPEED_OF_LIGHT
        from navsim.gnss.signals import Pseudolites, Radiated

        assert self.clock is not None  # once it is known which satellites there are
        return Pseudolites(
            names=self.names(),
            llh=llh,
            survey_error=np.array(self.survey_error_m),
            time_scale=CLOCKS.index(self.clock),
            # a transmitter ahead of its time scale is received too early
            delay=-SPEED_OF_LIGHT * self.clock_offset_ns * 1e-9,
            sigma=self.range_sigma_m,
            rate_sigma=self.range_rate_sigma_m_s,
            cn0=self.cn0_dbhz,
            carrier=self.carrier_mhz * 1e6,
            errors=self.errors(),
            radiated=None
            if self.eirp_dbm is None
            else Radiated(self.eirp_dbm - 30.0, None if self.pattern is None else self.pattern.model()),
        )
