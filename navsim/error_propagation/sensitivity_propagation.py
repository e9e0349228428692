"""Propagate errors through a linearised filter: kernels of the covariance analysis (`simulation.landing_covariance`).

A SIMD lane is a source of error or a direction of errors here, not a run. An error that is constant over a run, or
drawn once, is a column x. The filter maps it to Phi x over an interval, and to x - K (H x + d) at a measurement with
the error d. White noise is propagated as covariances P.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, as_simd, fma, numbers, small_matrix, small_vector, where
from navsim.compiler.linear import copy_matrix
from navsim.filter.receiver_clock import propagate_clock_covariance
from navsim.filter.states import MAX_MEASUREMENT_SIZE, SENSORS


class LinearisedHistory(NamedTuple):
    """History of a linearised filter for S propagated states, of which the filter's n come first."""

    ahead: np.ndarray
    """(k,) see `records.Events`."""
    output: np.ndarray
    """(k,) row of the output, -1 for other events."""
    interval: np.ndarray
    """(k,) row of the interval that the event ends, -1 for none."""
    weighed: np.ndarray
    """(k,) row of the measurement, -1 for other events."""
    phi: np.ndarray
    """(i, 9, S) navigation rows of Phi of each interval."""
    rest: np.ndarray
    """(i, S - 9) decay of the sensor states, which depend on nothing else."""
    length: np.ndarray
    """(i,) s."""
    h: np.ndarray
    """(w, MOST, S) of each measurement."""
    gain: np.ndarray
    """(w, n, MOST)."""
    to_error: np.ndarray
    """(n, S) from the propagated states to the errors of the filter's states."""
    clock: tuple[int, int]
    """First bias of the receiver's clock among the states, and number of biases."""
    offsets: np.ndarray
    """(q,) offset of each transmitter's clock among the states; the next state is its rate."""

    def of(self, chosen: np.ndarray) -> LinearisedHistory:
        """The history for some of the states, including the filter's; the others are always zero."""
        sensors = chosen[SENSORS:] - SENSORS
        return self._replace(
            phi=np.take(self.phi, chosen, axis=-1),
            rest=np.take(self.rest, sensors, axis=-1),
            h=np.take(self.h, chosen, axis=-1),
            to_error=np.take(self.to_error, chosen, axis=-1),
        )


@kernel
def _propagate_column(phi, rest, x):
    """x (S,) <- Phi x; see `LinearisedHistory`."""
    out = small_vector(x, SENSORS)
    for i in range(SENSORS):
        t = phi[i, 0] * x[0]
        for j in range(1, x.shape[0]):
            t = fma(phi[i, j], x[j], t)
        out[i] = t
    for i in range(SENSORS):
        x[i] = out[i]
    for c in range(rest.shape[0]):
        x[SENSORS + c] *= rest[c]


@kernel
def _propagate_over(route, at, x):
    """x (S,) over interval `at` of a route, with the clock."""
    _propagate_column(route.phi[at], route.rest[at], x)
    first, scales = route.clock
    for b in range(scales):
        x[first + b] += route.length[at] * x[first + scales]
    for c in range(route.offsets.shape[0]):
        x[route.offsets[c]] += route.length[at] * x[route.offsets[c] + 1]


@kernel
def _observe_column(h, x, d, seen):
    """seen (m,) <- H x + d."""
    for a in range(h.shape[0]):
        t = d[a]
        for j in range(x.shape[0]):
            if h[a, j] != 0.0:
                t = fma(h[a, j], x[j], t)
        seen[a] = t


@kernel
def propagate_columns(route, x, d, seen, error):
    """Propagate columns in lanes, in g groups.

    - `x` (2, g, S): initial columns, and room for the copy that predicts ahead; overwritten.
    - `d` (w, g, MOST): measurement errors.
    - `seen` (w, g, MOST), out: innovations H x + d; `error` (o, g, n), out: errors at the outputs.
    """
    x, d, seen, error = as_simd(x), as_simd(d), as_simd(seen), as_simd(error)
    size, n = x.shape[2], route.gain.shape[1]
    before = 0
    for i in range(route.ahead.shape[0]):
        ahead = 1 if route.ahead[i] else 0
        at, w, row = route.interval[i], route.weighed[i], route.output[i]
        for g in range(x.shape[1]):
            if ahead > before:
                for j in range(size):
                    x[1, g, j] = x[0, g, j]
            one = x[ahead, g]
            if at >= 0:
                _propagate_over(route, at, one)
            if row >= 0:
                for j in range(n):
                    t = one[j]
                    for c in range(n, size):
                        if route.to_error[j, c] != 0.0:
                            t += one[c]
                    error[row, g, j] = t
            if w >= 0:
                there = seen[w, g]
                _observe_column(route.h[w], one, d[w, g], there)
                for j in range(n):
                    t = one[j]
                    for a in range(there.shape[0]):
                        t = fma(-route.gain[w, j, a], there[a], t)
                    one[j] = t
        before = ahead


