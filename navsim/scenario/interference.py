"""Jammers near a flight, and the receiver's tolerance: section `interference`.

Source of structure and defaults: `docs/theory/interference.md`, section 7.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.runway import Point
from navsim.scenario.terrain import RidgeSection, tops_of
from navsim.scenario_files.base import FlightTime, ListOf, NonNegative, PairOf, Section, reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.gnss.interference.horizon import Terrain
    from navsim.gnss.interference.jamming import Jammer, Jamming, NearFar, Pulses
    from navsim.gnss.interference.spectral_separation import SweptTone, Waveform
    from navsim.scenario.signals import CodeTrackingSection, ReceiverSection

Density = Annotated[float, Field(ge=0.0, le=80.0)]
"""Carrier to noise density ratio, dB-Hz."""
Wait = Annotated[float, Field(ge=0.0, le=60.0)]
Megahertz = Annotated[float, Field(ge=1000.0, le=2000.0)]
AnyMegahertz = Annotated[float, Field(ge=100.0, le=1e4)]


class LockSection(Section):
    """When the receiver loses a signal, and when it has it again."""

    lose_db_hz: Density = 28.0
    """a signal is lost when its effective carrier to noise density ratio is below this for lose_s"""
    lose_s: Wait = 0.5
    """how long it has to be below lose_db_hz"""
    regain_db_hz: Density = 31.0
    """a signal is back when its ratio is above this for regain_s"""
    regain_s: Wait = 2.0
    """how long it has to be above regain_db_hz"""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.regain_db_hz < self.lose_db_hz:
            raise reject("a signal would be lost as it comes back: must not lie below lose_db_hz", "regain_db_hz")
        return self


class JammerSection(Section):
    """A transmitter that jams."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    """name of the jammer, in tables and figures"""
    place: Point
    """position of the jammer"""
    height_m: Annotated[float, Field(ge=0.0, le=2e4)] = 2.0
    """height of its antenna over the ground, which is as high as the runway"""
    eirp_dbw: Annotated[float, Field(ge=-100.0, le=100.0)]
    """equivalent isotropically radiated power, power times antenna gain; 10 W: 10"""
    waveform: Literal["tone", "noise", "sweep", "matched"]
    """tone: one frequency; noise: white over bandwidth_mhz; sweep: a tone that sweeps it; matched: spread like the
    signals of GPS"""
    centre_mhz: AnyMegahertz = 1575.42
    """centre of its spectrum"""
    bandwidth_mhz: Annotated[float, Field(ge=1e-3, le=1000.0)] | None = None
    """width of its spectrum, for noise and sweeps"""
    sweep_s: Annotated[float, Field(ge=1e-6, le=3600.0)] | None = None
    """duration of a sweep from the lower to the upper end, repeated from time 0; omitted: so fast that only the mean
    matters"""
    shadow_db: NonNegative = 0.0
    """loss by obstacles between it and the aircraft"""
    on_s: ListOf[PairOf[FlightTime]] = ()
    """when it sends: from, to, one or several times; left out: always"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        wide = self.waveform in ("noise", "sweep")
        if wide and self.bandwidth_mhz is None:
            raise reject(f"a {self.waveform} needs its width", "bandwidth_mhz")
        if not wide and self.bandwidth_mhz is not None:
            raise reject(f"a {self.waveform} jammer has none", "bandwidth_mhz")
        if self.sweep_s is not None and self.waveform != "sweep":
            raise reject(f"is for `waveform: sweep`, not for `{self.waveform}`", "sweep_s")
        for i, (first, last) in enumerate(self.on_s):
            if last <= first:
                raise reject("ends before it begins", "on_s", i)
        return self

    def _waveform(self, memory: float) -> Waveform | SweptTone:
        from navsim.gnss.constellations.systems import GPS
        from navsim.gnss.interference.spectral_separation import Flat, Modulated, SweptTone, Tone, bpsk

        centre = self.centre_mhz * 1e6
        if self.waveform == "tone":
            return Tone(centre)
        if self.waveform == "matched":
            return Modulated(bpsk(GPS.chip_rate), centre)
        assert self.bandwidth_mhz is not None
        if self.sweep_s is not None:
            return SweptTone(centre, self.bandwidth_mhz * 1e6, self.sweep_s, memory)
        return Flat(centre, self.bandwidth_mhz * 1e6)

    def model(self, ground: float, memory: float) -> Jammer:
        """The jammer; ground: height of the runway over the ellipsoid, m; memory: of the receiver, s."""
        import numpy as np

        from navsim.geodesy.earth import ecef_from_llh
        from navsim.gnss.interference.jamming import Jammer

        place: np.ndarray = ecef_from_llh(np.array([*self.place.radians, ground + self.height_m]))
        return Jammer(
            self.name, place, self.height_m, self.eirp_dbw, self._waveform(memory), self.centre_mhz * 1e6,
            self.shadow_db, self.on_s,
        )  # fmt: skip


class PulseSection(Section):
    """Pulses of pseudolites, which take turns."""

    duty: Annotated[float, Field(ge=1e-3, le=0.5)] = 93.0 / 1023.0
    """share of the time in which each of them sends; default: RTCM's 93 of 1023 chips"""
    blanking: bool = True
    """the receiver is deaf to satellites during pulses; false: pulses are noise to them"""
    correlation: Literal["gated", "ungated"] = "gated"
    """gated: the receiver correlates with a pseudolite during its pulses alone; ungated: all the time"""

    def model(self) -> Pulses:
        """The pulses."""
        from navsim.gnss.interference.jamming import Pulses

        return Pulses(self.duty, self.blanking, self.correlation == "gated")


