"""Ranging beacons: section `beacons`, and `filter.beacons`, the filter's model of them."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.aiding_sensors import AidingSection, FilterAidingSection, Late
from navsim.scenario.estimated_errors import watches_filter
from navsim.scenario.events import SpoofSection
from navsim.scenario.signals import ClockNoise, Gain
from navsim.scenario.terrain import terrain_of
from navsim.scenario.transmitters import GroundAirSection, Site
from navsim.scenario_files.base import DEG, ListOf, NonNegative, Section, Sigma, Signed, Triple, reject
from navsim.scenario_files.presets import BEACON_LACKS, BEACON_PRESETS

if TYPE_CHECKING:
    from navsim.gnss.events import Event
    from navsim.gnss.interference.jamming import LinkJamming
    from navsim.gnss.pseudolite_clock import TransmitterErrors
    from navsim.scenario.landing import Landing
    from navsim.sensors.beacons import BeaconErrors, Beacons, Outliers

Part = Annotated[float, Field(ge=0.0, le=0.5)]
_MATCHED = 1.0
"""Half of the band of a jammer whose width is not given, MHz."""
_LINK = ("eirp_dbm", "sensitivity_dbm")
"""Keys of the link budget that have no default."""


_OUTLIERS = ("outlier_share", "outlier_sigma_m"), ("long_share", "long_m")
"""Keys of the share and the size of each kind of outlier."""


class BeaconClock(ClockNoise):
    """The receiver's clock in one-way ranges, against the time base that the beacons share. Its noise is that of a TCXO
    (Brown & Hwang) unless given."""

    offset_sigma_us: Annotated[float, Field(gt=0.0, le=30.0)] = 10.0
    """1 sigma of its offset at time 0; with GNSS time at both ends a microsecond or less"""
    drift_sigma_ppb: Annotated[float, Field(gt=0.0, le=1e4)] = 100.0
    """1 sigma of its frequency offset at time 0"""

    @model_validator(mode="after")
    def _check_noise(self) -> Self:
        if not self.h0 or not self.h_minus2:
            raise reject("a clock without noise is none; give both above 0", "h0" if not self.h0 else "h_minus2")
        return self

    def model(self) -> TransmitterErrors:
        """Its errors, m and m/s."""
        from navsim.geodesy.earth import SPEED_OF_LIGHT
        from navsim.gnss.pseudolite_clock import TransmitterErrors

        offset, rate = self.offset_sigma_us * 1e-6, self.drift_sigma_ppb * 1e-9
        return TransmitterErrors(offset=SPEED_OF_LIGHT * offset, rate=SPEED_OF_LIGHT * rate, density=self.densities())


class BeaconsSection(AidingSection):
    """Ranging beacons on the ground: two-way time of flight, without the receiver's clock, or one-way ranges with it.
    The vehicle asks one beacon after the other. Errors are drawn for each beacon and run."""

    preset: Literal["none", "uwb", "sx1280", "radio-868", "radio-915", "long-range"] = "none"
    """defaults of noise, bias and link, which keys here replace; none: the keys here alone. Measured are uwb,
    ultra-wideband modules outdoors in line of sight, and the bias of sx1280, LoRa ranging at 2.4 GHz, which needs
    sigma_m. Telemetry radios, radio-868 and radio-915, have a link budget, and long-range the band of 500 to 1000 MHz.
    Their sigma_m, 30 m, is unverified: PX4 assumes it by default. They need bias_sigma_m"""
    sites: Annotated[ListOf[Site], Field(min_length=1, max_length=50)]
    """the beacons, each with s_m and l1_m in runway axes, or with coordinates; names left out: B and a number"""
    height_m: Signed = 0.0
    """height of their antennas above the runway"""
    rate_hz: Annotated[float, Field(ge=0.1, le=1000.0)]
    """questions a second, to all beacons together: each is asked at this rate over their number"""
    carrier_mhz: Annotated[float, Field(ge=100.0, le=1e4)] | None = None
    """carrier, for the link budget and for jamming"""
    bandwidth_mhz: Annotated[float, Field(ge=1e-3, le=1e4)] | None = None
    """noise bandwidth of the signals, for jamming; with carrier_mhz jammers reach questions and answers"""
    noise_figure_db: NonNegative = 6.0
    """noise figure of the receivers at both ends, for jamming"""
    eirp_dbm: Annotated[float, Field(ge=-150.0, le=100.0)] | None = None
    """equivalent isotropically radiated power of the weaker side of the link; with sensitivity_dbm and carrier_mhz it
    gives the largest range"""
    gain_dbi: Gain = 0.0
    """gain of the receiving antenna, for the link budget and for jamming"""
    sensitivity_dbm: Annotated[float, Field(ge=-200.0, le=50.0)] | None = None
    """received power below which there is no answer"""
    range_limit_m: Annotated[float, Field(ge=1.0, le=1e6)] | None = None
    """largest range, in place of a link budget"""
    sigma_m: Sigma
    """1 sigma of the white noise of a range, near the beacon"""
    weak_sigma_m: NonNegative = 0.0
    """1 sigma of the further noise at the largest range; it grows with distance, as the signal's strength falls"""
    bias_sigma_m: NonNegative = 0.0
    """1 sigma of each beacon's constant bias"""
    growth_m: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """mean of the part of the bias that grows with distance d: growth_m (1 - exp(-d / growth_distance_m))"""
    growth_sigma_m: NonNegative = 0.0
    """1 sigma of that growth, from beacon to beacon"""
    growth_distance_m: Annotated[float, Field(ge=0.1, le=1e6)] = 17.0
    """distance at which that part has grown to 63 %"""
    survey_sigma_m: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0
    """1 sigma of each beacon's surveyed position along each axis"""
    loss: Annotated[float, Field(ge=0.0, le=0.99)] = 0.0
    """fraction of the questions without an answer"""
    outlier_share: Part = 0.0
    """fraction of outliers to both sides"""
    outlier_sigma_m: NonNegative = 0.0
    """1 sigma of these"""
    long_share: Part = 0.0
    """fraction of ranges that are too long, by a reflection or without line of sight"""
    long_m: NonNegative = 0.0
    """mean of how much they are too long; exponential distribution"""
    clock: BeaconClock | None = None
    """the receiver's clock: ranges are then one-way, on a time base common to the beacons, which send in turn; null:
    two-way"""
    air: GroundAirSection | None = None
    """delay by the air; null: ranges arrive without delay"""
    latency_s: Late = 0.0
    """time from a measurement to its arrival"""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """IMU to the antenna of the ranges: forward, right, down"""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        """Write the preset's values where the scenario gives none, so that the resolved scenario shows them."""
        if not isinstance(data, dict):
            return data
        name = str(data.get("preset"))
        values = BEACON_PRESETS.get(name, {})
        if data.get("range_limit_m") is not None:  # it replaces the link budget
            values = {key: value for key, value in values.items() if key not in _LINK}
        filled = {**values, **data}
        if (lacks := BEACON_LACKS.get(name)) is not None and lacks not in filled:
            what = "the noise of single ranges" if lacks == "sigma_m" else "the bias of each beacon"
            raise reject(f"no source of the preset {name} has it: give {what}, 1 sigma", lacks)
        return filled

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        names = self.names()
        for i, name in enumerate(names):
            if name in names[:i]:
                raise reject(f"two beacons are named '{name}'", "sites", i)
        link = [key for key in _LINK if getattr(self, key) is not None]
        if self.range_limit_m is not None:
            if link:
                raise reject("is for a link budget, and range_limit_m replaces it; give one of both", link[0])
        elif len(link) < len(_LINK) or self.carrier_mhz is None:
            text = "how far beacons reach is not given: give range_limit_m, or a link budget by eirp_dbm, "
            raise reject(text + "sensitivity_dbm and carrier_mhz", "range_limit_m")
        for share, size in _OUTLIERS:
            if bool(getattr(self, share)) != bool(getattr(self, size)):
                missing = size if getattr(self, share) else share
                given = share if missing == size else size
                raise reject(f"is 0, but {given} needs it: give both above 0, or neither", missing)
        return self

    def names(self) -> tuple[str, ...]:
        """B1, B2, ... or the names given."""
        return tuple(site.name or f"B{i}" for i, site in enumerate(self.sites, 1))

    @property
    def reach(self) -> float:
        """Largest range, m."""
        from navsim.sensors.beacons import largest_range

        if self.range_limit_m is not None:
            return self.range_limit_m
        assert self.eirp_dbm is not None
        assert self.sensitivity_dbm is not None
        assert self.carrier_mhz is not None
        return largest_range(self.eirp_dbm, self.gain_dbi, self.sensitivity_dbm, self.carrier_mhz * 1e6)

    def check(self, landing: Landing) -> None:
        """Raise for a filter that has no states, with keys of them, and for outliers in pushed runs."""
        if landing.method == "rare" and self.irregular:
            text = "method rare pushes Gaussian errors; use 0, or method monte-carlo"
            raise reject(text, "beacons", self.irregular)
        if landing.method == "rare" and self.clock is not None:
            raise reject("method rare does not push this clock; use method monte-carlo", "beacons", "clock")
        if self.clock is None and landing.filter.beacons.clock is not None:
            raise reject("two-way ranges have no clock; give beacons.clock, too", "filter", "beacons", "clock")
        if watches_filter(landing) and self.air is not None and self.air.refractivity_sigma_n:
            text = "lasts, and levels of integrity.method filter treat errors as independent in time; use 0"
            raise reject(text, "beacons", "air", "refractivity_sigma_n")
        drawn = self.air is not None and self.air.refractivity_sigma_n > 0.0
        if drawn and landing.pseudolites.placed() and "air.refractivity_sigma_n" in landing.pseudolites.drawn:
            text = "pseudolites.air draws it, too, and navsim would draw two airs; give it at one of them"
            raise reject(text, "beacons", "air", "refractivity_sigma_n")
        if self.air is None and landing.filter.beacons.refractivity_sigma_n:
            raise reject("ranges have no delay by air; give beacons.air", "filter", "beacons", "refractivity_sigma_n")
        self._check_events(landing)
        self._check_jammers(landing)
        its = landing.filter.beacons
        for key in () if its.errors == "states" else (*ERRORS_OF_BEACONS, "refractivity_sigma_n"):
            if getattr(its, key) is not None:
                raise reject("is for `errors: states`", "filter", "beacons", key)
        self._check_mixture(landing)
        if its.second_order and (text := second_order_refused(landing)):
            raise reject(text, "filter", "beacons", "second_order")

    def _check_mixture(self, landing: Landing) -> None:
        """Raise for a mixture without outliers, and for keys of one without it."""
        its, mine = landing.filter.beacons, self.assumed(landing).outliers()
        for share, size in _OUTLIERS:
            for key in (share, size):
                if its.outliers == "gate" and getattr(its, key) is not None:
                    raise reject("is for `outliers: mixture`", "filter", "beacons", key)
        if its.outliers == "mixture":
            if not mine.share and not mine.long_share:
                raise reject("no outliers: give long_share, or outlier_share", "filter", "beacons", "outliers")
            for kind, part, length in (("outlier", mine.share, mine.sigma), ("long", mine.long_share, mine.long)):
                if bool(part) != bool(length):
                    text = "share and size of outliers: both above 0, or neither"
                    raise reject(text, "filter", "beacons", f"{kind}_share")
            if mine.share + mine.long_share >= 1.0:
                text = "no range would be clean: shares must add up to less than 1"
                raise reject(text, "filter", "beacons", "long_share")
            watched = landing.integrity
            if watched is not None and (watched.method == "filter" or watched.innovations is not None):
                what = "method filter" if watched.method == "filter" else "innovations"
                text = f"integrity.{what} expects a filter whose gains do not depend on the ranges, as those of a "
                text += "mixture do: it would raise alarms without a fault; write gate, or leave the monitor out"
                raise reject(text, "filter", "beacons", "outliers")

    def assumed(self, landing: Landing) -> BeaconsSection:
        """The beacons as the filter assumes them."""
        its = landing.filter.beacons
        given = {key: value for key, value in its if value is not None and key in BeaconsSection.model_fields}
        if self.clock is not None and its.clock is not None:
            own = {key: value for key, value in its.clock if value is not None}
            given["clock"] = self.clock.model_copy(update=own)
        return self.model_copy(update=given)

    def _check_events(self, landing: Landing) -> None:
        """Raise for events that two-way ranges do not have."""
        from navsim.gnss.events import BEACONS

        for i, event in enumerate(landing.events):
            if not set(event.sources) & {BEACONS, *self.names()}:
                continue
            if event.what == "meacon":
                raise reject("meacon is of satellites and pseudolites; use spoof or step", "events", i, "what")
            if isinstance(event, SpoofSection) and self.clock is None:
                for key in ("clock_m", "drift_m_s"):
                    if getattr(event, key):
                        raise reject("two-way ranges have no clock; use step or ramp", "events", i, key)

    def _check_jammers(self, landing: Landing) -> None:
        """Raise for jammers on the carrier of beacons whose bandwidth is unknown."""
        if self.bandwidth_mhz is not None and self.carrier_mhz is None:
            raise reject("jamming needs the carrier, too: give carrier_mhz", "beacons", "bandwidth_mhz")
        if landing.interference is None or self.carrier_mhz is None or self.bandwidth_mhz is not None:
            return
        for jammer in landing.interference.jammers:
            half = 0.0 if jammer.bandwidth_mhz is None else 0.5 * jammer.bandwidth_mhz
            if abs(self.carrier_mhz - jammer.centre_mhz) <= max(half, _MATCHED):
                text = f"{self.carrier_mhz:g} MHz is in the band of {jammer.name}, and jamming needs the bandwidth: "
                text += "give beacons.bandwidth_mhz"
                raise reject(text, "beacons", "carrier_mhz")

    def unwatched(self, landing: Landing) -> list[str]:
        """Warnings that jammers and integrity monitors do not include beacons."""
        out = []
        if landing.interference is not None and landing.interference.jammers and self.carrier_mhz is None:
            out.append(
                "interference.jammers: none jams beacons, whose band is unknown; give beacons.carrier_mhz and "
                "beacons.bandwidth_mhz"
            )
        if landing.integrity is not None and landing.integrity.method != "filter":
            out.append(
                "integrity: its levels and alarms are of fixes, which beacons do not enter; method filter watches "
                "beacons, too"
            )
        return out

    @property
    def irregular(self) -> str | None:
        """Key of lost answers or outliers, which are no Gaussian errors; None without."""
        return next((key for key in ("loss", "outlier_share", "long_share") if getattr(self, key)), None)

    def error_without_state(self, landing: Landing) -> str | None:
        """Key of an error, if the filter does not estimate them."""
        if landing.filter.beacons.errors == "states":
            return None
        return next((key for key in ERRORS_OF_BEACONS if getattr(self, key)), None)

    def errors(self, followed: bool = True) -> BeaconErrors:
        """Errors of each beacon; followed: with the sigmas that a filter with states has."""
        from navsim.sensors.beacons import BeaconErrors

        bias, growth, survey = (self.bias_sigma_m, self.growth_sigma_m, self.survey_sigma_m) if followed else (0.0,) * 3
        return BeaconErrors(bias, self.growth_m, growth, self.growth_distance_m, survey)

    def outliers(self) -> Outliers:
        """Lost answers and outliers."""
        from navsim.sensors.beacons import Outliers

        return Outliers(self.loss, self.outlier_share, self.outlier_sigma_m, self.long_share, self.long_m)

    def model(self, landing: Landing) -> Beacons:
        """The beacons at a runway, and the filter's model of them."""
        from dataclasses import replace

        import numpy as np

        from navsim.sensors.beacons import BeaconDesign, Beacons

        its, runway, other = landing.filter.beacons, landing.runway, self.assumed(landing)
        plane, llh = np.full((len(self.sites), 2), np.nan), np.full((len(self.sites), 3), np.nan)
        for k, site in enumerate(self.sites):
            llh[k, 2] = runway.ellipsoidal_m + (self.height_m if site.height_m is None else site.height_m)
            if site.s_m is not None and site.l1_m is not None:
                plane[k] = site.s_m, site.l1_m
            elif site.lat_deg is not None and site.lon_deg is not None:
                llh[k, :2] = site.lat_deg * DEG, math.remainder(site.lon_deg, 360.0) * DEG
        assumed = BeaconDesign(
            other.sigma_m, other.weak_sigma_m, other.latency_s, np.array(other.lever_arm_m),
            other.errors(its.errors == "states"),
            replace(other.outliers(), loss=0.0) if its.outliers == "mixture" else None,
            None if other.clock is None else other.clock.model(), self._assumed_air(landing), bool(its.second_order),
        )  # fmt: skip
        return Beacons(
            self.names(), plane, llh, runway.aim_point_m, runway.ellipsoidal_m, runway.heading_deg * DEG, self.rate_hz,
            self.latency_s, self.sigma_m, self.weak_sigma_m, self.reach,
            functools.partial(terrain_of, landing.terrain), np.array(self.lever_arm_m), self.errors(),
            self.outliers(), assumed, self.happenings(landing), self.jamming(landing),
            None if self.clock is None else self.clock.model(),
            None if self.air is None else self.air.model(runway.ellipsoidal_m),
            0.0 if self.air is None else self.air.refractivity_sigma_n,
        )  # fmt: skip

    def _assumed_air(self, landing: Landing) -> float:
        """1 sigma of the refractivity in the filter model, N-units; 0 without a state."""
        its = landing.filter.beacons
        if self.air is None or its.errors != "states":
            return 0.0
        return self.air.refractivity_sigma_n if its.refractivity_sigma_n is None else its.refractivity_sigma_n

    def jamming(self, landing: Landing) -> LinkJamming | None:
        """Jammers that reach questions and answers, None without."""
        from navsim.gnss.interference.jamming import LinkJamming

        its = landing.interference
        if its is None or not its.jammers or self.carrier_mhz is None or self.bandwidth_mhz is None:
            return None
        ground = landing.runway.ellipsoidal_m
        return LinkJamming(
            its.models(ground, landing.signals.tracking), ground,
            functools.partial(terrain_of, (*landing.terrain, *its.horizon)), self.carrier_mhz * 1e6,
            self.bandwidth_mhz * 1e6, self.noise_figure_db, self.gain_dbi,
        )  # fmt: skip

    def happenings(self, landing: Landing) -> tuple[Event, ...]:
        """Events of beacons among those of a landing, whose `all` is of satellites and pseudolites."""
        from dataclasses import replace

        from navsim.gnss.events import BEACONS

        mine = {BEACONS, *self.names()}
        each = ((event, tuple(name for name in event.sources if name in mine)) for event in landing.events)
        return tuple(replace(event.model(), sources=names) for event, names in each if names)


