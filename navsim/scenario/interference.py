"""Jammers beside a flight, and how the receiver holds signals against them: section `interference`.

Source of structure and defaults: `docs/theory/interference.md`, section 7.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.approach import Point
from navsim.scenario.base import NonNegative, Section, list_of, pair_of, reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.models.jamming import Jammer, Jamming
    from navsim.models.spectra import Waveform
    from navsim.scenario.signals import CodeTrackingSection

Moment = Annotated[float, Field(ge=0.0, le=3600.0)]
Density = Annotated[float, Field(ge=0.0, le=80.0)]
"""Carrier to noise density ratio, dB-Hz."""
Wait = Annotated[float, Field(ge=0.0, le=60.0)]


class LockSection(Section):
    """When the receiver loses a signal, and when it has it again."""

    lose_db_hz: Density = 28.0
    """lost when its effective carrier to noise density ratio is below this ..."""
    lose_s: Wait = 0.5
    """... for so long"""
    regain_db_hz: Density = 31.0
    """back when it is above this ..."""
    regain_s: Wait = 2.0
    """... for so long"""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.regain_db_hz < self.lose_db_hz:
            raise reject("a signal would be lost as it comes back: must not lie below lose_db_hz", "regain_db_hz")
        return self


class JammerSection(Section):
    """A transmitter that jams."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    place: Point
    height_m: Annotated[float, Field(ge=0.0, le=2e4)] = 2.0
    """of its antenna over the ground, which is as high as the runway"""
    eirp_dbw: Annotated[float, Field(ge=-100.0, le=100.0)]
    """power times antenna gain; 10 W: 10"""
    waveform: Literal["tone", "noise", "sweep", "matched"]
    """tone: one frequency; noise: white over bandwidth_mhz; sweep: a tone that sweeps it, in the mean; matched: spread
    like the signals of GPS"""
    centre_mhz: Annotated[float, Field(ge=1000.0, le=2000.0)] = 1575.42
    bandwidth_mhz: Annotated[float, Field(ge=1e-3, le=1000.0)] | None = None
    shadow_db: NonNegative = 0.0
    """what hides it from the aircraft"""
    on_s: list_of(pair_of(Moment)) = ()  # type: ignore[valid-type]
    """from, to, one or several times; left out: always"""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        wide = self.waveform in ("noise", "sweep")
        if wide and self.bandwidth_mhz is None:
            raise reject(f"a {self.waveform} needs its width", "bandwidth_mhz")
        if not wide and self.bandwidth_mhz is not None:
            raise reject(f"a {self.waveform} jammer has none", "bandwidth_mhz")
        for i, (first, last) in enumerate(self.on_s):
            if last <= first:
                raise reject("ends before it begins", "on_s", i)
        return self

    def _waveform(self) -> Waveform:
        from navsim.models.spectra import Flat, Modulated, Tone, bpsk
        from navsim.models.systems import GPS

        centre = self.centre_mhz * 1e6
        if self.waveform == "tone":
            return Tone(centre)
        if self.waveform == "matched":
            return Modulated(bpsk(GPS.chip_rate), centre)
        assert self.bandwidth_mhz is not None
        return Flat(centre, self.bandwidth_mhz * 1e6)

    def model(self, ground: float) -> Jammer:
        """The jammer; ground: height of the runway over the ellipsoid, m."""
        import numpy as np

        from navsim.core.arrays.earth import ecef_from_llh
        from navsim.models.jamming import Jammer

        place: np.ndarray = ecef_from_llh(np.array([*self.place.radians, ground + self.height_m]))
        return Jammer(
            self.name, place, self.height_m, self.eirp_dbw, self._waveform(), self.centre_mhz * 1e6, self.shadow_db,
            self.on_s,
        )  # fmt: skip


class InterferenceSection(Section):
    """Jammers, and what the receiver does about weak signals."""

    jammers: Annotated[list_of(JammerSection), Field(min_length=1, max_length=50)]  # type: ignore[valid-type]
    lock: LockSection = LockSection()
    rate_bandwidth_hz: Annotated[float, Field(ge=1e-3, le=1e3)] = 2.0
    """one-sided bandwidth of the loop that range rates come from"""

    @model_validator(mode="after")
    def _named(self) -> Self:
        names = [jammer.name for jammer in self.jammers]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise reject(f"{name!r} stands twice", "jammers", i, "name")
        return self

    def model(self, ground: float, tracking: CodeTrackingSection) -> Jamming:
        """The jammers over ground of a height over the ellipsoid, m, and the loops that they disturb."""
        from navsim.models.jamming import Jamming
        from navsim.models.lock import FrequencyLoop, LockRule

        lock = self.lock
        return Jamming(
            tuple(jammer.model(ground) for jammer in self.jammers),
            LockRule(lock.lose_db_hz, lock.lose_s, lock.regain_db_hz, lock.regain_s),
            tracking.loop(),
            FrequencyLoop(self.rate_bandwidth_hz, tracking.integration_s, 1.0),
            ground,
            tracking.gain_horizon_db,
        )
