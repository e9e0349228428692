"""Inputs and outputs of an estimator, as a few records that kernels take whole.

    IMU, measurements, events, state, model -> history, or error history

A `History` holds estimates. An `ErrorHistory` holds their errors; only it needs the truth (`filter.history`). `Events`
is the order of all that happens. A measurement is a row in the table of its kind (`filter.measurement_kinds`).

Arrays are those of one run, or of W runs in SIMD lanes (`compiler.lanes`). In lanes, an array that differs between runs
has a last axis of length W, and kernels take it without that axis (`lanes_of`). Times, events, model and lever arms are
the same for all runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from navsim.compiler.lanes import in_lanes
from navsim.filter import states
from navsim.filter.measurement_kinds import KIND_COUNT
from navsim.filter.receiver_clock import NO_CLOCK, ReceiverClock
from navsim.filter.states import MAX_MEASUREMENT_SIZE

TIME_TOLERANCE = 1e-9
"""Times closer than this are equal, s: far below any sample interval, far above rounding."""

PASS, OUTPUT = 0, 1
"""Kinds of events without a measurement (`measurement_kinds`): a time to propagate to, and an output of the
history."""

ESKF, FIRST_ESTIMATES, OBSERVABILITY_CONSTRAINED, LEFT_INVARIANT, TFG, GAUSSIAN_SUM = range(6)
RTS, MAP = GAUSSIAN_SUM + 1, GAUSSIAN_SUM + 2
CONSTRAINED = (FIRST_ESTIMATES, OBSERVABILITY_CONSTRAINED)
"""Filters whose corrections do not move their linearisation (`first_estimates`)."""
FILTERS, SMOOTHERS = (ESKF, *CONSTRAINED, LEFT_INVARIANT, TFG, GAUSSIAN_SUM), (RTS, MAP)
"""Kinds of estimators: causal filters, and smoothers, which also use later measurements."""

NOT_USED, USED, REJECTED = 0, 1, 2
"""Status of a measurement: nothing to use, used, rejected by the innovation gate."""


class ImuData(NamedTuple):
    """Measured increments of n IMU intervals."""

    time: np.ndarray
    """(n + 1,) s."""
    dtheta: np.ndarray
    """(n, 3) rad."""
    dv: np.ndarray
    """(n, 3) m/s."""


STEADY_LINE, STEADY_SLOPE, STEADY_LAST, STEADY_LEFT = 0, 3, 6, 9
"""Offsets in `State.steady`, NED: line through the velocities at its latest time, m/s; its slope, m/s2; the line, and
the filter's velocity, at the last measurement."""
STEADY_AGE, STEADY_IS, STEADY_ROUGHNESS, STEADY_COUNT = 12, 13, 14, 15
"""Age of the line, s; 1 in steady flight; mean square of the velocity changes about the line, relative to the noise;
and the number of changes in this mean."""
STEADY_STEP, STEADY_TIME, STEADY_BEGUN = 16, 17, 18
"""Length of the last interval between measurements, s; start of the present one, s; 1 once it has started."""
STEADY_FORCE, STEADY_OMITTED, STEADY_USES_FORCE = 19, 22, 25
"""Mean specific force since the start of the line, body axes, m/s2; the velocity change that it omitted and that fixes
have not yet corrected, NED, m/s; 1 while it is used."""
STEADY_N = 26
"""Size of `State.steady`."""
SHIFT_N = 6
"""Size of `State.shift`: position, m, and velocity, m/s."""


class Events(NamedTuple):
    """Events of a flight, in order."""

    time: np.ndarray
    """(k,) s."""
    kind: np.ndarray
    """(k,) kind of measurement, `PASS` or `OUTPUT`."""
    row: np.ndarray
    """(k,) row in the table of that kind, or of the outputs."""
    ahead: np.ndarray
    """(k,) true for events of the copy of the filter that predicts ahead of late measurements. The copy is discarded
    before the next event of the filter itself."""

    def rows(self, kind: int) -> np.ndarray:
        """Index (m,) of the filter's own event for each row of the table of `kind`."""
        own = np.flatnonzero((self.kind == kind) & ~self.ahead)
        return own[np.argsort(self.row[own], kind="stable")]


class Mixture(NamedTuple):
    """Components of a Gaussian sum (`filter.gaussian_sum`), with room for M; those in use come first."""

    navigation: np.ndarray
    """(M, NAV)."""
    covariance: np.ndarray
    """(M, n, n)."""
    increments: np.ndarray
    """(M, 6), see `StreamCursor`."""
    weight: np.ndarray
    """(M,), sum 1."""


