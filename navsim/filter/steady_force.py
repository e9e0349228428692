"""Steady specific force: prevent accelerometer noise from counting as information about heading.

A heading error affects velocity through the horizontal specific force. The filter knows only the measured force, and
its noise would count as force. In steady flight the filter would then learn a heading that no measurement shows. So
while the velocity, confirmed by fixes, follows a straight line, attitude errors are coupled to velocity errors by the
change of that line, not by the measured change. In a manoeuvre, which the tests here detect, the measured force is used
again, and the omitted part is restored.

A young line has the noise of the fixes. While the attitude is constant, the mean measured force in body axes since the
start of the line estimates the noise of an interval better. The line still decides.

The line belongs to the filter, not to a component: it follows the mean velocity of a Gaussian sum.

Source: `docs/theory/steady-force.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, no, small_matrix, small_vector, where
from navsim.compiler.linear import copy
from navsim.filter.records import (
    STEADY_AGE,
    STEADY_BEGUN,
    STEADY_COUNT,
    STEADY_FORCE,
    STEADY_IS,
    STEADY_LAST,
    STEADY_LEFT,
    STEADY_LINE,
    STEADY_OMITTED,
    STEADY_ROUGHNESS,
    STEADY_SLOPE,
    STEADY_STEP,
    STEADY_TIME,
    STEADY_USES_FORCE,
    TIME_TOLERANCE,
)
from navsim.filter.states import NAV_BIAS_FRAME, NAV_QUAT, NAV_VEL, PHI_D, PHI_E, PHI_N, VEL
from navsim.geodesy.attitude_kernels import dcm, difference, half_sinc, rotate_in_nav_axes

_WINDOW = 40.0
"""Least memory of the line and of the mean force, s."""
_WINDOW_MEMORIES = 12.0
"""Length of the window in memories of the filter's velocity."""
_YOUNG = 2.0
"""Age that the line needs before it is used, s."""
_SLOWEST = 24.0
"""Longest memory of the filter's velocity, before a fix, that a new line may have, s."""
_UNCONFIRMED = 1.5
"""Steady flight ends where the memory grows to this part more: fixes do not confirm the velocity any more."""
_OFF_LINE = 4.5
"""Distance of the velocity from the line that ends steady flight, in its sigma."""
_OFF_MEAN = 4.5
"""Velocity change relative to that of the mean force, in its sigma, above which the line is used instead."""
_JUMP = 6.0
"""Velocity change relative to that of the line, in the noise of the interval, that ends steady flight."""
_ROUGH = 4.0
"""Excess of the mean square of these changes that ends steady flight, in its own sigma."""
_ROUGHNESS_TIME = 20.0
"""Memory of that mean square, s."""
_SLOWING = 1.5
"""By this an interval between fixes may be longer than the one before, if it is no hole."""
_GRAVITY = 9.8
"""Gravity, m/s2. Its error matters only while tilt changes."""


@kernel
def start_line(line, velocity, time):
    """Start the line (STEADY_N,) at a velocity (3,) at a time, s, unless it continues from an earlier flight."""
    new = line[STEADY_ROUGHNESS] == 0.0
    for i in range(3):
        line[STEADY_LINE + i] = where(new, velocity[i], line[STEADY_LINE + i])
        line[STEADY_LAST + i] = where(new, velocity[i], line[STEADY_LAST + i])
    line[STEADY_TIME] = where(new, time, line[STEADY_TIME])
    line[STEADY_ROUGHNESS] = where(new, 1.0, line[STEADY_ROUGHNESS])
    line[STEADY_USES_FORCE] = where(new, 1.0, line[STEADY_USES_FORCE])


@kernel
def is_interval_started(line):
    """Whether an interval of the line is under way: the velocity that it began with is known."""
    return any_lane(line[STEADY_BEGUN] > 0.5)


@kernel
def _span(age, memory):
    """Memory of the line and the mean force at this age, s, with that memory of the velocity."""
    longest = _WINDOW_MEMORIES * memory
    longest = where(longest < _WINDOW, _WINDOW, longest)
    return where(age > longest, longest, age)


