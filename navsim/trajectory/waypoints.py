"""Paths by waypoints: straight legs joined by fly-by turns, coordinated, level, of a bank angle.

Source: `docs/theory/trajectory.md`, section 3.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.geodesy.earth import STANDARD_GRAVITY
from navsim.trajectory.approach import HARDEST
from navsim.trajectory.path import (
    AnySegment,
    Arc,
    NoSuchPath,
    Path,
    Steered,
    constant,
    ended,
    series,
    shifted,
    smooth_step,
    straight,
    uniform,
)

STEEPEST = math.radians(30.0)
"""Largest angle of climb and descent on a leg, rad."""
_NEAREST = 1.0
"""Waypoints lie at least so far apart, m."""
_BESIDE = 0.5
"""Largest distance of the last waypoint of a landing from the extended centre line, m."""
_STRAIGHT, _BACK = 1e-9, math.radians(175.0)
"""Corners of less are none, rad; of more, no turn can be flown by."""
_POINTS, _SHARES = np.polynomial.legendre.leggauss(60)


@dataclass(frozen=True)
class Waypoint:
    """A place to fly by: x and y in the axes of the path, height over the runway, m; ground speed there, m/s."""

    x: float
    y: float
    height: float
    speed: float

    @property
    def position(self) -> np.ndarray:
        """(3,) in the axes of the path."""
        return np.array([self.x, self.y, -self.height])


@dataclass(frozen=True)
class Turn:
    """A level turn at constant speed: roll in, steady bank, roll out.

    While rolling, bank = `bank` S(s / roll), with S the step whose first two derivatives vanish at its ends.
    """

    speed: float
    """m/s."""
    angle: float
    """rad, to the right positive."""
    bank: float
    """Bank of the steady part, rad, positive."""
    roll: float
    """Duration of the roll in, and of the roll out, s."""
    steady: float
    """Duration of the steady part, s."""

    @property
    def rate(self) -> float:
        """Rate of turn in the steady part, rad/s, to the right positive."""
        return math.copysign(STANDARD_GRAVITY * math.tan(self.bank) / self.speed, self.angle)

    @property
    def duration(self) -> float:
        """Total duration, s."""
        return 2.0 * self.roll + self.steady

    def flown(self, start: float, position: np.ndarray, track: float) -> list[AnySegment]:
        """Its segments from a time, a place (3,) and a track (rad)."""
        side, gained = math.copysign(1.0, self.angle), rolled(self.speed, self.bank, self.roll)

        def rate(s: np.ndarray) -> np.ndarray:
            bank = self.bank * smooth_step(s / self.roll)
            return side * STANDARD_GRAVITY * np.tan(bank) / self.speed

        speed, level = constant(self.speed, self.roll), constant(0.0, self.roll)
        into = Steered(start, position, speed, level, track + series(rate, self.roll).integ(lbnd=0.0))
        out: list[AnySegment] = [into]
        now, at = start + self.roll, ended(into, start + self.roll)[0]
        if self.steady > 0.0:
            out.append(Arc(now, at, track + side * gained, self.speed, self.rate))
            now += self.steady
            at = ended(out[-1], now)[0]
        heading = track + self.angle - side * gained
        back = series(lambda s: rate(self.roll - s), self.roll).integ(lbnd=0.0)
        out.append(Steered(now, at, speed, level, heading + back))
        return out

    def lead(self) -> float:
        """Distance before the corner at which it begins, and after it at which it ends, m; R tan(angle / 2) for instant
        rolling."""
        end = ended(self.flown(0.0, np.zeros(3), 0.0)[-1], self.duration)[0]
        return float(0.5 * math.hypot(end[0], end[1]) / math.cos(0.5 * self.angle))


def rolled(speed: float, bank: float, roll: float) -> float:
    """Change of track while rolling from level to a bank, rad, positive."""
    s = 0.5 * (1.0 + _POINTS)
    return float(0.5 * roll * STANDARD_GRAVITY / speed * (_SHARES @ np.tan(bank * smooth_step(s))))


def turn(speed: float, angle: float, bank: float, roll: float) -> Turn:
    """The turn through an angle (rad, to the right positive) at a bank, or where rolling in and out at once makes more
    of it, at the smaller bank that makes just that."""
    rest = abs(angle) - 2.0 * rolled(speed, bank, roll)
    if rest >= 0.0:
        return Turn(speed, angle, bank, roll, rest * speed / (STANDARD_GRAVITY * math.tan(bank)))
    low, high = 0.0, bank
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if 2.0 * rolled(speed, middle, roll) < abs(angle) else (low, middle)
    return Turn(speed, angle, low, roll, 0.0)


def legs(points: Sequence[Waypoint], bank: float, roll: float, final: bool) -> tuple[list[AnySegment], float]:
    """Segments through waypoints from time 0 over the first, and the time, s, and position of their end.

    final: whether to turn at the last waypoint, too, onto the x axis; otherwise the flight continues straight over it.
    Raises NoSuchPath.
    """
    tracks, lengths = [], []
    for i, (a, b) in enumerate(itertools.pairwise(points)):
        lengths.append(math.hypot(b.x - a.x, b.y - a.y))
        if lengths[-1] < _NEAREST:
            raise NoSuchPath(f"waypoints {i + 1} and {i + 2} lie {lengths[-1]:.2f} m apart", i + 1)
        tracks.append(math.atan2(b.y - a.y, b.x - a.x))
    courses = [*tracks, 0.0] if final else tracks
    turns: list[Turn | None] = [None]
    for i, (before, after) in enumerate(itertools.pairwise(courses), 1):
        point, angle = points[i], math.remainder(after - before, 2.0 * math.pi)
        if abs(angle) > _BACK:
            text = f"the way turns back by {abs(math.degrees(angle)):.0f} deg at waypoint {i + 1}; set another between"
            raise NoSuchPath(text, i)
        turns.append(turn(point.speed, angle, bank, roll) if abs(angle) > _STRAIGHT else None)
    turns += [None] * (len(points) - len(turns))
    leads = [0.0 if each is None else each.lead() for each in turns]
    segments: list[AnySegment] = []
    now = 0.0
    for i, (a, b) in enumerate(itertools.pairwise(points)):
        length = lengths[i] - leads[i] - leads[i + 1]
        if length < 0.0:
            told = " and ".join(_turn_text(n, turns[n], leads[n]) for n in (i, i + 1) if turns[n] is not None)
            text = f"the leg from waypoint {i + 1} to {i + 2} is {lengths[i]:.1f} m long, too short for {told}"
            raise NoSuchPath(text, i + 1)
        if length > 0.0:
            at = a.position + leads[i] * np.array([math.cos(tracks[i]), math.sin(tracks[i]), 0.0])
            leg, taken = straight(now, at, tracks[i], (a.speed, b.speed), (a.height, b.height), length)
            _check_leg(i, a, b, taken)
            segments.append(leg)
            now += taken
        elif (a.speed, a.height) != (b.speed, b.height):
            raise NoSuchPath(f"no way is left from waypoint {i + 1} to {i + 2} to change speed or height on", i + 1)
        if (bend := turns[i + 1]) is not None:
            way = np.array([math.cos(tracks[i]), math.sin(tracks[i]), 0.0])
            segments += bend.flown(now, b.position - leads[i + 1] * way, tracks[i])
            now += bend.duration
    return segments, now


def _turn_text(number: int, bend: Turn | None, lead: float) -> str:
    assert bend is not None
    degrees = abs(math.degrees(bend.angle))
    return f"the turn of {degrees:.0f} deg at waypoint {number + 1}, which takes {lead:.1f} m of it"


def _check_leg(i: int, a: Waypoint, b: Waypoint, taken: float) -> None:
    """Raise for a leg that is too steep or too hard."""
    angle = math.atan(1.875 * abs(b.height - a.height) / taken / min(a.speed, b.speed))
    where = f"between waypoints {i + 1} and {i + 2}"
    if angle > STEEPEST:
        steepest = math.degrees(STEEPEST)
        text = f"height changes by up to {math.degrees(angle):.0f} deg {where}, allowed are {steepest:.0f}"
        raise NoSuchPath(text, i + 1)
    change = 1.5 * abs(b.speed - a.speed) / taken
    if change > HARDEST:
        text = f"speed changes by up to {change:.1f} m/s2 {where}, allowed are {HARDEST:g}"
        raise NoSuchPath(text, i + 1)


def landing(points: Sequence[Waypoint], bank: float, roll: float, profile: Callable[[float], Path]) -> Path:
    """Legs through waypoints, the last on the extended centre line, and the descent from there.

    `profile` gives the descent after so many seconds of level flight at the last waypoint's speed. Raises NoSuchPath.
    """
    last = points[-1]
    if abs(last.y) > _BESIDE:
        text = f"waypoint {len(points)}, the last, lies {abs(last.y):.1f} m off the extended centre line"
        raise NoSuchPath(f"{text}, on which the aircraft lands", len(points) - 1)
    segments, end = legs([*points[:-1], replace(last, y=0.0)], bank, roll, final=True)
    one = ended(profile(1.0).segments[0], 1.0)[0, 0]
    left = float(one - ended(segments[-1], end)[0, 0])
    if left < 0.0:
        text = f"the flight comes onto final {-left:.1f} m too late: there the glide-slope capture has begun"
        raise NoSuchPath(f"{text}; set waypoint {len(points)} farther out, or lower", len(points) - 1)
    rest = shifted(profile(left / last.speed), end)
    return Path((*segments, *rest.segments), rest.events)


def cruise(points: Sequence[Waypoint], bank: float, roll: float) -> Path:
    """Legs through waypoints, and straight over the last. Raises NoSuchPath."""
    segments, end = legs(points, bank, roll, final=False)
    jet = ended(segments[-1], end)
    return Path((*segments, uniform(end, jet[0], jet[1], np.zeros(3))), {})


def circuit(side: float, begin: float, offset: float, final: float, flown: tuple[float, float]) -> list[Waypoint]:
    """Downwind, base and final of a traffic circuit.

    - `side`: 1 for a circuit to the right of the runway, -1 to the left.
    - `begin`: x at the start of downwind, m; `offset`: distance of downwind from the centre line, m.
    - `final`: x of the corners of base, m; `flown`: height, m, and speed, m/s.
    """
    abeam = side * offset
    return [Waypoint(begin, abeam, *flown), Waypoint(final, abeam, *flown), Waypoint(final, 0.0, *flown)]