class State(NamedTuple):
    """A filter at a time."""

    navigation: np.ndarray
    """(NAV,) navigation state."""
    covariance: np.ndarray
    """(n, n)."""
    rejected: np.ndarray
    """(slots,) consecutive rejections by the gate, for each slot (`measurement_models.slot`)."""
    steady: np.ndarray
    """(STEADY_N,) line through the velocities that detects steady flight (`steady_force`)."""
    shift: np.ndarray
    """(SHIFT_N,) corrections of position and velocity that the next transition does not start from
    (`first_estimates`)."""
    components: Mixture
    """Components whose moments `navigation` and `covariance` are; empty unless the filter is a sum."""


class StreamCursor(NamedTuple):
    """Position of a filter in the IMU data."""

    cursor: np.ndarray
    """(3,) index of the present IMU interval, -1 before the start; present time, s; length of the last interval, s."""
    increments: np.ndarray
    """(6,) compensated increments of that interval."""

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> StreamCursor:
        """The record with the array changed that differs between runs."""
        return self._replace(increments=change(self.increments))


class FilterModel(NamedTuple):
    """Settings of a filter that kernels need."""

    kind: int
    """`filter.estimate.FILTER_KINDS`."""
    noise: np.ndarray
    """(1, 2) or (n, 2) white noise densities of the sensors (`filter.covariance`), for all or each IMU interval."""
    declared: np.ndarray
    """Sensor states, see `states.DECLARED`."""
    gate: np.ndarray
    """(MOST + 1,) largest normalised innovation squared, by number of measurements."""
    max_rejected: int
    """Consecutive rejections after which the filter uses the measurement regardless."""
    components: int = 0
    """Largest number of components of a Gaussian sum."""
    split_heading_sigma: float = math.inf
    """Largest heading sigma of a component, rad."""
    clock: ReceiverClock = NO_CLOCK
    """Receiver clock of a tightly coupled filter."""
    steady_force: bool = False
    """Attitude errors rotate only the steady part of the specific force (`steady_force`)."""
    tilt_time: float = 0.0
    """Time after which fixes have shown a large tilt error, s. Until then its second order is in P
    (`filter_loop.add_second_order_of_tilt`). 0: it is negligible."""

    @property
    def states(self) -> int:
        """Number of states."""
        return states.SENSORS + self.declared.size + self.clock_states

    @property
    def clock_states(self) -> int:
        """Number of clock states."""
        return states.clock_states(self.clock.scales.size)


class History(NamedTuple):
    """Output of an estimator, at its outputs (o,) and its events (k,)."""

    navigation: np.ndarray
    """(o, NAV)."""
    covariance: np.ndarray
    """(o, n, n)."""
    innovation: np.ndarray
    """(k, MOST), nan if there is no measurement."""
    innovation_sigma: np.ndarray
    """(k, MOST), nan likewise."""
    innovation_squared: np.ndarray
    """(k,) normalised innovation squared, nan likewise."""
    degrees: np.ndarray
    """(k,) degrees of freedom of the latter."""
    status: np.ndarray
    """(k,) `NOT_USED`, `USED` or `REJECTED`."""

    def sigma(self) -> np.ndarray:
        """1 sigma of the errors (o, n); nan where a variance is negative."""
        o, n, _, *lanes = self.covariance.shape
        with np.errstate(invalid="ignore"):  # `runner.findings` detects and reports an invalid covariance
            return np.sqrt(self.covariance.reshape(o, n * n, *lanes)[:, :: n + 1])


class Truth(NamedTuple):
    """True values at the outputs (o,) of a history. In lanes every array has a last axis more."""

    llh: np.ndarray
    """(o, 3) rad, rad, m."""
    velocity: np.ndarray
    """(o, 3) NED, m/s."""
    quaternion: np.ndarray
    """(o, 4) body to NED."""
    sensors: np.ndarray
    """(o, k) the declared sensor states, then the clock's."""

    @classmethod
    def none(cls, *lanes: int) -> Truth:
        """The truth at no output, of one run or of lanes."""
        return cls(*(np.empty((0, size, *lanes)) for size in (3, 3, 4, 0)))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Truth:
        """The truth with every array changed."""
        return Truth(*map(change, self))


class OutputErrors(NamedTuple):
    """Errors of a history against the truth, at the outputs (o,)."""

    error: np.ndarray
    """(o, n) truth minus estimate, plain error states."""
    nees: np.ndarray
    """(o,) normalised squared error of all states, in the filter's own coordinates."""
    nees_position_velocity: np.ndarray
    """(o,) of position and velocity."""
    nees_group: np.ndarray
    """(o, g) of each group of three states; single states have none."""