@kernel
def begin_interval(line, v, variance, q, time):
    """Fit the line to the velocity v (3,) after a measurement, of this variance (3,), at a time, s.

    q: density of the accelerometers' noise, m2/s3.
    """
    dt = line[STEADY_STEP]
    memory = (variance[0] + variance[1] + variance[2]) / (3.0 * q)
    age = line[STEADY_AGE] + dt
    # a line by least squares, whose memory grows with its age
    many = where(dt > 0.0, _span(age, memory) / where(dt > 0.0, dt, 1.0), 1.0)
    many = where(many < 1.0, 1.0, many)
    gain = 2.0 * (2.0 * many - 1.0) / (many * (many + 1.0))
    gain = where(gain > 1.0, 1.0, gain)
    slope_gain = where(many < 1.5, 0.0, 6.0 / (many * (many + 1.0)))
    steady = line[STEADY_IS] > 0.5
    grown = age > _YOUNG + TIME_TOLERANCE
    # gusts are remembered beyond the line that they ended; next to a young line all changes look like gusts
    count = where(steady | grown | (line[STEADY_USES_FORCE] > 0.5), line[STEADY_COUNT], 0.0)
    begins = grown & no(steady) & no(_is_rough(line[STEADY_ROUGHNESS], count)) & (count * dt > _YOUNG + TIME_TOLERANCE)
    for i in range(3):
        off = v[i] - line[STEADY_LINE + i]
        line[STEADY_SLOPE + i] += where(dt > 0.0, slope_gain * off / where(dt > 0.0, dt, 1.0), 0.0)
        s = where(begins, v[i], line[STEADY_LINE + i] + gain * off)
        line[STEADY_LINE + i] = s
        line[STEADY_LAST + i] = where(steady, line[STEADY_LAST + i], s)
        line[STEADY_LEFT + i] = v[i]
        line[STEADY_OMITTED + i] = where(begins, 0.0, line[STEADY_OMITTED + i])
    line[STEADY_AGE], line[STEADY_COUNT] = age, count
    line[STEADY_IS] = where(begins, 1.0, line[STEADY_IS])
    line[STEADY_TIME] = time + 0.0 * dt
    line[STEADY_BEGUN] = 1.0 + 0.0 * dt


@kernel
def _is_rough(roughness, count):
    """Whether velocity changes are larger than the noise, although each of them alone is not detected."""
    return (roughness - 1.0) * (roughness - 1.0) * count * 3.0 > 2.0 * _ROUGH * _ROUGH * where(
        roughness > 1.0, 1.0, math.inf
    )