class NearFarSection(Section):
    """Pseudolites as jammers of satellites, and of each other, at their received power."""

    pulses: PulseSection | None = None
    """pulses of the pseudolites; left out: they send always"""
    lines: bool | None = None
    """signals with the codes and the carrier of pseudolites are lost, too, while the highest line of a code, 23.94 dB
    below its peak, exceeds them; null: for continuous transmission. Lines of pulsed codes are not modelled"""
    isolation_db: Annotated[float, Field(ge=0.0, le=80.0)] | None = None
    """with lines: how much stronger a pseudolite may be than such a signal; null: 23.94, for codes without Doppler.
    21.1: for all whole kHz of Doppler; more: for longer integrations, or a pseudolite off the carrier"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.pulses is not None and self.lines:
            raise reject("are of whole codes, pulses have parts of them: leave this out", "lines")
        if self.isolation_db is not None and (self.pulses is not None or self.lines is False):
            raise reject("is of lines, and there are none: pulses, or `lines: false`", "isolation_db")
        return self

    def model(self) -> NearFar:
        """Model of their interference."""
        from navsim.gnss.interference.jamming import ISOLATION, NearFar

        if self.pulses is not None:
            return NearFar(self.pulses.model(), isolation=None)
        if self.lines is False:
            return NearFar(None, isolation=None)
        return NearFar(None, isolation=ISOLATION if self.isolation_db is None else self.isolation_db)


class InterferenceSection(Section):
    """Jammers, obstacles that hide them, and the receiver's handling of weak signals."""

    jammers: Annotated[ListOf[JammerSection], Field(max_length=50)] = ()
    """transmitters that jam"""
    pseudolites: NearFarSection | None = None
    """pseudolites jam, too; null: they do not"""
    horizon: Annotated[ListOf[RidgeSection], Field(max_length=100)] = ()
    """obstacles that hide only jammers, in addition to `terrain`; of several edges on a path only the worst counts"""
    front_end_mhz: Annotated[ListOf[PairOf[Megahertz]], Field(max_length=10)] = ()
    """from, to: bands that the receiver passes, each signal by the one that its carrier is in; left out: everything"""
    lock: LockSection = LockSection()
    """when the receiver loses a signal, and when it has it again"""
    rate_bandwidth_hz: Annotated[float, Field(ge=1e-3, le=1e3)] = 2.0
    """one-sided bandwidth of the loop that range rates come from"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if not self.jammers and self.pseudolites is None:
            raise reject("no jammer: give a list here, or `pseudolites`", "jammers")
        if self.horizon and not self.jammers:
            raise reject("hides jammers, and there are none", "horizon")
        names = [jammer.name for jammer in self.jammers]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise reject(f"{name!r} is given twice", "jammers", i, "name")
        for i, (low, high) in enumerate(self.front_end_mhz):
            if low >= high:
                raise reject("the lower end comes first", "front_end_mhz", i)
            if any(low <= b and a <= high for a, b in self.front_end_mhz[:i]):
                raise reject("overlaps another band: a carrier would be in both", "front_end_mhz", i)
        return self

    def check_pseudolites(self, count: int, known: bool) -> None:
        """Raise for pseudolites that cannot jam; known: whether it is how strong they are at any distance."""
        if self.pseudolites is None:
            return
        if not known:
            text = (
                "how strong they are falls with distance: give pseudolites.eirp_dbm, or pseudolites.cn0_reference_m, "
                "where cn0_dbhz is meant"
            )
            raise reject(text, "pseudolites")
        self.check_turns(count)

    def check_turns(self, count: int) -> None:
        """Raise for more pseudolites than can take turns."""
        pulses = None if self.pseudolites is None else self.pseudolites.pulses
        if pulses is not None and count * pulses.duty >= 1.0:
            text = f"{count} pseudolites cannot take turns: their shares of the time must add up to less than 1"
            raise reject(text, "pseudolites", "pulses", "duty")

    def models(self, ground: float, tracking: CodeTrackingSection) -> tuple[Jammer, ...]:
        """The jammers over ground of this height above the ellipsoid, m."""
        # the noise that a loop of the bandwidth B lets through is the mean over 1 / (2 B)
        return tuple(jammer.model(ground, 0.5 / tracking.bandwidth_hz) for jammer in self.jammers)

    def model(
        self, threshold: np.ndarray, tracking: CodeTrackingSection, receiver: ReceiverSection, terrain: Terrain
    ) -> Jamming:
        """The jammers over ground as high as the threshold of the runway, (3,) rad, rad, m, and the loops and the
        receiver that they disturb. terrain: what hides them, too."""
        from dataclasses import replace

        import numpy as np

        from navsim.gnss.interference.jamming import Jamming
        from navsim.gnss.interference.spectral_separation import Band
        from navsim.gnss.interference.tracking_threshold import FrequencyLoop, LockRule

        lock, ground = self.lock, float(threshold[2])
        return Jamming(
            jammers=self.models(ground, tracking),
            lock=LockRule(lock.lose_db_hz, lock.lose_s, lock.regain_db_hz, lock.regain_s),
            code=tracking.loop(),
            rate=FrequencyLoop(self.rate_bandwidth_hz, tracking.integration_s, 1.0),
            ground=ground,
            horizon_db=tracking.gain_horizon_db,
            antenna=None if receiver.antenna is None else receiver.antenna.model(),
            noise_figure=receiver.noise_figure_db,
            pseudolites=None if self.pseudolites is None else self.pseudolites.model(),
            terrain=replace(terrain, tops=np.concatenate([terrain.tops, tops_of(self.horizon, threshold)])),
            bands=tuple(Band(low * 1e6, high * 1e6) for low, high in self.front_end_mhz),
        )
