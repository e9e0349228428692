"""Coarse alignment of recorded sensors: from standstill, and from the velocity of fixes while moving.

While an aircraft moves, its integrated specific force, in the axes of the start, equals its velocity change minus
gravity. One rotation aligns all pieces of the two. The method needs no assumption on side slip, and finds the heading
from any horizontal acceleration.

Sources: [1] Wu & Pan, Velocity/position integration formula part I: application to in-flight coarse alignment, IEEE
Trans. AES 49 (2013). [2] Groves (2013), section 5.6.2 (levelling).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from navsim.formats.recorded_data import Fixes, Headings, Samples
from navsim.geodesy import earth
from navsim.geodesy.attitude import (
    dcm_from_quaternion,
    dcm_from_rotation_vector,
    dcm_from_rpy,
    quaternion_from_dcm,
    wahba,
)


@dataclass(frozen=True)
class Standstill:
    """A time without motion."""

    since: float
    """Start of the standstill, s; begin .. end is its last part."""
    begin: float
    """s."""
    end: float
    """s."""
    rate: np.ndarray
    """(3,) mean."""
    force: np.ndarray
    """(3,) mean specific force."""
    rate_sigma: np.ndarray
    """(3,) 1 sigma of a sample."""
    force_sigma: np.ndarray
    """(3,) 1 sigma of a sample."""


@dataclass(frozen=True)
class Alignment:
    """Initial attitude and gyro bias."""

    time: float
    """s."""
    quaternion: np.ndarray
    """(4,) body to NED."""
    covariance: np.ndarray
    """(3, 3) of the attitude error in NED, rad2."""
    gyro_bias: np.ndarray
    """(3,) rad/s."""
    gyro_sigma: np.ndarray
    """(3,) 1 sigma of the bias."""
    since: float
    """First time of the data used, s."""
    until: float
    """Last time of the data used, s."""
    by_heading: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) effect of the error of a measured heading on the attitude, NED."""


WINDOW = 1.0
"""Length of the pieces that are tested for standstill, s."""
STILL_RATE, STILL_FORCE, STILL_SPEED = 0.05, 0.5, 0.5
"""Largest scatter (1 sigma) of rate, rad/s, and specific force, m/s2, and largest speed, m/s, of a standstill."""
STILL_WAY = 10.0
"""Largest distance of fixes of a body at rest, m, in addition to `STILL_SPEED` times their interval."""
AT_REST = 3.0
"""Mean rate and specific force of a body at rest are those of the Earth within this many sigmas of the biases."""
TURNED, TILTED = 0.01, 0.1
"""Largest difference of a piece at either end of a standstill from the median of all: mean rate, rad/s, and mean
specific force, m/s2. Four sigma of such means are accepted if that is more."""
SHORTEST, LONGEST = 3.0, 30.0
"""A standstill is used from the one length on, and up to the other, s: gyros warm up."""
STEP = 10.0
"""Time from one attempt at an alignment to the next, s."""
UNKNOWN = 100.0
"""1 sigma of a heading that is not known at all, rad: its square outweighs any other."""
BRIDGED = 1.0
"""Longest gap between samples across which an alignment is propagated, s."""
_PIECE = 1.0
"""Length of the pieces that velocities are compared over, s."""
_USUAL = 5.0
"""Pieces longer than this many usual ones, and sample intervals likewise, have something missing in them."""
_CAUTION = 4.0
"""Factor on the formal covariance, since residuals of neighbouring pieces are correlated."""
_G, _GRAVITY_VARIES = 9.8, 0.05
"""Gravity, and by how much it differs from place to place, m/s2."""


@dataclass(frozen=True)
class Search:
    """Requirements and assumptions of an alignment."""

    heading: float | None
    """Known heading at a standstill, rad, or None."""
    heading_sigma: float
    """1 sigma of the heading to reach, or of `heading`, rad."""
    longest: float
    """Longest motion to use, s."""
    gyro_sigma: float
    """1 sigma of the gyro biases, rad/s."""
    gyro_strays: float
    """1 sigma of the drift of a gyro bias after a standstill, rad/s."""
    accel_sigma: float
    """1 sigma of the accelerometer biases, m/s2."""
    headings: Headings | None = None
    """Measured headings."""