@kernel
def end_interval(line, v, variance, attitude, q, time, m):
    """Compare the velocity v (3,) before a measurement, with this variance (3,), with the line of steady flight.

    attitude (4,): body to NED. m (3,), out: correction of the velocity change that attitude errors rotate. In steady
    flight it removes the noise of the interval; at the end of steady flight it restores the omitted part; otherwise it
    is zero.
    """
    dt = time - line[STEADY_TIME]
    steady = line[STEADY_IS] > 0.5
    memory = (variance[0] + variance[1] + variance[2]) / (3.0 * q)
    # after a hole the line is no older by fixes that did not come
    most = _SLOWING * line[STEADY_STEP]
    step = where((most > 0.0) & (dt > most), most, dt)
    age = line[STEADY_AGE] + step
    force, noise, omitted = small_vector(line, 3), small_vector(line, 3), small_vector(line, 3)
    _compare(line, v, attitude, _span(age, memory) / step, dt, force, noise)
    uses = line[STEADY_USES_FORCE] > 0.5
    # fixes correct the effect of noise within the memory of the velocity
    forgotten = where(dt < memory, dt / memory, 1.0)
    limit = _OFF_MEAN * _OFF_MEAN * q * memory * (0.5 + memory / age)
    ends = memory > where(steady, _UNCONFIRMED * _SLOWEST, _SLOWEST)
    sudden = steady & no(steady)
    turned = sudden
    beside, by_line = 0.0 * dt, 0.0 * dt
    for i in range(3):
        off = v[i] - (line[STEADY_LINE + i] + line[STEADY_SLOPE + i] * dt)
        jump = v[i] - line[STEADY_LEFT + i] - line[STEADY_SLOPE + i] * dt
        omitted[i] = (1.0 - forgotten) * line[STEADY_OMITTED + i] - noise[i]
        sudden = sudden | (off * off > _OFF_LINE * _OFF_LINE * variance[i])
        sudden = sudden | (steady & (jump * jump > _JUMP * _JUMP * q * dt))
        turned = turned | (omitted[i] * omitted[i] > limit) | (noise[i] * noise[i] > _JUMP * _JUMP * q * dt)
        beside += noise[i] * noise[i]
        by_line += jump * jump
    keeps = uses & no(turned)
    square = where(keeps, beside, by_line)
    longest = _ROUGHNESS_TIME / step
    count = line[STEADY_COUNT] + 1.0
    count = where(count > longest, longest, count)
    count = where(count < 1.0, 1.0, count)
    roughness = line[STEADY_ROUGHNESS] + (square / (3.0 * q * dt) - line[STEADY_ROUGHNESS]) / count
    line[STEADY_ROUGHNESS] = roughness
    ends = ends | sudden | (steady & _is_rough(roughness, count))
    stays, stops = steady & no(ends), steady & ends
    for i in range(3):
        s = line[STEADY_LINE + i] + line[STEADY_SLOPE + i] * dt
        before, last = line[STEADY_LEFT + i], line[STEADY_LAST + i]
        # part that the line and the mean force have omitted so far, and the part of this interval
        of_line, of_force = last - before, line[STEADY_OMITTED + i]
        follows = (s - last) - (v[i] - before) + where(uses, of_line - of_force, 0.0)
        back = -where(uses, of_force, of_line)
        m[i] = where(stays, where(keeps, -noise[i], follows), where(stops, back, 0.0))
        line[STEADY_OMITTED + i] = where(ends, 0.0, omitted[i])
        line[STEADY_FORCE + i] = where(ends, force[i], line[STEADY_FORCE + i])
        s = where(ends, v[i], s)
        line[STEADY_LINE + i] = s
        line[STEADY_LAST + i] = s
        line[STEADY_SLOPE + i] = where(ends, (v[i] - before) / dt, line[STEADY_SLOPE + i])
    line[STEADY_USES_FORCE] = where(ends, 1.0, where(keeps, 1.0, 0.0))
    line[STEADY_AGE] = where(ends, 0.0, line[STEADY_AGE])
    line[STEADY_IS] = where(ends, 0.0, line[STEADY_IS])
    line[STEADY_COUNT] = where(sudden, 0.0, count)
    line[STEADY_STEP] = step
    line[STEADY_BEGUN] = 0.0 * dt


@kernel
def _compare(line, v, attitude, many, dt, force, noise):
    """Add the specific force of an interval of dt, s, to the mean over `many` intervals.

    force (3,), out: that of the interval, body axes. noise (3,), out: difference of its velocity change, to the
    velocity v (3,), from that of the mean force.
    """
    c_nb, level = small_matrix(noise, 3, 3), small_vector(noise, 3)
    dcm(attitude, c_nb)
    many = where(many < 1.0, 1.0, many)
    for i in range(3):
        level[i] = (v[i] - line[STEADY_LEFT + i]) / dt - (_GRAVITY if i == 2 else 0.0)
    for i in range(3):
        force[i] = c_nb[0, i] * level[0] + c_nb[1, i] * level[1] + c_nb[2, i] * level[2]
        line[STEADY_FORCE + i] += (force[i] - line[STEADY_FORCE + i]) / many
    for i in range(3):
        mean = 0.0 * dt
        for k in range(3):
            mean += c_nb[i, k] * line[STEADY_FORCE + k]
        noise[i] = (level[i] - mean) * dt