ERRORS_OF_BEACONS = ("bias_sigma_m", "growth_sigma_m", "survey_sigma_m")
"""Keys of the errors that a filter may estimate."""


_KINDS_WITH_PRODUCTS = ("gaussian-sum", "tfg", "eskf", "left-invariant")
"""Kinds of filter that can estimate products of the position error."""


def second_order_refused(landing: Landing) -> str:
    """Why a filter, or a monitor of it, does not estimate products of the position error; "" if it can."""
    kind, watched = landing.filter.kind, landing.integrity
    if kind not in _KINDS_WITH_PRODUCTS:
        return f"{kind} has no products of the position error; use kind {', '.join(_KINDS_WITH_PRODUCTS)}"
    if watched is not None and (watched.method == "filter" or watched.innovations is not None):
        return "integrity watches filters that are linear: leave the monitor out, or `second_order: false`"
    return "" if landing.method == "monte-carlo" else "the covariance analysis is linear: use method monte-carlo"


def second_order_cure(landing: Landing) -> str:
    """All that has to change so that the filter estimates products of the position error."""
    watched, changes = landing.integrity, []
    if landing.filter.kind not in _KINDS_WITH_PRODUCTS:
        changes.append(f"use filter.kind {', '.join(_KINDS_WITH_PRODUCTS[:-1])} or {_KINDS_WITH_PRODUCTS[-1]}")
    if watched is not None and watched.method == "filter":
        changes.append("use another integrity.method than filter")
    if watched is not None and watched.innovations is not None:
        changes.append("leave integrity.innovations out")
    if landing.method != "monte-carlo":
        changes.append(f"use method monte-carlo instead of {landing.method}, which is of a linear filter")
    if not changes or landing.filter.beacons.second_order is False:
        changes.append("set filter.beacons.second_order: true")
    return f"To let the filter estimate their second order, {'; '.join(changes)}"