def find_alignment(samples: Samples, fixes: Fixes, first: float, wanted: Search) -> Alignment | None:
    """The earliest alignment from `first` on (s): at the end of a standstill, else under way; None without one.

    Fixes' times are those of validity. Nothing is aligned across an interval without samples that is longer than
    `BRIDGED`.
    """
    fixes = fixes.with_velocity()[0]
    missing = samples.missing(BRIDGED)
    last = float(min(samples.time[-1], fixes.time[-1]))
    begin = first
    while begin < last - SHORTEST:
        within = missing[(missing[:, 0] <= begin) & (missing[:, 1] > begin)]
        if within.size:
            begin = float(within[0, 1])
        later = missing[missing[:, 0] > begin, 0]
        until = float(later[0]) if later.size else np.inf
        search = wanted.longest if wanted.heading is None else LONGEST
        rest = find_standstill(samples, fixes, begin, min(begin + search, until), wanted)
        if rest is not None and wanted.heading is not None:
            sigma = _bias_sigma(samples, rest, wanted)
            return at_rest(rest, wanted.heading, wanted.heading_sigma, sigma, wanted.accel_sigma)
        if rest is not None and wanted.headings is not None and rest.since < begin + STEP:
            measured = wanted.headings.at(rest.end)
            level = at_rest(rest, 0.0, UNKNOWN, _bias_sigma(samples, rest, wanted), wanted.accel_sigma)
            if measured is not None:
                return update_heading(level, wanted.headings, measured)
        if wanted.heading is not None:
            return None
        start, bias, sigma = max(begin, float(fixes.time[0])), np.zeros(3), wanted.gyro_sigma
        since = start
        if rest is not None and rest.since < begin + STEP:  # before a later one there is motion to align from
            start, bias, sigma = rest.end, rest.rate, _bias_sigma(samples, rest, wanted)
            since = rest.since
        found = velocity_matching(
            samples, fixes, start, bias, sigma, wanted.accel_sigma, wanted.heading_sigma,
            min(wanted.longest, until - start), wanted.headings,
        )  # fmt: skip
        if found is not None:
            return replace(found, since=since)
        begin = start + STEP
    return None


def _bias_sigma(samples: Samples, rest: Standstill, wanted: Search) -> float:
    """1 sigma of the gyros' biases as the mean rates of a standstill show them, rad/s."""
    count = np.sum((samples.time >= rest.begin) & (samples.time <= rest.end))
    return float(np.hypot(rest.rate_sigma.max() / np.sqrt(count), wanted.gyro_strays))


def find_standstill(samples: Samples, fixes: Fixes, begin: float, end: float, wanted: Search) -> Standstill | None:
    """The last `LONGEST` seconds of the first standstill of some length within begin .. end; None without one.

    Pieces of `WINDOW` seconds are still if their scatter is small and no fix in them moves. Without fixes inside, the
    fixes around must be at one position without speed, and mean rate and force those of a body at rest. Scatter alone
    is not enough, since it is small in a steady turn too. Rate and force alone are not enough, since straight flight
    looks the same.
    """
    edges = np.arange(begin, end, WINDOW)
    speed = np.linalg.norm(fixes.velocity[:, :2], axis=1)
    still = []
    for first in edges:
        piece = samples.between(first, first + WINDOW)
        quiet = (
            piece.time.size > 4
            and piece.rate.std(axis=0).max() < STILL_RATE
            and piece.force.std(axis=0).max() < STILL_FORCE
        )
        inside = speed[(fixes.time >= first) & (fixes.time <= first + WINDOW)]
        if np.isfinite(inside).any():
            still.append(bool(quiet) and not np.any(inside > STILL_SPEED))
            continue
        still.append(bool(quiet) and _at_one_place(fixes, speed, first) and _feels_rest(piece, wanted))
    start = None
    for index, at_rest in enumerate([*still, False]):
        if at_rest and start is None:
            start = index
        if not at_rest and start is not None:
            alike = start + _alike([samples.between(t, t + WINDOW) for t in edges[start:index]])
            start = None
            if not alike.size:
                continue
            first, last = edges[alike[0]], edges[alike[-1]] + WINDOW
            if last - first >= SHORTEST:
                first = max(first, last - LONGEST)
                piece = samples.between(first, last)
                return Standstill(
                    float(edges[alike[0]]), float(first), float(last), piece.rate.mean(axis=0),
                    piece.force.mean(axis=0), piece.rate.std(axis=0), piece.force.std(axis=0),
                )  # fmt: skip
    return None


def _alike(pieces: list[Samples]) -> np.ndarray:
    """Numbers of the pieces (k,) whose mean rate and specific force are those of most."""
    differs = np.full(len(pieces), False)
    for of, most in (("rate", TURNED), ("force", TILTED)):
        values = [getattr(piece, of) for piece in pieces]
        means = np.array([each.mean(axis=0) for each in values])
        noise = np.array([each.std(axis=0) / np.sqrt(each.shape[0]) for each in values])
        away = np.abs(means - np.median(means, axis=0))
        differs |= (away > np.maximum(most, 4.0 * np.median(noise, axis=0))).any(axis=1)
    return np.flatnonzero(~differs)