@kernel
def couple(p, block, m, tilts):
    """Add m (3,) to the velocity change that attitude errors rotate, in P (n, n): v <- v + theta x m, in place.

    block: `VEL`, or `POS` for position. tilts: 1.0, or 0.0 to couple errors of heading alone.
    """
    n = p.shape[0]
    m0, m1, m2 = m[0], m[1], m[2]
    for j in range(n):
        t0, t1, t2 = tilts * p[PHI_N, j], tilts * p[PHI_E, j], p[PHI_D, j]
        p[block, j] += t1 * m2 - t2 * m1
        p[block + 1, j] += t2 * m0 - t0 * m2
        p[block + 2, j] += t0 * m1 - t1 * m0
    for i in range(3):
        row = block + i
        t0, t1, t2 = tilts * p[row, PHI_N], tilts * p[row, PHI_E], p[row, PHI_D]
        p[row, block] += t1 * m2 - t2 * m1
        p[row, block + 1] += t2 * m0 - t0 * m2
        p[row, block + 2] += t0 * m1 - t1 * m0
    for i in range(3):
        for j in range(n):
            if j < block or j >= block + 3:
                p[j, block + i] = p[block + i, j]
        for j in range(i):
            p[block + j, block + i] = p[block + i, block + j]


@kernel
def velocity_of(nav, p, v, variance):
    """Velocity v (3,) of one Gaussian, and its variance (3,)."""
    for i in range(3):
        v[i], variance[i] = nav[NAV_VEL + i], p[VEL + i, VEL + i]


@kernel
def mean_velocity(mixture, count, v, variance):
    """Velocity v (3,) of a sum of `count` components, and its variance (3,)."""
    weight = mixture.weight
    for i in range(3):
        mean, square = 0.0 * weight[0], 0.0 * weight[0]
        for j in range(count):
            mean += where(weight[j] > 0.0, weight[j] * mixture.navigation[j, NAV_VEL + i], 0.0)
        for j in range(count):
            apart = mixture.navigation[j, NAV_VEL + i] - mean
            own = apart * apart + mixture.covariance[j, VEL + i, VEL + i]
            square += where(weight[j] > 0.0, weight[j] * own, 0.0)
        v[i], variance[i] = mean, square


@kernel
def turns_from_mean(mixture, count, turns, attitude):
    """The mean attitude (4,) of a sum of `count` components, and turns (M, 3), by which theirs are turned from it."""
    weight = mixture.weight
    mean = small_vector(attitude, 3)
    for i in range(3):
        mean[i] = 0.0
    first = mixture.navigation[0, NAV_QUAT:NAV_BIAS_FRAME]
    for j in range(count):
        difference(mixture.navigation[j, NAV_QUAT:NAV_BIAS_FRAME], first, turns[j])
        for i in range(3):
            turns[j, i] = where(weight[j] > 0.0, turns[j, i], 0.0)
            mean[i] += weight[j] * turns[j, i]
    for j in range(count):
        for i in range(3):
            turns[j, i] -= mean[i]
    copy(first, attitude)
    rotate_in_nav_axes(attitude, mean[0], mean[1], mean[2])


@kernel
def couple_sum(mixture, count, m, turns):
    """`couple` every component of a sum, and remove the effect of its own attitude on the noise from its velocity.

    A component whose attitude is rotated by phi from the mean (`turns` (M, 3)) has mechanised the noise rotated by phi.
    Its velocity and its coupling take m rotated likewise. All components then contain the noise of one attitude.
    """
    own = small_vector(m, 3)
    for j in range(count):
        there = mixture.weight[j] > 0.0
        a, b, c = turns[j, 0], turns[j, 1], turns[j, 2]
        s, w = half_sinc(a * a + b * b + c * c)
        # (R - I) m = 2 w s phi x m + 2 s^2 phi x (phi x m)
        x, y, z = b * m[2] - c * m[1], c * m[0] - a * m[2], a * m[1] - b * m[0]
        one, two = 2.0 * w * s, 2.0 * s * s
        own[0] = one * x + two * (b * z - c * y)
        own[1] = one * y + two * (c * x - a * z)
        own[2] = one * z + two * (a * y - b * x)
        for i in range(3):
            mixture.navigation[j, NAV_VEL + i] += where(there, own[i], 0.0)
            own[i] = where(there, m[i] + own[i], 0.0)
        couple(mixture.covariance[j], VEL, own, 1.0)