@kernel
def _propagate(phi, rest, p, work):
    """P <- Phi P Phi' (S, S); work: (9, S)."""
    size = p.shape[0]
    for i in range(SENSORS):
        for j in range(size):
            t = phi[i, 0] * p[0, j]
            for k in range(1, size):
                t = fma(phi[i, k], p[k, j], t)
            work[i, j] = t
    for i in range(SENSORS):
        for j in range(i + 1):
            t = phi[j, 0] * work[i, 0]
            for k in range(1, size):
                t = fma(phi[j, k], work[i, k], t)
            p[i, j] = t
            p[j, i] = t
        for c in range(rest.shape[0]):
            t = work[i, SENSORS + c] * rest[c]
            p[i, SENSORS + c] = t
            p[SENSORS + c, i] = t
    for c in range(rest.shape[0]):
        for k in range(rest.shape[0]):
            p[SENSORS + c, SENSORS + k] *= rest[c] * rest[k]


@kernel
def _add(added, place, density, p):
    """P += density times `added` (15, 15), whose states have these places (15,) in P; the first nine are the first."""
    for i in range(place.shape[0]):
        for j in range(place.shape[0]):
            if added[i, j] != 0.0:
                p[place[i], place[j]] = fma(density, added[i, j], p[place[i], place[j]])


@kernel
def _update(h, gain, r, p, hp, work):
    """P <- (I - K H) P (I - K H)' + K R K', symmetric; also the second moments of the innovations, H P H' + R.

    h: (m, S). gain: (n, m). r: (m, m), overwritten by these moments. p: (S, S). hp (m, S), work (S, m): space.
    """
    size, n, m = p.shape[0], gain.shape[0], h.shape[0]
    for a in range(m):
        for j in range(size):
            hp[a, j] = 0.0
        for k in range(size):
            if h[a, k] != 0.0:
                for j in range(size):
                    hp[a, j] = fma(h[a, k], p[k, j], hp[a, j])
    # first V = P - K (H P), then V + (K R - V H') K': twice a difference of like numbers, as the product has it
    for i in range(size):
        for a in range(m):
            work[i, a] = 0.0
    for i in range(n):
        for j in range(size):
            t = p[i, j]
            for a in range(m):
                t = fma(-gain[i, a], hp[a, j], t)
            p[i, j] = t
        for a in range(m):
            t = gain[i, 0] * r[0, a]
            for b in range(1, m):
                t = fma(gain[i, b], r[b, a], t)
            work[i, a] = t
    for i in range(size):
        for a in range(m):
            t = work[i, a]
            for k in range(size):
                if h[a, k] != 0.0:
                    t = fma(-h[a, k], p[i, k], t)
            work[i, a] = t
    for i in range(size):
        for j in range(min(i + 1, n)):
            t = p[i, j]
            for a in range(m):
                t = fma(work[i, a], gain[j, a], t)
            p[i, j] = t
            p[j, i] = t
    for a in range(m):
        for b in range(m):
            t = r[a, b]
            for k in range(size):
                if h[b, k] != 0.0:
                    t = fma(h[b, k], hp[a, k], t)
            r[a, b] = t


@kernel
def _errors(to_error, p, work, variance, sums):
    """variance (n,) <- those of the errors in each lane; sums (n, n) += the covariances of all lanes. work: (n, S)."""
    n, size = to_error.shape
    alone = numbers(work)
    lanes = alone.shape[1] // size
    for i in range(n):
        for j in range(size):
            t = p[i, j]
            for c in range(n, size):
                if to_error[i, c] != 0.0:
                    t += p[c, j]
            work[i, j] = t
    for i in range(n):
        for j in range(i + 1):
            t = work[i, j]
            for c in range(n, size):
                if to_error[j, c] != 0.0:
                    t += work[i, c]
            work[i, j] = t
            total = sums[i, j]
            for k in range(lanes):
                total += alone[i, lanes * j + k]
            sums[i, j] = total
            sums[j, i] = total
        variance[i] = work[i, i]


