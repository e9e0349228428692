"""Effects on signals between a satellite and a receiver, and the receiver's corrections.

Delays here are those that remain in the pseudorange after the receiver's corrections, m. Delays common to all runs go
to `Signals.range_bias`. Orbits and clocks of satellites are drawn for each run: their effect is kept as sensitivities.

Sources: [1] IS-GPS-200 (Klobuchar). [2] Kaplan & Hegarty (2017), chapter 10 (errors and their sizes), 12 (differential
corrections). [3] `docs/theory/signals.md`, sections 2, 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from navsim.geodesy.earth import RATE as EARTH_RATE
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss import atmosphere, dll
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.correction_link import CorrectionLink
from navsim.gnss.correlated_errors import CorrelatedError
from navsim.gnss.ground_accuracy import GroundStationError
from navsim.gnss.heavy_tailed import HeavyTailedNoise
from navsim.gnss.pseudorange import satellites_at_reception
from navsim.gnss.sky import azimuth_elevation, enu_matrix


@dataclass(frozen=True)
class Ionosphere:
    """Klobuchar's coefficients (4,) each; truth: how many times the model the real delay is; corrected: whether the
    receiver takes the model off."""

    alpha: np.ndarray
    beta: np.ndarray
    truth: float
    corrected: bool


@dataclass(frozen=True)
class Troposphere:
    """True delay and correction of the troposphere."""

    truth: float
    """Factor of the true delay on the climatology of DO-229."""
    correction: Literal["none", "saastamoinen", "mops"]
    """Model of the receiver."""


@dataclass(frozen=True)
class GroundAir:
    """Air on the paths of ground sources."""

    truth: float
    """True refractivity at the runway, N-units."""
    corrected: float
    """Refractivity at the runway that the receiver takes the delay off by, N-units; 0: it corrects nothing."""
    height: float
    """Ellipsoidal height of the runway, m."""

    @property
    def residual(self) -> float:
        """Refractivity at the runway that the correction leaves, N-units."""
        return self.truth - self.corrected

    def delay(self, antenna: np.ndarray, source: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Residual delay, m, at heights of the antenna and of the source, m, over a distance, m."""
        return self.residual * self.unit_delay(antenna, source, distance)

    def unit_delay(self, antenna: np.ndarray, source: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Delay, m, by one N-unit at the runway; arguments as of `delay`."""
        return atmosphere.ground_delay(antenna - self.height, source - self.height, distance)


@dataclass(frozen=True)
class SignalInSpaceErrors:
    """1 sigma of satellite orbits, radial, along, across (3,) m, and of satellite clocks, m; constant over a run."""

    orbit: np.ndarray
    clock: float


@dataclass(frozen=True)
class DifferentialStation:
    """A station at a known place that sends corrections for satellites."""

    llh: np.ndarray
    """(3,) rad, rad, m."""
    latency: float
    """Age of the corrections at their arrival, s."""
    noise: float
    """1 sigma, m."""
    link: CorrectionLink | None = None
    """None: corrections of this age are there at all times."""


STANDARD_LOOP = dll.CodeLoop(spacing=0.5, bandwidth=1.0, integration=0.02)


@dataclass(frozen=True)
class Effects:
    """Errors and noise of signals; defaults are an ideal world."""

    ionosphere: Ionosphere | None = None
    troposphere: Troposphere | None = None
    ground_air: GroundAir | None = None
    signal_in_space: SignalInSpaceErrors | None = None
    reference: DifferentialStation | None = None
    loop: dll.CodeLoop = STANDARD_LOOP
    thermal: bool = False
    """Noise of satellite ranges is that of the code loop at their carrier to noise density."""
    horizon_db: float = 0.0
    """Gain of the receiving antenna at the horizon, dB."""
    reflection: dll.GroundReflection | None = None
    cn0_reference: float | None = None
    """Distance from a pseudolite of its stated C/N0, m; C/N0 then falls with distance. None: constant."""
    noise_figure: float = 0.0
    """Noise figure of the receiver, dB."""
    thermal_pseudolites: bool = False
    """`thermal` for pseudolites."""
    offsets: tuple[float, ...] = (0.0,) * len(CLOCKS)
    """Offset of each time scale from the first, m, by clock number."""
    offset_sigma: float = 0.0
    """1 sigma of the offsets drawn for each run, m, relative to the first time scale of the sky."""
    single_clock: bool = False
    """The receiver treats all time scales as one."""
    smoothing: float = 0.0
    """Time constant of the carrier-smoothed code, s."""
    correlated: tuple[CorrelatedError | GroundStationError, ...] = ()
    """Time-correlated errors of satellites in the pseudoranges that the receiver uses."""
    noise_distribution: HeavyTailedNoise | None = None
    """Distribution of the ranging noise if it is not Gaussian."""

    @property
    def depends_on_pseudolite_sites(self) -> bool:
        """Whether moving a pseudolite changes which satellites have corrections: through the station's horizon, with a
        troposphere, or through reception of the data link."""
        return self.reference is not None and (self.troposphere is not None or self.reference.link is not None)


NO_EFFECTS = Effects()
"""The ideal world."""


def propagation(
    effects: Effects, gpst: np.ndarray, llh: np.ndarray, azimuth: np.ndarray, elevation: np.ndarray, ratio2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residual delay of ionosphere and troposphere in the pseudoranges, and the ionosphere's part of it, (e, s) m.

    gpst: (e,) GPS s. llh: (e, 3). azimuth, elevation: (e, s) rad. ratio2: (s,) (L1 / f)^2. With an atmosphere, nan for
    satellites without a direction; with a troposphere, also for those at or below the horizon.
    """
    ionosphere, troposphere = np.zeros_like(elevation), np.zeros_like(elevation)
    if effects.ionosphere is not None:
        model = effects.ionosphere
        delay = ratio2 * atmosphere.klobuchar(model.alpha, model.beta, gpst[:, None], llh[:, None], azimuth, elevation)
        ionosphere = (model.truth - float(model.corrected)) * delay
    if effects.troposphere is not None and gpst.size:
        air = effects.troposphere
        seasonal = atmosphere.mops_niell(float(gpst[0]), llh[:, None], elevation)
        troposphere = air.truth * seasonal
        if air.correction == "mops":
            troposphere = troposphere - seasonal
        elif air.correction == "saastamoinen":
            troposphere = troposphere - atmosphere.saastamoinen(llh[:, None], elevation)
    return ionosphere + troposphere, ionosphere


def orbit_clock_sensitivity(
    errors: SignalInSpaceErrors, unit: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Change of the pseudoranges (e, s, 4), m, by one sigma of each orbit error and of the clock error.

    unit: (e, s, 3) receiver to satellite, ECEF. position, velocity: (e, s, 3) ECEF.
    """
    radial = position / np.linalg.norm(position, axis=2, keepdims=True)
    across = np.cross(position, velocity + np.cross([0.0, 0.0, EARTH_RATE], position))
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    axes = np.stack([radial, np.cross(across, radial), across], axis=2)
    # a satellite assumed farther out than it is makes the pseudorange too short
    orbit = -np.einsum("esi,esji->esj", unit, axes) * errors.orbit
    return np.concatenate([orbit, np.full((*orbit.shape[:2], 1), errors.clock)], axis=2)


def directions_from(
    constellation: Constellation, gpst: np.ndarray, llh: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors ECEF (e, n, 3), azimuth, elevation (e, n) of satellites at times (e,) from one place llh (3,)."""
    here = np.broadcast_to(ecef_from_llh(llh), (gpst.size, 3))
    position, _ = satellites_at_reception(constellation, gpst, here)
    away = position - here[:, None]
    unit = away / np.linalg.norm(away, axis=2, keepdims=True)
    azimuth, elevation = azimuth_elevation(np.einsum("ij,enj->eni", enu_matrix(llh), unit))
    return unit, azimuth, elevation
