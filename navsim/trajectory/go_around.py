"""A landing that is broken off: a pull-up by a load factor to a climb, the heading held.

Source: `docs/theory/trajectory.md`, section 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev

from navsim.geodesy.earth import STANDARD_GRAVITY
from navsim.trajectory.approach import FLARE, GLIDE_START, TOUCHDOWN
from navsim.trajectory.path import (
    AnySegment,
    NoSuchPath,
    Path,
    Steered,
    constant,
    ended,
    series,
    smooth_step,
    uniform,
)

GO_AROUND = "go_around"
_ROUNDS = 60
_POINTS, _SHARES = np.polynomial.legendre.leggauss(60)
_LOOK = 0.05
"""Step in which a height is sought before it is found by halving, s."""


@dataclass(frozen=True)
class PullUp:
    """Load factor, in units of standard gravity across the path, that comes on and off within `ease` seconds; climb
    angle that it ends in, rad."""

    load: float
    climb: float
    ease: float


@dataclass(frozen=True)
class AlarmGoAround:
    """A go-around that each run begins after its own first alarm."""

    how: PullUp
    delay: float
    """From the alarm to the begin of the pull-up, s."""
    decision_height: float
    """Height above the runway, m, below which no alarm breaks the landing off."""


def time_at(path: Path, height: float) -> float:
    """Last time at which a path descends through a height, m, on its glide, s. Raises NoSuchPath."""
    first, last = path.events[GLIDE_START], path.events[TOUCHDOWN]
    t = np.append(np.arange(first, last, _LOOK), last)
    above = np.flatnonzero(-path.jet(t)[:, 0, 2] >= height)
    if not above.size or height <= 0.0:
        top = -path.jet(t[:1])[0, 0, 2]
        raise NoSuchPath(f"{height:g} m above the runway are not passed on the glide, which begins at {top:g} m")
    low, high = t[above[-1]], t[min(above[-1] + 1, t.size - 1)]
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if -path.jet(np.array([middle]))[0, 0, 2] >= height else (low, middle)
    return float(low)


def with_go_around(path: Path, begin: float, how: PullUp, through_ground: bool = False) -> Path:
    """A landing up to a time on its glide, s, and a climb from there. Its flare, if begun, is no event any more: the
    nose stays turned into the wind. through_ground: allows a pull-up that touches it. Raises NoSuchPath."""
    first, last = path.events[GLIDE_START], path.events[TOUCHDOWN]
    if not first <= begin < last:
        text = f"a go-around at {begin:g} s is not within the glide, which lasts from {first:.2f} to {last:.2f} s"
        raise NoSuchPath(text)
    jet = path.jet(np.array([begin]))[0]
    speed = float(np.linalg.norm(jet[1]))
    gained = float(jet[1] @ jet[2]) / speed
    start = math.atan2(-jet[1, 2], jet[1, 0])
    turning = float(jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2]) / speed**2
    if start >= how.climb:
        raise NoSuchPath("the aircraft climbs as steeply already")
    # thrust: the remaining acceleration for the speed while the load factor rises
    speeds = speed + gained * series(lambda s: 1.0 - smooth_step(s / how.ease), how.ease).integ(lbnd=0.0)
    steady = float(speeds(how.ease))
    if steady <= 0.0:
        raise NoSuchPath(
            f"the aircraft would stop within ease_s, {how.ease:g} s: its deceleration is {-gained:.2f} m/s2"
        )
    felt = math.cos(start) + speed * turning / STANDARD_GRAVITY

    def on(load: float) -> Chebyshev:
        return _climb(start, lambda s: felt + (load - felt) * smooth_step(s / how.ease), speeds, 1.0)

    def off(load: float) -> Chebyshev:
        """Backwards, from its end."""
        level = math.cos(how.climb)
        return _climb(
            how.climb,
            lambda s: level + (load - level) * smooth_step(s / how.ease),
            constant(steady, how.ease),
            -1.0,
        )

    load = _reached(how, on, off)
    into, back = on(load), off(load)
    segments: list[AnySegment] = [each for each in path.segments if each.start < begin]
    if not segments:
        segments = [path.segments[0]]
    none = constant(0.0, how.ease)
    segments.append(Steered(begin, jet[0], speeds, into, none))
    now, low, high = begin + how.ease, float(into(how.ease)), float(back(how.ease))
    if load == how.load:
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        rates = STANDARD_GRAVITY * (load - np.cos(middle + half * _POINTS)) / steady
        held = float(half * (_SHARES @ (1.0 / rates)))
        flat = constant(steady, held)
        at = ended(segments[-1], now)[0]
        climbing = _climb(low, lambda s: np.full_like(s, load), flat, 1.0)
        segments.append(Steered(now, at, flat, climbing, constant(0.0, held)))
        now += held
    at = ended(segments[-1], now)[0]
    leaving = series(lambda s: back(how.ease - s), how.ease)
    segments.append(Steered(now, at, constant(steady, how.ease), leaving, none))
    now += how.ease
    at = ended(segments[-1], now)[0]
    velocity = steady * np.array([math.cos(how.climb), 0.0, -math.sin(how.climb)])
    segments.append(uniform(now, at, velocity, np.zeros(3)))
    events = {name: t for name, t in path.events.items() if t <= begin and name != FLARE}
    out = Path(tuple(segments), events | {GO_AROUND: begin})
    lowest = float(np.min(-out.jet(np.linspace(begin, now, 400))[:, 0, 2]))
    if lowest <= 0.0 and not through_ground:
        raise NoSuchPath(f"the pull-up of the go-around would go down to {lowest:.2f} m above the runway")
    return out


def _climb(start: float, load: Callable[[np.ndarray], np.ndarray], speed: Chebyshev, sign: float) -> Chebyshev:
    """The climb angle, of g (load - cos angle) / speed = sign * its rate, from `start`; a contraction."""
    duration = float(speed.domain[1])
    angle = constant(start, duration)
    for _ in range(_ROUNDS):
        now = angle
        rate = series(lambda s: STANDARD_GRAVITY * (load(s) - np.cos(now(s))) / speed(s), duration)  # noqa: B023
        angle = start + sign * rate.integ(lbnd=0.0)
        ends = np.linspace(0.0, duration, 5)
        if np.abs(angle(ends) - now(ends)).max() < 1e-15:
            break
    return angle


def _reached(how: PullUp, on: Callable[[float], Chebyshev], off: Callable[[float], Chebyshev]) -> float:
    """The load factor, or the smaller one by which coming on and off alone make the climb angle."""

    def short(load: float) -> bool:
        return bool(on(load)(how.ease) <= off(load)(how.ease))

    if short(how.load):
        return how.load
    low, high = math.cos(how.climb), how.load
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if short(middle) else (low, middle)
    return low