class ErrorHistory(NamedTuple):
    """Statistics of an estimator against the truth. Outputs are evaluated as they come and are not stored."""

    truth: Truth
    """True values at the outputs (o,)."""
    errors: OutputErrors
    """Errors at the outputs."""
    sigma: np.ndarray
    """(o, n) 1 sigma of the errors, nan where a variance is negative."""
    cross: np.ndarray
    """(o, 6) elements NE, ND, ED of the covariance of position, then of attitude: they allow a later rotation of
    axes."""
    innovation: np.ndarray
    """(k, MOST) innovations that were used, also by the copy that predicts ahead; nan for others; (0, MOST) if not
    requested."""
    innovation_squared: np.ndarray
    """(k,) see `History`."""
    degrees: np.ndarray
    """(k,) see `History`."""
    status: np.ndarray
    """(k,) see `History`."""

    @property
    def by_event(self) -> tuple[np.ndarray, ...]:
        """Its arrays with a row for each event."""
        return self.innovation, self.innovation_squared, self.degrees, self.status

    def of_events(self) -> History:
        """A history that shares the arrays of its events, without outputs and sigmas of innovations."""
        n, *lanes = self.sigma.shape[1:]
        size = states.NAV_SENSORS + n - states.SENSORS
        return History(
            np.empty((0, size, *lanes)), np.empty((0, n, n, *lanes)), self.innovation,
            np.empty((0, MAX_MEASUREMENT_SIZE, *lanes)), self.innovation_squared, self.degrees, self.status,
        )  # fmt: skip

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> ErrorHistory:
        """The error history with every array changed that differs between runs."""
        return ErrorHistory(self.truth.each(change), OutputErrors(*map(change, self.errors)), *map(change, self[2:]))


def empty_error_history(
    truth: Truth, states: int, events: int, *lanes: int, single: int = 0, innovations: bool = False
) -> ErrorHistory:
    """Allocate the error history of an estimator of so many states, for one run or for lanes.

    single: number of last states that belong to no group of three. innovations: whether to keep innovations.
    """
    o, n, groups = truth.llh.shape[0], states, (states - single) // 3
    judgement = OutputErrors(
        np.empty((o, n, *lanes)), np.empty((o, *lanes)), np.empty((o, *lanes)), np.empty((o, groups, *lanes))
    )
    return ErrorHistory(
        truth, judgement, np.empty((o, n, *lanes)), np.empty((o, 6, *lanes)),
        np.empty((events if innovations else 0, MAX_MEASUREMENT_SIZE, *lanes)),
        *(np.empty((events, *lanes)) for _ in range(3)),
    )  # fmt: skip


def empty_history(outputs: int, events: int, n: int, *lanes: int) -> History:
    """Allocate the history of an estimator of n states, for one run or for lanes."""
    return History(
        np.empty((outputs, states.NAV_SENSORS + n - states.SENSORS, *lanes)), np.empty((outputs, n, n, *lanes)),
        np.full((events, MAX_MEASUREMENT_SIZE, *lanes), np.nan),
        np.full((events, MAX_MEASUREMENT_SIZE, *lanes), np.nan),
        np.full((events, *lanes), np.nan), np.zeros((events, *lanes)), np.full((events, *lanes), float(NOT_USED)),
    )  # fmt: skip


_LINE = 8
"""Numbers in a line of the processor's cache."""


