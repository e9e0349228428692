"""The glide approach: the paper's piecewise profile and a smooth one a real aircraft could fly.

Source: `docs/theory/trajectory.md`, sections 1, 2, 5. Speeds are along the path over ground.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from navsim.statistics.rounding import digits
from navsim.trajectory.path import DEGREE, AnySegment, Arc, Path, Segment, blend, ended, shifted, uniform

GLIDE_START, FLARE, TOUCHDOWN = "glide_start", "flare", "touchdown"
ROLL_OUT, TAXI, STAND = "roll_out", "taxi", "stand"
"""Events of a roll-out: the gear has settled and the path is the runway's x axis; taxi speed is reached; the aircraft
stops."""
HOVER, DESCENT = "hover", "descent"
"""Events of a landing on a pad: the aircraft hovers over it; it begins to descend vertically."""
HARDEST = 5.0
"""Largest acceleration along a leg, m/s2."""
_X, _Z = 0, 2


def joined(begin: float, end: float, before: AnySegment, after: AnySegment) -> Segment:
    """The blend from `before` at one time to `after` at a later one."""
    return blend(begin, end, before.jet(np.array([begin]))[0], after.jet(np.array([end]))[0])


def paper_profile(speed_start: float, speed_touchdown: float, height: float, slope: float, corner: float) -> Path:
    """Uniformly decelerated glide from time 0, then level flight at the touchdown speed.

    The paper's corner between the two is instantaneous; an IMU cannot live through that, so velocity and
    acceleration are joined within `corner` seconds around it. Outside of them the path is the paper's.

    speed_*: m/s. height: of the start over the touchdown point, m. slope: rad. corner: s.
    """
    slant = height / math.sin(slope)
    touchdown = 2.0 * slant / (speed_start + speed_touchdown)
    deceleration = (speed_start - speed_touchdown) / touchdown
    along = np.array([math.cos(slope), 0.0, math.sin(slope)])
    ahead = np.array([1.0, 0.0, 0.0])
    glide = uniform(0.0, -slant * along, speed_start * along, -deceleration * along)
    level = uniform(touchdown, np.zeros(3), speed_touchdown * ahead, np.zeros(3))
    begin, end = touchdown - 0.5 * corner, touchdown + 0.5 * corner
    joint = joined(begin, end, glide, level)
    level = uniform(end, speed_touchdown * 0.5 * corner * ahead, speed_touchdown * ahead, np.zeros(3))
    return Path((glide, joint, level), {GLIDE_START: 0.0, TOUCHDOWN: touchdown})


def captured_paper_profile(
    speed_start: float,
    speed_touchdown: float,
    height: float,
    slope: float,
    lead_in: float,
    capture: float,
    corner: float,
) -> Path:
    """Level lead-in and glide-slope capture as of `smooth_profile`, and from there the paper's profile.

    As of both. Raises ValueError where no such path exists.
    """
    sin, cos = math.sin(slope), math.cos(slope)
    below = height - speed_start * sin * 0.5 * capture
    if below <= 0.0:
        raise ValueError("the glide-slope capture would end below the runway")
    paper = shifted(paper_profile(speed_start, speed_touchdown, below, slope, corner), lead_in + capture)
    before = below / math.tan(slope) + speed_start * (0.5 * capture * (1.0 + cos) + lead_in)
    if paper.segments[1].start < paper.segments[0].start:
        raise ValueError("the corner at touchdown would begin before the glide-slope capture ends")
    level = uniform(0.0, np.array([-before, 0.0, -height]), np.array([speed_start, 0.0, 0.0]), np.zeros(3))
    joint = joined(lead_in, lead_in + capture, level, paper.segments[0])
    return Path((level, joint, *paper.segments), paper.events | {GLIDE_START: lead_in})


@dataclass(frozen=True)
class Taxi:
    """End of the roll-out."""

    speed: float
    """Final speed, m/s; 0 to stop."""
    ease: float
    """Time in which the brakes come on and off, s."""
    time: float | None
    """Time at this speed before a full stop, s; None: no stop."""


@dataclass(frozen=True)
class Ending:
    """End of a smooth profile: flare, touchdown and roll-out."""

    height: float
    """Height at which the flare begins, m."""
    blend: float
    """Duration of the blend from the slope into the flare, s."""
    sink: float
    """Sink rate at touchdown relative to the runway, m/s."""
    settle: float
    """Time in which the landing gear absorbs it, s."""
    deceleration: float
    """Deceleration of the roll-out, m/s2."""
    taxi: Taxi | None = None
    """End of the roll-out; None: the speed stays."""
    rise: float = 0.0
    """Rise of the runway, m a m."""


def smooth_profile(
    speed_start: float,
    speed_touchdown: float,
    height: float,
    slope: float,
    lead_in: float,
    capture: float,
    ending: Ending,
) -> Path:
    """Level lead-in, glide-slope capture, uniform deceleration on the slope, exponential flare, roll-out.

    Continuous in position, velocity and acceleration. In the flare the sink rate falls exponentially with height, h + c
    = (h_f + c) exp(-t / tau), from that on the slope to that at touchdown. The landing gear then absorbs the rest.

    - `speed_start`, `speed_touchdown`: ground speeds, m/s; `slope`: rad.
    - `height`: of the lead-in above the touchdown point, m; `lead_in`, `capture`: durations, s.

    Raises ValueError if no such path exists.
    """
    flare_height, flare_blend = ending.height, ending.blend
    climb = ending.rise * speed_touchdown
    if climb >= ending.sink:
        raise ValueError(
            f"at touchdown the runway rises under the aircraft by {climb:.2f} m/s, no less than it is to sink against "
            f"it, {ending.sink:.2f} m/s: nothing is left to flare to"
        )
    sink_touchdown = ending.sink - climb
    settle, rollout_deceleration = ending.settle, ending.deceleration
    t1 = lead_in
    t2 = t1 + capture
    sin, cos = math.sin(slope), math.cos(slope)
    h2 = height - speed_start * sin * 0.5 * capture
    if h2 - flare_height < speed_start * sin * 0.5 * flare_blend:
        raise ValueError("the flare would begin before the glide-slope capture ends")

    deceleration = 0.0
    for _ in range(200):  # a contraction: deceleration is a few per cent of gravity
        drop = (h2 - flare_height) / sin
        root = speed_start**2 - 2.0 * deceleration * drop
        if root <= 0.0:
            raise ValueError(
                f"decelerating from {digits(3.6 * speed_start, 4)} to {digits(3.6 * speed_touchdown, 4)} km/h does "
                "not fit this glide; change speed_start_kmh, speed_touchdown_kmh, start_height_m or glide_slope_deg"
            )
        glide_time = 2.0 * drop / (speed_start + math.sqrt(root))
        sink = sin * (speed_start - deceleration * glide_time)
        if sink <= sink_touchdown:
            raise ValueError(
                f"the sink rate on the slope ({sink:.2f} m/s) is not above the one at touchdown "
                f"({sink_touchdown:.2f} m/s)"
            )
        tau = flare_height / (sink - sink_touchdown)
        flare_time = tau * math.log(sink / sink_touchdown)
        update = (speed_start * cos - speed_touchdown) / ((glide_time + flare_time) * cos)
        if abs(update - deceleration) < 1e-15:
            break
        deceleration = update
    t3 = t2 + glide_time
    t4 = t3 + flare_time
    t5 = t4 + settle
    if flare_blend > min(glide_time, flare_time):
        raise ValueError("the blend into the flare is longer than the glide or the flare itself")

    braking = deceleration * cos
    run = t4 - t2
    x2 = -(speed_start * cos * run - 0.5 * braking * run**2)
    x1 = x2 - speed_start * capture * 0.5 * (1.0 + cos)
    level = uniform(
        0.0, np.array([x1 - speed_start * t1, 0.0, -height]), np.array([speed_start, 0.0, 0.0]), np.zeros(3)
    )
    glide = uniform(
        t2,
        np.array([x2, 0.0, -h2]),
        np.array([speed_start * cos, 0.0, speed_start * sin]),
        np.array([-braking, 0.0, -deceleration * sin]),
    )

    # flare: x continues as on the slope, height is exponential about -c
    c = sink_touchdown * tau
    state3 = glide.jet(np.array([t3]))[0]
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[_X, :3] = state3[0, _X], state3[1, _X], 0.5 * state3[2, _X]
    polynomial[_Z, 0] = c
    flare = Segment(t3, polynomial, np.array([0.0, 0.0, -(flare_height + c)]), tau)

    # roll-out: the braking builds up linearly while the gear settles
    speed5 = speed_touchdown - 0.5 * (braking + rollout_deceleration) * settle
    x5 = speed_touchdown * settle - (braking / 3.0 + rollout_deceleration / 6.0) * settle**2
    rollout = uniform(
        t5,
        np.array([x5, 0.0, 0.0]),
        np.array([speed5, 0.0, 0.0]),
        np.array([-rollout_deceleration, 0.0, 0.0]),
    )

    begin, end = t3 - 0.5 * flare_blend, t3 + 0.5 * flare_blend
    entry = joined(begin, end, glide, flare)
    shift = flare.jet(np.array([end]))[0]
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[_X, :3] = shift[0, _X], shift[1, _X], 0.5 * shift[2, _X]
    polynomial[_Z, 0] = c
    flare = Segment(end, polynomial, np.array([0.0, 0.0, shift[0, _Z] - c]), tau)
    segments = (
        level,
        joined(t1, t2, level, glide),
        glide,
        entry,
        flare,
        joined(t4, t5, flare, rollout),
        rollout,
    )
    path = Path(segments, {GLIDE_START: t1, FLARE: t3, TOUCHDOWN: t4})
    return path if ending.taxi is None else _slowed(path, rollout_deceleration, ending.taxi)


@dataclass(frozen=True)
class Hover:
    """A hover over a pad and the vertical descent onto it."""

    height: float
    """Of the hover above the pad, m."""
    time: float
    """Duration of the hover, s."""
    sink: float
    """Rate of descent, m/s."""
    ease: float
    """Time in which the descent begins, and ends, s."""


def pad_profile(speed: float, height: float, slope: float, lead_in: float, capture: float, hover: Hover) -> Path:
    """Level lead-in, capture, decelerated glide to a hover, vertical descent to rest on a pad at the origin.

    Continuous in position, velocity and acceleration. On the glide and at both ends of the descent the speed changes by
    a cubic without acceleration at its ends.

    - `speed`: at the start, m/s; `height`: of the lead-in above the pad, m; `slope`: rad.
    - `lead_in`, `capture`: durations, s.

    Raises ValueError if no such path exists.
    """
    sin, cos = math.sin(slope), math.cos(slope)
    captured = height - 0.5 * speed * sin * capture
    slant = (captured - hover.height) / sin
    if slant <= 0.0:
        raise ValueError(
            f"the glide-slope capture ends {captured:.1f} m above the pad, below the hover at {hover.height:g} m: give "
            "a shorter capture_s, a greater start_height_m or a lower hover_height_m"
        )
    glide_time = 2.0 * slant / speed
    if (hardest := 1.5 * speed / glide_time) > HARDEST:
        raise ValueError(
            f"the glide brakes at up to {hardest:.1f} m/s2, at most {HARDEST:g} are allowed: give a slower "
            "speed_start_kmh, a greater start_height_m or a smaller glide_slope_deg"
        )
    steady = hover.height / hover.sink - hover.ease
    if steady < 0.0:
        raise ValueError(
            f"a descent at {hover.sink:g} m/s, begun and ended within {hover.ease:g} s each, takes "
            f"{hover.sink * hover.ease:g} m; hover_height_m is {hover.height:g}"
        )
    down, rest = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    along, ahead = np.array([cos, 0.0, sin]), np.array([1.0, 0.0, 0.0])
    stop = -hover.height * down
    corner = stop - slant * along
    first = corner - 0.5 * speed * capture * (ahead + along) - speed * lead_in * ahead
    t1, t2 = lead_in, lead_in + capture
    level, glide = uniform(0.0, first, speed * ahead, rest), uniform(t2, corner, speed * along, rest)
    segments: list[AnySegment] = [level, joined(t1, t2, level, glide)]
    begins = {GLIDE_START: t1, HOVER: t2 + glide_time, DESCENT: t2 + glide_time + hover.time}
    segments += [_speeding(t2, corner, along, (speed, 0.0), glide_time), uniform(begins[HOVER], stop, rest, rest)]
    now, sink = begins[DESCENT], hover.sink
    eased = 0.5 * sink * hover.ease * down
    segments += [
        _speeding(now, stop, down, (0.0, sink), hover.ease),
        uniform(now + hover.ease, stop + eased, sink * down, rest),
        _speeding(now + hover.ease + steady, -eased, down, (sink, 0.0), hover.ease),
    ]
    begins[TOUCHDOWN] = now + 2.0 * hover.ease + steady
    return Path((*segments, uniform(begins[TOUCHDOWN], rest, rest, rest)), begins)


def _speeding(
    start: float, position: np.ndarray, direction: np.ndarray, speeds: tuple[float, float], time: float
) -> Segment:
    """A straight segment whose speed changes within a time, s, by a cubic without acceleration at either end."""
    change = speeds[1] - speeds[0]
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[:, 0] = position
    polynomial[:, 1], polynomial[:, 3], polynomial[:, 4] = (
        factor * direction for factor in (speeds[0], change / time**2, -0.5 * change / time**3)
    )
    return Segment(start, polynomial)


def sloped(path: Path, slope: float) -> Path:
    """A landing on a runway that rises by `slope`, m a m, in the direction of landing.

    After touchdown the path follows that slope, after a blend. A path without a touchdown does not change. After the
    blend the path is along the x axis, as in the profiles here.
    """
    touchdown = path.events.get(TOUCHDOWN)
    if slope == 0.0 or touchdown is None:
        return path
    last = max(i for i, each in enumerate(path.segments) if each.start <= touchdown)
    up = []
    for each in path.segments[last + 1 :]:
        assert isinstance(each, Segment)
        polynomial = each.polynomial.copy()
        polynomial[_Z] -= slope * polynomial[_X]
        up.append(replace(each, polynomial=polynomial))
    begin, end = path.segments[last].start, up[0].start
    joint = joined(begin, end, path.segments[last - 1], up[0])
    return replace(path, segments=(*path.segments[:last], joint, *up))


def _slowed(path: Path, deceleration: float, taxi: Taxi) -> Path:
    """A path whose last segment brakes along the x axis, with taxiing instead. Raises ValueError."""
    rollout = path.segments[-1]
    fast = float(ended(rollout, rollout.start)[1, _X])
    if fast <= taxi.speed:
        raise ValueError(f"the roll-out begins at {3.6 * fast:.1f} km/h, no faster than taxi_speed_kmh: give less")
    if deceleration <= 0.0:
        raise ValueError("the roll-out is not braked: give rollout_deceleration_m_s2")
    # full brakes until they are let go; a small difference of speed leaves less time for that
    ease = min(taxi.ease, 2.0 * (fast - taxi.speed) / deceleration)
    begin = rollout.start + (fast - taxi.speed) / deceleration - 0.5 * ease
    off = _eased(begin, ended(rollout, begin), ease, deceleration, on=False)
    now = begin + ease
    segments = [*path.segments, off, _rolling(now, off, taxi.speed)]
    events = path.events | {ROLL_OUT: rollout.start, TAXI if taxi.speed > 0.0 else STAND: now}
    if taxi.speed > 0.0 and taxi.time is not None:
        now += taxi.time
        # at most at the deceleration of the roll-out; less where on and off take all the time there is
        deceleration = min(deceleration, taxi.speed / taxi.ease)
        segments.append(_eased(now, ended(segments[-1], now), taxi.ease, deceleration, on=True))
        now += taxi.ease
        if (full := taxi.speed / deceleration - taxi.ease) > 0.0:
            jet = ended(segments[-1], now)
            segments.append(uniform(now, jet[0], jet[1], np.array([-deceleration, 0.0, 0.0])))
            now += full
        segments.append(_eased(now, ended(segments[-1], now), taxi.ease, deceleration, on=False))
        now += taxi.ease
        segments.append(_rolling(now, segments[-1], 0.0))
        events[STAND] = now
    return Path(tuple(segments), events)


def _eased(start: float, jet: np.ndarray, ease: float, deceleration: float, on: bool) -> Segment:
    """Brakes that come on, or off, by u = 3 (s/ease)^2 - 2 (s/ease)^3 of a deceleration."""
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[:, 0], polynomial[_X, 1] = jet[0], jet[1, _X]
    sign = 1.0 if on else -1.0
    polynomial[_X, 2] = 0.0 if on else -0.5 * deceleration
    polynomial[_X, 4:] = -sign * deceleration / (4.0 * ease**2), sign * deceleration / (10.0 * ease**3)
    return Segment(start, polynomial)


def _rolling(start: float, before: AnySegment, speed: float) -> Segment:
    """On from another segment along x, at a constant speed that it has come to."""
    return uniform(start, ended(before, start)[0], np.array([speed, 0.0, 0.0]), np.zeros(3))


def s_turn(speed: float, height: float, rate: float, period: float, blend_time: float, duration: float) -> Path:
    """Level flight turning right and left in turn, for filters to prove themselves in.

    speed: m/s; height: over the origin, m; rate: of turn, rad/s; period: of one right and one left turn, s;
    blend_time: rolling from one side to the other, s; duration: s. The first turn is a half one, so that the
    track swings about the x axis. Raises ValueError where the rolls would not fit between the turns.
    """
    half = 0.5 * period
    if blend_time > 0.5 * half:
        raise ValueError("rolling takes more than half of each turn")
    arcs = [Arc(0.0, np.array([0.0, 0.0, -height]), 0.0, speed, rate)]
    end = 0.5 * half
    while end < duration:
        last = arcs[-1]
        at = last.jet(np.array([end]))[0]
        arcs.append(Arc(end, at[0], last.track + last.rate * (end - last.start), speed, -last.rate))
        end += half
    segments: list[AnySegment] = [arcs[0]]
    for before, after in itertools.pairwise(arcs):
        begin, end = after.start - 0.5 * blend_time, after.start + 0.5 * blend_time
        segments.append(joined(begin, end, before, after))
        at = after.jet(np.array([end]))[0]
        segments.append(Arc(end, at[0], after.track + after.rate * (end - after.start), speed, after.rate))
    return Path(tuple(segments), {})
