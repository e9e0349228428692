"""Pseudoranges and range rates: geometry of all sources over the approach, error laws, measurements.

    pseudorange = range + receiver clock - source clock + ionosphere + troposphere + multipath + noise

`Signals.range_bias` is the sum of the terms that do not change from run to run: clocks of the pseudolites, residual
atmospheric delays, multipath. Sources: [1] Groves (2013), sections 8.5, 9.2. [2] `docs/theory/signals.md`, sections 1,
4, 5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from navsim.geodesy import earth
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.correction_link import LossesByRun
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.dll import ReflectionErrors
from navsim.gnss.pseudolite_clock import TransmitterErrors, Transmitters, WanderingClocks

_TRAVEL_TIME = 0.07
_BY_SOURCE = (
    "used", "position", "velocity", "range", "range_rate", "range_bias", "sigma", "rate_sigma", "los", "azimuth",
    "elevation", "cn0", "divergence", "fix_sigma", "fix_rate_sigma",
)  # fmt: skip
"""Fields of `Signals` by epoch and source that are always there."""


@dataclass(frozen=True)
class Signals:
    """All sources at all fix epochs.

    A source that is not received has `used` false, and may have nan in every other field; where it is used, all are
    finite.
    """

    time: np.ndarray
    """(e,) s."""
    antenna: np.ndarray
    """(e, 3) ECEF, m."""
    antenna_velocity: np.ndarray
    """(e, 3) ECEF, m/s."""
    names: tuple[str, ...]
    """(s,)."""
    time_scale: np.ndarray
    """(s,) number of the time scale, each with its own clock unknown."""
    used: np.ndarray
    """(e, s) bool."""
    position: np.ndarray
    """(e, s, 3) of the sources according to the receiver, m: satellites at transmission, in ECEF axes at reception."""
    velocity: np.ndarray
    """(e, s, 3) rate of that position with the time of reception, m/s, see `apparent_velocity`."""
    range: np.ndarray
    """(e, s) true, m."""
    range_rate: np.ndarray
    """(e, s) true, m/s."""
    range_bias: np.ndarray
    """(e, s) deterministic errors of the pseudoranges after corrections, common to all runs, m; positive: too long."""
    sigma: np.ndarray
    """(e, s) 1 sigma of the range noise, m."""
    rate_sigma: np.ndarray
    """(e, s) 1 sigma of the range rate noise, m/s."""
    los: np.ndarray
    """(e, s, 3) unit vectors from the antenna, ENU, nan where not used."""
    azimuth: np.ndarray
    """(e, s) rad, also of unused sources."""
    elevation: np.ndarray
    """(e, s) rad, also of unused sources."""
    cn0: np.ndarray
    """(e, s) dB-Hz."""
    divergence: np.ndarray
    """(e, s) code minus carrier delay, m."""
    source_errors: np.ndarray | None
    """(e, s, 4) effect of one sigma of position and clock errors drawn for each run; None without. Satellites have
    errors of their messages, pseudolites those of survey and calibration."""
    correlated: CorrelatedErrors | None
    """Time-correlated errors drawn for each run, or None."""
    fix_sigma: np.ndarray
    """(e, s) 1 sigma of the pseudoranges of fixes, due to all random errors except `source_errors` of satellites."""
    fix_rate_sigma: np.ndarray
    """(e, s) 1 sigma of the range rates of fixes, likewise."""
    smoothing: np.ndarray | None
    """(e, s) int, counts of the carrier smoothing; None for bare code."""
    js: np.ndarray
    """(j, e, s) jammer to signal power ratio, dB."""
    offset: np.ndarray | None = None
    """(s, k) effect of one sigma of each of k time scale offsets drawn for each run, m, or None."""
    air: np.ndarray | None = None
    """(e, s) delay of pseudolites by the air of one N-unit at the runway, m; None without."""
    wandering: WanderingClocks | None = None
    """Clocks of pseudolites drawn for each run, or None."""
    transmitters: Transmitters | None = None
    """Errors of pseudolites that last over a run; None without pseudolites."""
    reflections: ReflectionErrors | None = None
    """Statistics of the reflection errors in `range_bias`, or None."""
    correction_age: np.ndarray | None = None
    """(e,) age of the corrections for satellites, s, inf where none are in use; None without a station."""
    losses: LossesByRun | None = None
    """Corrections for runs that lose other messages; None where no link loses any."""
    filter_fix_sigma: np.ndarray | None = None
    """(2, e, s) 1 sigma that weight ranges, m, and range rates, m/s, in the fixes of the filter, see
    `simulation.correlated_errors.fix_weights`; None: as in those of the receiver."""

    @property
    def of_filter(self) -> Signals:
        """Signals with the weights of the filter's fixes as 1 sigma of fixes."""
        if self.filter_fix_sigma is None:
            return self
        return replace(self, fix_sigma=self.filter_fix_sigma[0], fix_rate_sigma=self.filter_fix_sigma[1])

    @property
    def noise_sigma(self) -> np.ndarray:
        """1 sigma of the white noise in the pseudoranges of fixes (e, s), m."""
        if self.correlated is None:
            return self.fix_sigma
        return np.asarray(np.sqrt(np.maximum(self.fix_sigma**2 - self.correlated.total**2, 0.0)))

    @property
    def drawn_air(self) -> np.ndarray | None:
        """Effect (e, s) of one sigma of the refractivity that is drawn for each run, m; None without."""
        if self.air is None or self.transmitters is None or not self.transmitters.errors.refractivity:
            return None
        return np.asarray(self.transmitters.errors.refractivity * self.air)

    @property
    def transmitter_variance(self) -> np.ndarray:
        """Variance of pseudoranges, m2, and range rates, m2/s2, of fixes due to errors of transmitters (2, e, s)."""
        if self.transmitters is None:
            return np.zeros((2, *self.range.shape))
        return self.variances_of(self.transmitters.errors)

    def variances_of(self, errors: TransmitterErrors) -> np.ndarray:
        """Variance of pseudoranges, m2, and range rates, m2/s2, due to such errors of transmitters (2, e, s)."""
        assert self.transmitters is not None
        out = errors.variances(self.time)[..., None] * self.transmitters.which
        if self.air is not None and errors.refractivity:
            out[0] += (errors.refractivity * self.air) ** 2
        return np.asarray(out)

    def with_noise(self, share: float, rate_share: float) -> Signals:
        """Signals with the noise of ranges and range rates multiplied by these factors; errors that last keep their
        sizes."""
        ranges, rates, lasting = share * self.noise_sigma, rate_share * self.fix_rate_sigma, self.transmitter_variance
        if lasting.any():
            ranges = np.sqrt(ranges**2 + (1.0 - share**2) * lasting[0])
            rates = np.sqrt(rates**2 + (1.0 - rate_share**2) * lasting[1])
        if self.correlated is not None:
            ranges = np.hypot(ranges, self.correlated.total)
        return replace(
            self, sigma=share * self.sigma, rate_sigma=rate_share * self.rate_sigma, fix_sigma=ranges,
            fix_rate_sigma=rates,
        )  # fmt: skip

    def unfinished(self) -> list[tuple[str, str]]:
        """Names of source and field of numbers that are not finite although they should be."""
        out = []
        for field in ("position", "velocity", "range", "range_rate", "range_bias", "sigma", "rate_sigma", "cn0",
                      "divergence", "source_errors", "fix_sigma", "fix_rate_sigma"):  # fmt: skip
            values = getattr(self, field)
            if values is not None:
                finite = np.isfinite(values).all(axis=tuple(range(2, values.ndim)))
                out += [(self.names[i], field) for i in np.flatnonzero((self.used & ~finite).any(axis=0))]
        return out

    def at(self, epochs: np.ndarray) -> Signals:
        """Signals at the epochs with these numbers (m,) int."""
        each = {
            name: getattr(self, name)[epochs]
            for name in ("time", "antenna", "antenna_velocity", *_BY_SOURCE, "source_errors", "smoothing", "air")
            if getattr(self, name) is not None
        }
        correlated = None if self.correlated is None else self.correlated.at(epochs)
        reflections = None if self.reflections is None else self.reflections.at(epochs)
        weights = None if self.filter_fix_sigma is None else self.filter_fix_sigma[:, epochs]
        losses = None if self.losses is None else self.losses.at(epochs)
        return replace(
            self, js=self.js[:, epochs], correlated=correlated, reflections=reflections, filter_fix_sigma=weights,
            losses=losses, **each,
        )  # fmt: skip

    def select(self, kept: np.ndarray) -> Signals:
        """Signals of the sources marked in `kept` (s,) bool."""
        each = {name: getattr(self, name)[:, kept] for name in _BY_SOURCE}
        return replace(
            self,
            names=tuple(name for name, stays in zip(self.names, kept, strict=True) if stays),
            time_scale=self.time_scale[kept],
            source_errors=None if self.source_errors is None else self.source_errors[:, kept],
            correlated=None if self.correlated is None else self.correlated.select(kept),
            reflections=None if self.reflections is None else self.reflections.select(kept),
            smoothing=None if self.smoothing is None else self.smoothing[:, kept],
            air=None if self.air is None else self.air[:, kept],
            js=self.js[:, :, kept],
            offset=None if self.offset is None else self.offset[kept],
            wandering=None if self.wandering is None else self.wandering.select(kept),
            transmitters=None if self.transmitters is None else self.transmitters.select(kept),
            filter_fix_sigma=None if self.filter_fix_sigma is None else self.filter_fix_sigma[:, :, kept],
            losses=None if self.losses is None else self.losses.select(kept),
            **each,
        )