def _at_one_place(fixes: Fixes, speed: np.ndarray, first: float) -> bool:
    """Whether the fixes before and after a piece from `first` on are at one place, without speed; speed: (m,)."""
    before, after = int(np.searchsorted(fixes.time, first)) - 1, int(np.searchsorted(fixes.time, first + WINDOW))
    if before < 0 or after >= fixes.time.size or np.any(speed[[before, after]] > STILL_SPEED):
        return False
    a, b = earth.ecef_from_llh(fixes.llh[[before, after]])
    return bool(np.linalg.norm(b - a) < STILL_WAY + STILL_SPEED * (fixes.time[after] - fixes.time[before]))


def _feels_rest(piece: Samples, wanted: Search) -> bool:
    """Whether the mean rate and specific force of samples are those of a body at rest."""
    rate, force = piece.rate.mean(axis=0), float(np.linalg.norm(piece.force.mean(axis=0)))
    slow = np.abs(rate).max() < AT_REST * wanted.gyro_sigma + earth.RATE
    return bool(slow) and abs(force - _G) < AT_REST * wanted.accel_sigma + _GRAVITY_VARIES


def level_attitude(force: np.ndarray, heading: float) -> np.ndarray:
    """C_nb (3, 3) of a body at rest from its mean specific force (3,), and a heading in rad [2]."""
    roll = np.arctan2(-force[1], -force[2])
    pitch = np.arctan2(force[0], np.hypot(force[1], force[2]))
    return dcm_from_rpy(np.array([roll, pitch, heading]))


def at_rest(rest: Standstill, heading: float, heading_sigma: float, gyro_sigma: float, accel_sigma: float) -> Alignment:
    """Levelled at the end of a standstill, with a known heading; rad, rad/s, m/s2 (the accelerometers' biases)."""
    covariance = np.diag([(accel_sigma / _G) ** 2, (accel_sigma / _G) ** 2, heading_sigma**2])
    quaternion = quaternion_from_dcm(level_attitude(rest.force, heading))
    return Alignment(rest.end, quaternion, covariance, rest.rate, np.full(3, gyro_sigma), rest.since, rest.end)


def propagate_axis(
    axis: np.ndarray, samples: Samples, time: float, later: float, gyro_bias: np.ndarray
) -> np.ndarray:  # fmt: skip
    """Where an axis (3,) of the body at a time pointed, in the axes of the body at a later one, s, by the gyros."""
    grid = np.unique(np.concatenate([samples.between(time, later).time, [time, later]]))
    rate = samples.at(grid)[0] - gyro_bias
    for turn in 0.5 * (rate[1:] + rate[:-1]) * np.diff(grid)[:, None]:
        axis = dcm_from_rotation_vector(-turn) @ axis
    return axis


def update_heading(found: Alignment, headings: Headings, measured: tuple[float, float, float]) -> Alignment:
    """An alignment updated with a measured heading, see `Headings.at`, of an axis of the body at the alignment. A
    heading that is not known at all takes the measured one."""
    turn = dcm_from_quaternion(found.quaternion)
    axis = turn @ headings.axis
    level = float(axis[0] ** 2 + axis[1] ** 2)
    h = np.array([-axis[0] * axis[2] / level, -axis[1] * axis[2] / level, 1.0])
    value, sigma, _ = measured
    away = np.angle(np.exp(1j * (value - np.arctan2(axis[1], axis[0]))))
    noise = sigma**2 + headings.lasting**2
    gain = found.covariance @ h / (h @ found.covariance @ h + noise)
    turned = dcm_from_rotation_vector(gain * away) @ turn
    left = np.eye(3) - np.outer(gain, h)
    covariance = left @ found.covariance @ left.T + noise * np.outer(gain, gain)
    return replace(found, quaternion=quaternion_from_dcm(turned), covariance=covariance, by_heading=gain)


