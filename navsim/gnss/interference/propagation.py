"""Propagation of jammers' power and its effect on signals; pulsed pseudolites.

Levels are in dB; losses are positive. Axes: jammers j, epochs e, sources s. `gnss.interference.spectral_separation`
computes the kappas.

Pages: `docs/theory/interference.md`, sections 1, 3, 6.

Sources:

- [1] Kaplan & Hegarty, Understanding GPS/GNSS, 3rd ed. (2017), chapter 9 (effective carrier to noise density).
- [2] ITU-R P.526, section 4.1 (one knife edge), 4/3 of the Earth's radius.
- [3] RTCM SC-104 (pulses of pseudolites, 93 of 1023 chips).
- [4] Elrod & Van Dierendonck, Pseudolites, in: Global Positioning System: Theory and Applications II (1996) (pulses and
  correlation); RTCA DO-292 (blanking).
- [5] Gold, Optimal binary sequences for spread spectrum multiplexing, IEEE Transactions on Information Theory 13
  (1967).
"""

from __future__ import annotations

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT

BOLTZMANN = 1.380649e-23
"""J/K."""
RTCM_DUTY = 93.0 / 1023.0
"""Share of the time in which a pseudolite sends [3]."""
EARTH_RADIUS = 6371.0e3
"""Mean radius of the Earth, m [2]."""
_HORIZON = 4120.0
"""Distance to the horizon of an antenna 1 m high over an Earth of 4/3 of the radius, m [2]."""
LOWEST = 1.0
"""Height over the ground, m, that antennas have at least for the radio horizon: on the ground there would be none."""
_CLEAR = -0.78
"""Knife edges below it do not matter [2]."""


def noise_density(temperature: float) -> float:
    """10 log10(kT), dBW/Hz, at a temperature of the receiver, K."""
    return float(10.0 * np.log10(BOLTZMANN * temperature))


def path_loss(distance: np.ndarray, frequency: np.ndarray | float) -> np.ndarray:
    """Loss in free space, dB, over distances above 0, m, at frequencies, Hz; both of any shape."""
    return 20.0 * np.log10(4.0 * np.pi * np.asarray(distance) * frequency / SPEED_OF_LIGHT)


def jam_to_signal(
    eirp: np.ndarray, loss: np.ndarray, gain_to_jammer: np.ndarray, signal: np.ndarray, gain_to_source: np.ndarray
) -> np.ndarray:
    """Jammer to signal power ratio J/S (j, e, s), dB [1]; -inf if no power arrives from a jammer.

    - `eirp` (j, e): of jammers towards the receiver, dBW; `loss` (j, e): `path_loss` and shadowing, dB.
    - `gain_to_jammer` (j, e) and `gain_to_source` (e, s): of the receiver's antenna, dB.
    - `signal` (s,): before the antenna, dBW.
    """
    return (eirp - loss + gain_to_jammer)[..., None] - (signal + gain_to_source)


def jammed(cn0: np.ndarray, js: np.ndarray, kappa: np.ndarray) -> np.ndarray:
    """Effective carrier to noise density (e, s), dB-Hz, of signals that have cn0 (e, s) alone [1]; nan stays nan.

    js: J/S (j, e, s), dB. kappa: (j, s) 1/Hz, or (j, e or 1, s).
    """
    kappa = np.broadcast_to(kappa if kappa.ndim == js.ndim else kappa[:, None], js.shape)
    return -10.0 * np.log10(10.0 ** (-cn0 / 10.0) + np.einsum("jes,jes->es", 10.0 ** (js / 10.0), kappa))


def edge_parameter(height: np.ndarray, before: np.ndarray, behind: np.ndarray, wavelength: float) -> np.ndarray:
    """Fresnel's parameter nu of an edge [2]: its height over the straight path, m, below it negative; its distances
    above 0 from the ends, m; of any shape."""
    return height * np.sqrt(2.0 * (before + behind) / (wavelength * before * behind))


def edge_loss(nu: np.ndarray) -> np.ndarray:
    """Loss behind a knife edge, dB, of any shape [2]."""
    x = np.maximum(nu, _CLEAR) - 0.1
    return np.where(np.asarray(nu) > _CLEAR, 6.9 + 20.0 * np.log10(np.sqrt(x**2 + 1.0) + x), 0.0)


def radio_horizon(one: np.ndarray | float, other: np.ndarray | float) -> np.ndarray:
    """Largest distance of antennas at heights over the ground, m, in line of sight, m [2]; heights below it count as
    zero."""
    return _HORIZON * (np.sqrt(np.maximum(one, 0.0)) + np.sqrt(np.maximum(other, 0.0)))


def horizon_loss(distance: np.ndarray, one: np.ndarray | float, other: np.ndarray | float) -> np.ndarray:
    """Loss, dB, over a distance, m, between antennas at heights over the ground, m: 0 within their `radio_horizon`,
    beyond it inf."""
    return np.where(distance > radio_horizon(one, other), np.inf, 0.0)


def blanked_loss(duties: np.ndarray) -> np.ndarray:
    """Loss of satellite signals, dB (...), in a receiver that blanks the pulses of pseudolites (..., p) [4].

    duties: fraction of the time of each; pulses do not overlap, and the fractions add up to less than 1.
    """
    return -10.0 * np.log10(1.0 - np.sum(duties, axis=-1))


def gated_loss(duty: float) -> float:
    """Loss of a pulsed pseudolite, dB, relative to continuous transmission at the pulse power [4].

    The receiver correlates only during the pulses. duty: above 0, to 1.
    """
    return float(-10.0 * np.log10(duty))


def ungated_loss(duty: float) -> float:
    """`gated_loss` for a receiver that correlates all the time, including noise between the pulses [4]."""
    return 2.0 * gated_loss(duty)


def cross_correlation(stages: int) -> float:
    """Highest correlation, dB below the peak and so negative, of two Gold codes of registers with that many stages
    [5]; no codes have a multiple of 4."""
    return float(20.0 * np.log10((1 + 2 ** ((stages + 2) // 2)) / (2**stages - 1)))