@kernel
def propagate_covariances(route, added, place, density, p, r, variance, second, sums):
    """Propagate the covariances of sources of error in lanes.

    - `added` (i, noises, 15, 15): noise of the intervals for a unit density; `place` (15,): its states among those
      propagated.
    - `density` (noises + 2,): 0 for another source; the last two are those of the clock's phase and frequency.
    - `p` (2, S, S): initial covariance, and room for the copy that predicts ahead; overwritten.
    - `r` (w, MOST, MOST): measurement noise.
    - `variance` (o, n), out: of the errors at the outputs.
    - `second` (w, MOST, MOST) and `sums` (o, n, n): the sums over the lanes of innovation moments, and of covariances
      at the outputs, are added.
    """
    p, r, density, variance = as_simd(p), as_simd(r), as_simd(density), as_simd(variance)
    size, n, noises = p.shape[1], route.gain.shape[1], added.shape[1]
    first, scales = route.clock
    work, hp, by = alloc(p, (n, size)), alloc(p, (MAX_MEASUREMENT_SIZE, size)), alloc(p, (size, MAX_MEASUREMENT_SIZE))
    moments = small_matrix(p, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)
    alone = numbers(moments)
    lanes = alone.shape[1] // MAX_MEASUREMENT_SIZE
    there = np.zeros(noises, np.bool_)
    numbers_of = numbers(density)
    for k in range(noises):
        for c in range(lanes):
            if numbers_of[k * lanes + c] != 0.0:
                there[k] = True
    before = 0
    for i in range(route.ahead.shape[0]):
        ahead = 1 if route.ahead[i] else 0
        if ahead > before:
            for j in range(size):
                for k in range(size):
                    p[1, j, k] = p[0, j, k]
        before = ahead
        one, at, w, row = p[ahead], route.interval[i], route.weighed[i], route.output[i]
        if at >= 0:
            _propagate(route.phi[at], route.rest[at], one, work)
            if scales > 0:
                propagate_clock_covariance(first, scales, density[noises], density[noises + 1], route.length[at], one)
            for c in range(route.offsets.shape[0]):  # their noise is in the truth
                propagate_clock_covariance(route.offsets[c], 1, 0.0, 0.0, route.length[at], one)
            for k in range(noises):
                if there[k]:
                    _add(added[at, k], place, density[k], one)
        if row >= 0:
            _errors(route.to_error, one, work, variance[row], sums[row])
        if w >= 0:
            for a in range(MAX_MEASUREMENT_SIZE):
                for b in range(MAX_MEASUREMENT_SIZE):
                    moments[a, b] = r[w, a, b]
            _update(route.h[w], route.gain[w], moments, one, hp, by)
            for a in range(MAX_MEASUREMENT_SIZE):
                for b in range(MAX_MEASUREMENT_SIZE):
                    total = second[w, a, b]
                    for c in range(lanes):
                        total += alone[a, lanes * b + c]
                    second[w, a, b] = total


@kernel
def propagate_differences(route, gains, innovation, fix, separation, scale, x, farthest):
    """Propagate the differences between f filters with fewer measurements and the main filter, in lanes of its runs.

    With d the others' estimates minus the filter's, and z the innovation of each event at the filter's estimate, d <- d
    + L (z + apart - H d) - K z.

    - `route`: of the main filter; `gains` (w, f, n, MOST): of the others.
    - `innovation` (k, MOST): at events that the main filter used, nan for others.
    - `fix` (k,): row of a fix in `separation`, -1 for measurements that all filters share.
    - `separation` (f, e, MOST): fixes of the others minus its own, nan if they have none.
    - `scale` (o, f, 3): factor on position differences.
    - `x` (2, f, n): zero, and room for the copy that predicts ahead; overwritten.
    - `farthest` (o,), out: largest scaled difference.
    """
    innovation, separation, x, farthest = as_simd(innovation), as_simd(separation), as_simd(x), as_simd(farthest)
    others, n = x.shape[1], x.shape[2]
    z, seen, off = (
        small_vector(x, MAX_MEASUREMENT_SIZE),
        small_vector(x, MAX_MEASUREMENT_SIZE),
        small_vector(x, MAX_MEASUREMENT_SIZE),
    )
    before = 0
    for i in range(route.ahead.shape[0]):
        ahead = 1 if route.ahead[i] else 0
        at, w, row = route.interval[i], route.weighed[i], route.output[i]
        largest = 0.0 * farthest[0]
        if w >= 0:
            for a in range(MAX_MEASUREMENT_SIZE):
                used = innovation[i, a] == innovation[i, a]
                z[a] = where(used, innovation[i, a], 0.0)
        for f in range(others):
            if ahead > before:
                for j in range(n):
                    x[1, f, j] = x[0, f, j]
            one = x[ahead, f]
            if at >= 0:
                _propagate_over(route, at, one)
            if row >= 0:
                for q in range(3):
                    size = scale[row, f, q] * one[q]
                    size = where(size < 0.0, -size, size)
                    # nan stays nan
                    largest = where((size <= largest) | (largest != largest), largest, size)
            if w >= 0:
                for a in range(MAX_MEASUREMENT_SIZE):
                    off[a] = z[a]
                    if fix[i] >= 0:
                        off[a] += separation[f, fix[i], a]
                _observe_difference(route.h[w], one, off, innovation[i], seen)
                for j in range(n):
                    t = one[j]
                    for a in range(MAX_MEASUREMENT_SIZE):
                        t = fma(gains[w, f, j, a], seen[a], fma(-route.gain[w, j, a], z[a], t))
                    one[j] = t
        if row >= 0:
            farthest[row] = largest
        before = ahead