def aligned_zeros(*shape: int) -> np.ndarray:
    """Zeros of this shape for lanes that a kernel often reads: each register lies in one line of the cache."""
    whole = np.zeros(math.prod(shape) + _LINE)
    first = -(whole.ctypes.data // whole.itemsize) % _LINE
    return whole[first : first + math.prod(shape)].reshape(shape)


def start(navigation: np.ndarray, covariance: np.ndarray, components: int = 0, sources: int = 0) -> State:
    """Initial state of a filter, from copies of navigation (NAV,) and covariance (n, n).

    It has room for so many components and sources of ranges. Sensor states missing in `navigation` start from zero.
    """
    n = covariance.shape[0]
    lanes = navigation.shape[1:]
    whole = np.zeros((states.NAV_SENSORS + n - states.SENSORS, *lanes))
    whole[: navigation.shape[0]] = navigation
    mixture = Mixture(*(aligned_zeros(components, *shape, *lanes) for shape in (whole.shape[:1], (n, n), (6,), ())))
    mixture.navigation[:1], mixture.covariance[:1], mixture.weight[:1] = whole, covariance, 1.0
    rejected, steady, shift = (np.zeros((size, *lanes)) for size in (KIND_COUNT + sources, STEADY_N, SHIFT_N))
    return State(whole, covariance.copy(), rejected, steady, shift, mixture)


def lanes_of(record: Any) -> Any:
    """A record of arrays as kernels take it in lanes; nested records too, other members unchanged."""
    members = (
        lanes_of(m) if isinstance(m, tuple) else in_lanes(m) if isinstance(m, np.ndarray) and m.dtype == float else m
        for m in record
    )
    return type(record)(*members)


def by_epoch(
    rows: np.ndarray, squared: np.ndarray, degrees: np.ndarray, status: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Innovations of epochs, from those of single ranges.

    Returns normalised innovations squared and degrees of freedom, summed over the ranges of each epoch (..., e); the
    status of the epoch; and the status of each source (..., e, s). An epoch is used if one of its ranges is.

    - `rows` (e, s): event of each source's range, -1 for none.
    - `squared`, `degrees`, `status` (..., k): of all events.
    """
    there = rows >= 0
    # numpy adds in the order in which numbers lie in memory, which is another for one run than for many
    squares = np.ascontiguousarray(np.where(there, squared[..., rows], np.nan))
    each = np.where(there, status[..., rows], NOT_USED)
    some = np.isfinite(squares).any(axis=-1)
    rejected = np.where((each == REJECTED).any(axis=-1), REJECTED, NOT_USED)
    return (
        np.where(some, np.nansum(squares, axis=-1), np.nan),
        np.where(there, degrees[..., rows], 0).sum(axis=-1),
        np.where((each == USED).any(axis=-1), USED, rejected),
        each,
    )


def schedule(outputs: np.ndarray, *tables: tuple[int, np.ndarray, np.ndarray]) -> Events:
    """Events of a flight, in the order in which a filter processes them.

    - `outputs` (o,): increasing times, s; each output uses all measurements that have arrived by then.
    - `tables`: kind of measurement, times of validity and times of arrival (m,), s, both increasing.

    A measurement is used at its time of validity. The filter propagates only as far as no older measurement can arrive.
    For each output, a copy of the filter predicts ahead from there with the measurements that have arrived.

    Raises ValueError for outputs that do not increase.
    """
    if np.any(np.diff(outputs) <= 0.0):
        raise ValueError("two outputs have the same time")
    kind = np.concatenate([np.full(valid.size, which) for which, valid, _ in tables]).astype(np.int64)
    row = np.concatenate([np.arange(valid.size) for _, valid, _ in tables]).astype(np.int64)
    valid = np.concatenate([valid for _, valid, _ in tables])
    arrival = np.concatenate([arrival for _, _, arrival in tables])
    order = np.argsort(valid, kind="stable")
    kind, row, valid, arrival = kind[order], row[order], valid[order], arrival[order]
    held = float(np.max(arrival - valid, initial=0.0))
    held = 0.0 if held < TIME_TOLERANCE else held
    # where the filter is for each answer; measurements of that very time come first
    safe = outputs - held
    if valid.size:
        nearest = np.clip(np.searchsorted(valid, safe + TIME_TOLERANCE, side="right") - 1, 0, None)
        safe = np.where(np.abs(valid[nearest] - safe) <= TIME_TOLERANCE, valid[nearest], safe)
    reached = np.concatenate([valid, safe])
    of_output = np.concatenate([np.full(valid.size, -1), np.arange(outputs.size)])
    order = np.lexsort((of_output, of_output >= 0, reached))
    if held == 0.0:
        is_output = of_output[order] >= 0
        at = np.where(is_output, 0, order)
        return Events(
            np.concatenate([valid, outputs])[order],
            np.where(is_output, OUTPUT, kind[at] if kind.size else OUTPUT),
            np.where(is_output, of_output[order], row[at] if row.size else 0),
            np.zeros(order.size, np.bool_),
        )
    listed: list[tuple[float, int, int, bool]] = []
    for i in order:
        if of_output[i] < 0:
            listed.append((valid[i], kind[i], row[i], False))
            continue
        o, time = int(of_output[i]), float(outputs[of_output[i]])
        listed.append((reached[i], PASS, 0, False))
        first = int(np.searchsorted(valid, reached[i] + TIME_TOLERANCE, side="right"))
        for j in range(first, int(np.searchsorted(valid, time + TIME_TOLERANCE, side="right"))):
            if arrival[j] <= time + TIME_TOLERANCE:
                listed.append((valid[j], kind[j], row[j], True))
        listed.append((time, OUTPUT, o, True))
    time_, kind_, row_, ahead = zip(*listed, strict=True) if listed else ((), (), (), ())
    return Events(
        np.array(time_, dtype=float), np.array(kind_, dtype=np.int64), np.array(row_, dtype=np.int64),
        np.array(ahead, dtype=np.bool_),
    )  # fmt: skip