class FilterBeaconClock(Section):
    """The receiver's clock in the filter model of one-way ranges."""

    h0: Annotated[float, Field(gt=0.0, le=1e-12)] | None = None
    """white frequency noise in the filter model, Allan variance coefficient, s"""
    h_minus2: Annotated[float, Field(gt=0.0, le=1e-12)] | None = None
    """random walk of the frequency in the filter model, Allan variance coefficient, 1/s"""
    offset_sigma_us: Annotated[float, Field(gt=0.0, le=30.0)] | None = None
    """1 sigma of its offset at time 0 in the filter model"""
    drift_sigma_ppb: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    """1 sigma of its frequency offset at time 0 in the filter model"""


class FilterBeacons(FilterAidingSection):
    """Filter model of the beacons; omitted keys are as in `beacons`."""

    needs = "beacons: {sites: [...], rate_hz: ..., sigma_m: ..., range_limit_m: ...}"

    errors: Literal["states", "none"] = "states"
    """what the filter does about biases and survey errors: states: estimate those that it assumes, up to five for each
    beacon; none: nothing, a beacon is described by its noise alone"""
    second_order: bool | None = None
    """estimate products of the position error as six further states, so that ranges need not be linear in it. Default:
    in Monte Carlo runs whose second-order errors of ranges exceed a quarter of their noise, if the filter's kind can"""
    outliers: Literal["gate", "mixture"] = "gate"
    """what the filter does about outliers. gate: `filter.gate` alone rejects them; mixture: it weighs by how probable
    each outlier is, given the shares and sizes below, and the gate does not test beacons"""
    outlier_share: Part | None = None
    """fraction of outliers to both sides in the mixture"""
    outlier_sigma_m: NonNegative | None = None
    """1 sigma of these in the mixture"""
    long_share: Part | None = None
    """fraction of ranges that are too long in the mixture"""
    long_m: NonNegative | None = None
    """mean of how much they are too long in the mixture"""
    sigma_m: Sigma | None = None
    """1 sigma of the noise near the beacon in the filter model"""
    weak_sigma_m: NonNegative | None = None
    """1 sigma of the further noise at the largest range in the filter model"""
    bias_sigma_m: NonNegative | None = None
    """1 sigma of the constant bias in the filter model"""
    growth_m: Annotated[float, Field(ge=-100.0, le=100.0)] | None = None
    """mean of the growth of the bias in the filter model, which the filter takes off"""
    growth_sigma_m: NonNegative | None = None
    """1 sigma of that growth in the filter model"""
    growth_distance_m: Annotated[float, Field(ge=0.1, le=1e6)] | None = None
    """distance at which the bias has grown to 63 % in the filter model"""
    survey_sigma_m: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    """1 sigma of the surveyed positions in the filter model"""
    refractivity_sigma_n: Annotated[float, Field(ge=0.0, le=200.0)] | None = None
    """1 sigma of the refractivity that the correction leaves, in the filter model; needs beacons.air"""
    clock: FilterBeaconClock | None = None
    """the receiver's clock in the filter model; omitted keys are as in `beacons.clock`"""
    latency_s: Late | None = None
    """latency in the filter model"""
    lever_arm_m: Triple | None = None
    """lever arm in the filter model"""