@kernel
def _observe_difference(h, x, off, innovation, seen):
    """seen (m,) <- off - H x, 0 where `off` or the innovation is not there."""
    for a in range(h.shape[0]):
        t = off[a]
        for j in range(x.shape[0]):
            if h[a, j] != 0.0:
                t = fma(-h[a, j], x[j], t)
        there = (innovation[a] == innovation[a]) & (off[a] == off[a])
        seen[a] = where(there, t, 0.0)


@kernel
def _line(matrix, side, j, line):
    """line (S,) <- column (side 0) or row (1) j of a matrix (S, S)."""
    for k in range(line.shape[0]):
        line[k] = matrix[k, j] if side == 0 else matrix[j, k]


@kernel
def _put_line(line, side, j, matrix):
    """The reverse of `_line`."""
    for k in range(line.shape[0]):
        if side == 0:
            matrix[k, j] = line[k]
        else:
            matrix[j, k] = line[k]


@kernel
def propagate_excess(route, gains, cross, x, excess):
    """Propagate the excess of the error covariance of two filters over the covariance of the first filter.

    For optimal filters with the same measurements it is zero: the other's error contains the better one's error
    (docs/theory/integrity.md, section 10).

    - `route`: of the first filter; `gains` (w, n, MOST): of the other.
    - `cross` (w, MOST, MOST): covariance of the first filter's measurements with the other's, minus that of the first.
    - `x` (2, n, n): zero, and room for the copy that predicts ahead; overwritten.
    - `excess` (o, 3, 3), out: of positions.
    """
    size = x.shape[1]
    seen, nothing, column = np.empty(MAX_MEASUREMENT_SIZE), np.zeros(MAX_MEASUREMENT_SIZE), np.empty(size)
    before = 0
    for i in range(route.ahead.shape[0]):
        ahead = 1 if route.ahead[i] else 0
        if ahead > before:
            copy_matrix(x[0], x[1])
        before = ahead
        one, at, w, row = x[ahead], route.interval[i], route.weighed[i], route.output[i]
        # from the left by the update of the first filter, then from the right by that of the other
        for side in range(2) if at >= 0 else range(0):
            for j in range(size):
                _line(one, side, j, column)
                _propagate_over(route, at, column)
                _put_line(column, side, j, one)
        if row >= 0:
            for j in range(3):
                for k in range(3):
                    excess[row, j, k] = one[j, k]
        if w >= 0:
            for side in range(2):
                gain = route.gain[w] if side == 0 else gains[w]
                for j in range(size):
                    _line(one, side, j, column)
                    _observe_column(route.h[w], column, nothing, seen)
                    for k in range(size):
                        for a in range(MAX_MEASUREMENT_SIZE):
                            column[k] -= gain[k, a] * seen[a]
                    _put_line(column, side, j, one)
            for a in range(MAX_MEASUREMENT_SIZE):
                for b in range(MAX_MEASUREMENT_SIZE):
                    if cross[w, a, b] != 0.0:
                        for j in range(size):
                            for k in range(size):
                                one[j, k] += route.gain[w, j, a] * cross[w, a, b] * gains[w, k, b]