def satellites_at_reception(
    constellation: Constellation, gpst: np.ndarray, antenna: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Satellites as a receiver sees them: at transmission time, in the ECEF axes of reception [1].

    constellation: of n. gpst: (m,) GPS s. antenna: (m, 3) ECEF, m. Returns position, velocity (m, n, 3).
    """
    travel = np.full((gpst.size, len(constellation.names)), _TRAVEL_TIME)
    # the first round leaves an error of microseconds, the second of picoseconds
    for _ in range(2):
        position, velocity = constellation.state(gpst[:, None] - travel)
        position, velocity = turned_with_earth(position, travel), turned_with_earth(velocity, travel)
        travel = np.linalg.norm(position - antenna[:, None], axis=2) / earth.SPEED_OF_LIGHT
    return position, velocity


def apparent_velocity(
    position: np.ndarray, velocity: np.ndarray, antenna: np.ndarray, antenna_velocity: np.ndarray
) -> np.ndarray:
    """Rate of the position that `satellites_at_reception` gives, by the time of reception (m, n, 3), m/s.

    position, velocity (m, n, 3): from that function. antenna, antenna_velocity (m, 3): ECEF, m, m/s.

    While the range grows by r' m/s, a second of reception sees 1 - r'/c seconds of the satellite's motion. The axes
    rotate by the Earth's rate times r'/c. The range rate is then exactly u (this velocity - the antenna's). The effect
    is up to 3 mm/s. It is the time derivative of the range of [1], section 8.5.
    """
    away = position - antenna[:, None]
    unit = away / np.linalg.norm(away, axis=2, keepdims=True)
    inertial = velocity + np.cross([0.0, 0.0, earth.RATE], position)
    closing = np.sum(unit * (velocity - antenna_velocity[:, None]), axis=2)
    rate = closing / (1.0 + np.sum(unit * inertial, axis=2) / earth.SPEED_OF_LIGHT)
    return velocity - inertial * (rate / earth.SPEED_OF_LIGHT)[..., None]


def turned_with_earth(v: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """ECEF vectors (..., 3) in the axes to which the Earth has turned after a duration (...), s."""
    angle = earth.RATE * duration
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], axis=-1)


def sigma_of_elevation(law: str, zenith: float, elevation: np.ndarray, scale: float) -> np.ndarray:
    """1 sigma of the ranging error (m) of a satellite at an elevation (rad), `zenith` being that overhead.

    constant: the same everywhere; inverse-sine: zenith / sin(el), el no lower than 2 degrees;
    exponential: zenith (1 + 9 exp(-el / scale)), ten times the zenith value at the horizon (scale in rad).
    """
    if law in ("constant", "cn0"):  # the latter is computed from the carrier to noise density afterwards
        return np.full_like(elevation, zenith)
    if law == "inverse-sine":
        return zenith / np.sin(np.maximum(elevation, np.radians(2.0)))
    if law == "exponential":
        return zenith * (1.0 + 9.0 * np.exp(-np.maximum(elevation, 0.0) / scale))
    raise ValueError(f"no such law: {law}")
