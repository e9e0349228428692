"""Landing past an MLS elevation station: the four segments of the paper and the elevation angle over them.

Source: `docs/theory/elevation.md`, section 1. Angles in degrees, as everything of this system; D is counted to the
beacon of the segment, m.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np

Real = float | np.ndarray
TO_DEGREES = 180.0 / np.pi

LEVEL_END = 80.0
"""End of the level leg, s."""
GLIDE_END = LEVEL_END + 47.2222
SINK = 0.18
"""Rate of the exponential flare, 1/s."""
FLARE = float(np.log(15.0)) / SINK
"""Length of the flare, s: from 30 m to 2 m of height."""
FLARE_STATION = 3500.0 + 80.0 * FLARE
"""Distance of the flare guidance station at the start of the flare, m."""
ROLL_OUT = 2.0
"""Deceleration of the roll-out, m/s2; the paper gives none."""
_ROLL_OUT_STATION = FLARE_STATION - 80.0 * FLARE
BEYOND = FLARE_STATION - 750.0
"""Distance from the glide beacon on to the station beyond the runway, m."""


@dataclass(frozen=True)
class Leg:
    """Distance and height with their first two derivatives (n,), m, m/s, m/s2."""

    d: np.ndarray
    d1: np.ndarray
    d2: np.ndarray
    h: np.ndarray
    h1: np.ndarray
    h2: np.ndarray


def level_leg(t: np.ndarray) -> Leg:
    """Segment 1, t = 0 ... 80 s: 15 km to 5 km, 540 to 360 km/h, 200 m high."""
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    return Leg(15000.0 - 150.0 * t + 0.3125 * t**2, -150.0 + 0.625 * t, 0.625 * one, 200.0 * one, 0.0 * t, 0.0 * t)


def glide(s: np.ndarray) -> Leg:
    """Segment 2, s = 0 ... 47.2 s: on a line through the beacon, slope 0.04."""
    s = np.asarray(s, dtype=float)
    a = 0.2117647
    d, d1, d2 = 5000.0 - 100.0 * s + a * s**2, -100.0 + 2.0 * a * s, 2.0 * a * np.ones_like(s)
    return Leg(d, d1, d2, 0.04 * d, 0.04 * d1, 0.04 * d2)


def flare(s: np.ndarray, station: float = 750.0) -> Leg:
    """Segment 3, s = 0 ... 15.04 s: at 80 m/s, height decaying; `station`: distance at its start, m."""
    s = np.asarray(s, dtype=float)
    h = 30.0 * np.exp(-SINK * s)
    return Leg(station - 80.0 * s, -80.0 + 0.0 * s, 0.0 * s, h, -SINK * h, SINK**2 * h)


def roll_out(s: np.ndarray) -> Leg:
    """Segment 4, from s = 0: braking at ROLL_OUT to a standstill at 40 s, 2 m above the station's plane."""
    s = np.asarray(s, dtype=float)
    one = np.ones_like(s)
    braking = np.minimum(s, 80.0 / ROLL_OUT)
    d = _ROLL_OUT_STATION - 80.0 * braking + 0.5 * ROLL_OUT * braking**2
    d1, d2 = -80.0 + ROLL_OUT * braking, np.where(braking < s, 0.0, ROLL_OUT)
    return Leg(d, d1, d2, 2.0 * one, 0.0 * s, 0.0 * s)


def elevation(leg: Leg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """beta, beta', beta'' in deg, deg/s, deg/s2."""
    square = leg.h**2 + leg.d**2
    cross = leg.h1 * leg.d - leg.h * leg.d1
    second = (leg.h2 * leg.d - leg.h * leg.d2) / square - 2.0 * cross * (leg.h * leg.h1 + leg.d * leg.d1) / square**2
    return TO_DEGREES * np.arctan2(leg.h, leg.d), TO_DEGREES * cross / square, TO_DEGREES * second


def along(t: np.ndarray) -> Leg:
    """The whole approach: distance to the glide beacon up to the flare, then to the station beyond the runway."""
    t = np.asarray(t, dtype=float)
    parts = (
        (t < LEVEL_END, level_leg(t)),
        ((t >= LEVEL_END) & (t < GLIDE_END), glide(t - LEVEL_END)),
        ((t >= GLIDE_END) & (t < GLIDE_END + FLARE), flare(t - GLIDE_END, FLARE_STATION)),
        (t >= GLIDE_END + FLARE, roll_out(t - GLIDE_END - FLARE)),
    )
    out = np.full((len(fields(Leg)), t.size), np.nan)
    for where, leg in parts:
        out[:, where] = np.stack(astuple(leg))[:, where]
    return Leg(*out)


def approach(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """beta, beta', beta'' of the guidance used on the approach: the glide beacon to the flare, then the flare
    station."""
    return elevation(along(t))


def azimuth(
    t: np.ndarray, on_line: float, cross_speed: float, cross_acceleration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Azimuth and its derivatives, seen from the station beyond the runway, deg, deg/s, deg/s2.

    The aircraft comes towards the centre line at `cross_speed`, m/s, turns onto it at `cross_acceleration`, m/s2, and
    is on it from `on_line`, s, on. The distance along the runway is that of the approach.
    """
    leg = along(t)
    to_go = np.maximum(on_line - np.asarray(t, dtype=float), 0.0)
    turn = cross_speed / cross_acceleration
    turned = np.minimum(to_go, turn)
    y = 0.5 * cross_acceleration * turned**2 + cross_speed * (to_go - turned)
    y2 = np.where((to_go > 0.0) & (to_go <= turn), cross_acceleration, 0.0)
    d = np.where(np.asarray(t) < GLIDE_END, leg.d + BEYOND, leg.d)
    return elevation(Leg(d, leg.d1, leg.d2, y, -cross_acceleration * turned, y2))


def angle_sigma(d: Real, h: Real, sigma_d: Real, sigma_h: Real) -> Real:
    """1 sigma of arctan(h/d), deg, linearised in the errors of d and h, m; of its second derivative, deg/s2, where
    these are errors of accelerations, m/s2."""
    return TO_DEGREES * np.hypot(h * sigma_d, d * sigma_h) / (h**2 + d**2)