def velocity_matching(
    samples: Samples,
    fixes: Fixes,
    begin: float,
    gyro_bias: np.ndarray,
    gyro_sigma: float,
    accel_sigma: float,
    heading_sigma: float,
    longest: float,
    headings: Headings | None = None,
) -> Alignment | None:
    """Attitude at `begin` from the velocities of the fixes after it, as soon as the heading is good to `heading_sigma`.

    gyro_bias: (3,) rad/s to take off, and its 1 sigma; accel_sigma: of the accelerometers' biases, m/s2; both widen the
    covariance. longest: s after which to give up: None. Fixes' times are those of validity [1]. headings: measured
    ones, of which the last up to `begin` counts, turned by the gyros.
    """
    measured = None if headings is None else headings.at(begin)
    if headings is not None and measured is not None:
        headings = replace(headings, axis=propagate_axis(headings.axis, samples, measured[2], begin, gyro_bias))
    wanted = (fixes.time >= begin) & (fixes.time <= begin + longest) & np.isfinite(fixes.velocity).all(axis=1)
    fixes = fixes.take(wanted)
    time = fixes.time
    if time.size < 4:
        return None
    force_integral, ahead = _integrated_force(samples.between(begin - 1.0, time[-1] + 1.0), begin, time, gyro_bias)
    gained = _gained(time - begin, fixes.velocity, fixes.llh)
    # pieces of about a second: shorter ones are all noise
    pick = [0]
    for index in range(1, time.size):
        if time[index] - time[pick[-1]] >= _PIECE - 1e-6:
            pick.append(index)
    a, b, length = np.diff(force_integral[pick], axis=0), np.diff(gained[pick], axis=0), np.diff(time[pick])
    # one across a pause of the fixes is as large as all others together, and as wrong as the gyros by then
    usual = np.flatnonzero(length <= _USUAL * np.median(length))
    a, b, length, ends = a[usual], b[usual], length[usual], np.array(pick)[usual + 1]
    bridged = samples.missing(_USUAL * float(np.median(np.diff(samples.time))))
    invented = np.mean(samples.rate.var(axis=0)) * np.diff(bridged, axis=1)[:, 0] ** 2
    for count in range(3, usual.size + 1):
        turn = wahba(a[:count], b[:count])
        residual = b[:count] - a[:count] @ turn.T
        scatter = np.sum(residual**2) / (3 * count - 3)
        # a piece contains no information about a rotation about itself
        information = np.sum(b[:count] ** 2) * np.eye(3) - b[:count].T @ b[:count]
        until = float(time[ends[count - 1]])
        covariance = _CAUTION * scatter * np.linalg.pinv(information)
        covariance += ((gyro_sigma * 0.5 * (until - begin)) ** 2 + (accel_sigma / _G) ** 2) * np.eye(3)
        covariance += np.sum(invented[(bridged[:, 0] >= begin) & (bridged[:, 1] <= until)]) * np.eye(3)
        # an accelerometer's bias that rotates with the body looks like acceleration: with the real horizontal one it
        # rotates the heading. In straight flight it looks like a tilt, which the line above includes
        horizontal = np.sum(b[:count, :2] ** 2)
        straight = float(np.linalg.norm(ahead[[0, *ends[:count]]].mean(axis=0)))
        fooled = np.sum((accel_sigma * length[:count]) ** 2) / max(horizontal, 1e-9)
        covariance[2, 2] += (1.0 - min(straight, 1.0) ** 2) * fooled
        sigma = np.full(3, gyro_sigma)
        found = Alignment(begin, quaternion_from_dcm(turn), covariance, gyro_bias, sigma, begin, until)
        if headings is not None and measured is not None:
            found = update_heading(found, headings, measured)
        if np.sqrt(np.diag(found.covariance)[0 if measured else 2 :].max()) < heading_sigma:
            return found
    return None


def _integrated_force(
    samples: Samples, begin: float, time: np.ndarray, bias: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integral of specific force from `begin` to the times (m,), and where the nose points then, both (m, 3) in the
    body axes of `begin` as they stay inertially."""
    from scipy.spatial.transform import Rotation

    grid = np.unique(np.concatenate([samples.time[samples.time > begin], [begin], time]))
    rate, force = samples.at(grid)
    rate = rate - bias
    step = np.diff(grid)[:, None]
    turns = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * step)
    attitude = [Rotation.identity()]
    for turn in turns:
        attitude.append(attitude[-1] * turn)
    turned = Rotation.concatenate(attitude)
    at = np.searchsorted(grid, time)
    return _integral(grid, turned.apply(force))[at], turned[at].apply([1.0, 0.0, 0.0])


def _gained(since: np.ndarray, velocity: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """`_carried` from the fixes: velocity minus gravity and the rotation of the axes, in NED of time 0 [1]."""
    from scipy.spatial.transform import Rotation

    gravity: np.ndarray = np.linalg.norm(earth.gravity_ecef(earth.ecef_from_llh(llh)), axis=1)
    lat, height = llh[:, 0], llh[:, 2]
    w = np.sqrt(1.0 - earth.E2 * np.sin(lat) ** 2)
    transverse = earth.A / w
    meridian = transverse * (1.0 - earth.E2) / w**2
    rate = earth.RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=1)
    east = velocity[:, 1] / (transverse + height)
    turning = rate + np.stack([east, -velocity[:, 0] / (meridian + height), -east * np.tan(lat)], axis=1)
    axes = Rotation.from_rotvec(since[:1, None] * turning[:1] + _integral(since, turning))
    drive = np.cross(rate, velocity)
    drive[:, 2] -= gravity
    return axes.apply(velocity) + _integral(since, axes.apply(drive))


def _integral(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Trapezoid sums (m, 3) of a rate from the first time on."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
