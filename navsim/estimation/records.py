"""What goes into an estimator and what comes out of it, as few records that kernels take whole.

    IMU, measurements, events, state, model -> history, or account

The truth is in what comes out alone: an account is what a history would be worth (`estimation.answers`). An `Events`
list says in what order things happen; a measurement is a row of the table of its kind (`estimation.observations`).

Numbers are those of one run, or of W runs in the lanes of a register (`compiler.lanes`): then what differs between runs
has a last axis more, of length W, and kernels take it without that axis (`lanes_of`). Times, events, the model and
lever arms are the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from navsim.compiler.lanes import in_lanes
from navsim.core import states
from navsim.core.states import MOST
from navsim.estimation.clock import NO_CLOCK, ReceiverClock
from navsim.estimation.observations import KIND_COUNT

TIME_TOLERANCE = 1e-9
"""Times closer than this are one, s: well under any sample interval, well over rounding."""

PASS, OUTPUT = 0, 1
"""Kinds of events that are no measurements (`observations`): nothing but a time to get to; an output of the history."""

ESKF, FIRST_ESTIMATES, OBSERVABILITY_CONSTRAINED, LEFT_INVARIANT, TFG, GAUSSIAN_SUM = range(6)
RTS, MAP = GAUSSIAN_SUM + 1, GAUSSIAN_SUM + 2
CONSTRAINED = (FIRST_ESTIMATES, OBSERVABILITY_CONSTRAINED)
"""Filters whose corrections do not move their linearisation (`first_estimates`)."""
FILTERS, SMOOTHERS = (ESKF, *CONSTRAINED, LEFT_INVARIANT, TFG, GAUSSIAN_SUM), (RTS, MAP)
"""Kinds of estimators: those that go forward, and those that know what comes later."""

NOT_USED, USED, REJECTED = 0, 1, 2
"""What became of a measurement: nothing to use, used, rejected by the innovation gate."""


class ImuData(NamedTuple):
    """Increments of n intervals: time (n + 1,) s; dtheta, dv (n, 3) rad, m/s, as measured."""

    time: np.ndarray
    dtheta: np.ndarray
    dv: np.ndarray


STEADY_LINE, STEADY_SLOPE, STEADY_LAST, STEADY_LEFT = 0, 3, 6, 9
"""Of `State.steady`: the line through the velocities at its latest time, m/s; its slope, m/s2; the line, and the
filter's velocity, at the last measurement. NED."""
STEADY_AGE, STEADY_IS, STEADY_ROUGHNESS, STEADY_COUNT = 12, 13, 14, 15
STEADY_STEP, STEADY_TIME, STEADY_BEGUN = 16, 17, 18
"""Age of the line, s; 1 while the flight is steady; mean square of the changes of velocity beside the line, in that of
the noise, and the number that it is of; length of the last interval between measurements, s; when the next began, s;
1 where it has."""
STEADY_FORCE, STEADY_OMITTED, STEADY_USES_FORCE = 19, 22, 25
"""Mean specific force since the line began, m/s2, in body axes; what it left out of the change of velocity, as far as
fixes have not corrected it yet, m/s, NED; 1 while it is used."""
STEADY_N = 26
"""Size of `State.steady`."""
SHIFT_N = 6
"""Size of `State.shift`: position, m, and velocity, m/s."""


class Events(NamedTuple):
    """What happens, in order (k,): time s; kind; row in the table of that kind, or of the outputs; ahead: on a copy of
    the filter that runs ahead of what may still arrive, thrown away before the next event that is not."""

    time: np.ndarray
    kind: np.ndarray
    row: np.ndarray
    ahead: np.ndarray

    def rows(self, kind: int) -> np.ndarray:
        """The event (m,) of each row of the table of `kind`, that of the filter itself."""
        own = np.flatnonzero((self.kind == kind) & ~self.ahead)
        return own[np.argsort(self.row[own], kind="stable")]


class Mixture(NamedTuple):
    """The components of a Gaussian sum (`estimation.gaussian_sum`), with room for M: navigation (M, NAV), covariance
    (M, n, n), increments (M, 6) as of `Way`, weight (M,): those of a sum add up to 1, and what is there comes first."""

    navigation: np.ndarray
    covariance: np.ndarray
    increments: np.ndarray
    weight: np.ndarray


class State(NamedTuple):
    """A filter at a moment: navigation (NAV,), covariance (n, n), rejected (slots,) measurements that the gate rejected
    in a row, of each slot (`observations.slot`); steady (STEADY_N,) the line that tells steady flight
    (`steady_force`); shift (SHIFT_N,) corrections of position and velocity that the next transition does not start from
    (`first_estimates`); components whose moments these are, without room where a filter is no sum."""

    navigation: np.ndarray
    covariance: np.ndarray
    rejected: np.ndarray
    steady: np.ndarray
    shift: np.ndarray
    components: Mixture


class Way(NamedTuple):
    """Where a filter is on its way: cursor (3,) index of the interval of the IMU that it is in, -1 before it set off,
    present time s, length of the interval last used s; increments (6,), the compensated ones of that interval."""

    cursor: np.ndarray
    increments: np.ndarray

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Way:
        """The way with the array changed that differs between runs."""
        return self._replace(increments=change(self.increments))


class FilterModel(NamedTuple):
    """What a filter does and believes: kind (`estimation.estimate.FILTER_KINDS`); noise (1, 2) or (n, 2) white
    densities of the sensors (`core.covariance`), for all intervals of the IMU or each; declared sensor states; gate
    (MOST + 1,) largest normalised innovation squared by the number of measurements; rejections in a row after which one
    is taken nevertheless; of a Gaussian sum the number of its components at most, and 1 sigma of heading (rad) of the
    widest; clock of the receiver, where it is tightly coupled; steady_force: whether attitude errors turn only the
    steady part of the specific force (`steady_force`).
    """

    kind: int
    noise: np.ndarray
    declared: np.ndarray
    gate: np.ndarray
    max_rejected: int
    components: int = 0
    widest: float = math.inf
    clock: ReceiverClock = NO_CLOCK
    steady_force: bool = False

    @property
    def states(self) -> int:
        """How many states it has."""
        return states.SENSORS + self.declared.size + self.clock_states

    @property
    def clock_states(self) -> int:
        """How many of them are the clock's."""
        return states.clock_states(self.clock.scales.size)


class History(NamedTuple):
    """What an estimator leaves. At its outputs (o,): navigation (o, NAV), covariance (o, n, n). Of its events (k,),
    where they are measurements: innovation and its 1 sigma (k, MOST), nan where there is none; innovation_squared (k,)
    normalised, nan where there is none; degrees (k,) of it; status (k,)."""

    navigation: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray
    innovation_sigma: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray

    def sigma(self) -> np.ndarray:
        """1 sigma of the errors (o, n); nan where a variance is negative."""
        o, n, _, *lanes = self.covariance.shape
        with np.errstate(invalid="ignore"):  # what is no covariance is found and said (`runner.findings`)
            return np.sqrt(self.covariance.reshape(o, n * n, *lanes)[:, :: n + 1])


class Truth(NamedTuple):
    """What a history is judged by, at its outputs (o,): llh, velocity NED (o, 3), quaternion (o, 4) b -> n, sensors (o,
    k) the true values of the declared sensor states, and of the clock's; of lanes all with a last axis more."""

    llh: np.ndarray
    velocity: np.ndarray
    quaternion: np.ndarray
    sensors: np.ndarray

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Truth:
        """The truth with every array changed."""
        return Truth(*map(change, self))


class Judgement(NamedTuple):
    """A history against a truth: plain errors (o, n), truth minus estimate; normalised squared errors: nees (o,) of all
    states in the filter's own coordinates, nees_position_velocity (o,), nees_group (o, g) of each three states, but
    those that stand alone."""

    error: np.ndarray
    nees: np.ndarray
    nees_position_velocity: np.ndarray
    nees_group: np.ndarray


class Account(NamedTuple):
    """What an estimator leaves where the truth is known: outputs are judged as they come, and not kept.

    At its outputs: truth; judgement; sigma (o, n) of the errors, nan where a variance is negative; cross (o, 6), what
    else a turn of axes needs of the covariance, its elements NE, ND, ED of position, then of attitude. Of its events:
    innovation_squared, degrees, status as of a `History`; innovation (k, MOST) those that were used, also by the copy
    that runs ahead, nan for others, of no size where they are not wanted.
    """

    truth: Truth
    judgement: Judgement
    sigma: np.ndarray
    cross: np.ndarray
    innovation: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Account:
        """The account with every array changed that differs between runs."""
        return Account(self.truth.each(change), Judgement(*map(change, self.judgement)), *map(change, self[2:]))


def empty_account(
    truth: Truth, states: int, events: int, *lanes: int, single: int = 0, innovations: bool = False
) -> Account:
    """Room for what an estimator of so many states leaves beside a truth, of one run or of so many lanes; single: how
    many of the states, the last, belong to no group of three; innovations: whether they are wanted."""
    o, n, groups = truth.llh.shape[0], states, (states - single) // 3
    judgement = Judgement(
        np.empty((o, n, *lanes)), np.empty((o, *lanes)), np.empty((o, *lanes)), np.empty((o, groups, *lanes))
    )
    return Account(
        truth, judgement, np.empty((o, n, *lanes)), np.empty((o, 6, *lanes)),
        np.empty((events if innovations else 0, MOST, *lanes)), *(np.empty((events, *lanes)) for _ in range(3)),
    )  # fmt: skip


def empty_history(outputs: int, events: int, n: int, *lanes: int) -> History:
    """Room for what an estimator of n states leaves, of one run or of so many lanes."""
    return History(
        np.empty((outputs, states.NAV_SENSORS + n - states.SENSORS, *lanes)), np.empty((outputs, n, n, *lanes)),
        np.full((events, MOST, *lanes), np.nan), np.full((events, MOST, *lanes), np.nan),
        np.full((events, *lanes), np.nan), np.zeros((events, *lanes)), np.full((events, *lanes), float(NOT_USED)),
    )  # fmt: skip


def start(navigation: np.ndarray, covariance: np.ndarray, components: int = 0, sources: int = 0) -> State:
    """The state of a filter before anything happened, from copies of navigation (NAV,) and covariance (n, n), with room
    for so many components and sources of ranges; sensor states that the navigation state is too short for start from
    zero."""
    n = covariance.shape[0]
    lanes = navigation.shape[1:]
    whole = np.zeros((states.NAV_SENSORS + n - states.SENSORS, *lanes))
    whole[: navigation.shape[0]] = navigation
    mixture = Mixture(*(np.zeros((components, *shape, *lanes)) for shape in (whole.shape[:1], (n, n), (6,), ())))
    mixture.navigation[:1], mixture.covariance[:1], mixture.weight[:1] = whole, covariance, 1.0
    rejected, steady, shift = (np.zeros((size, *lanes)) for size in (KIND_COUNT + sources, STEADY_N, SHIFT_N))
    return State(whole, covariance.copy(), rejected, steady, shift, mixture)


def lanes_of(record: Any) -> Any:
    """A record of arrays with lanes as kernels take it; records in it too, other members as they are."""
    members = (
        lanes_of(m) if isinstance(m, tuple) else in_lanes(m) if isinstance(m, np.ndarray) and m.dtype == float else m
        for m in record
    )
    return type(record)(*members)


def by_epoch(
    rows: np.ndarray, squared: np.ndarray, degrees: np.ndarray, status: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sums of the innovations squared and of their degrees, and the status, of epochs (..., e), from those of all
    events (..., k), and the status of each source (..., e, s). rows: (e, s) the event of each source's range, -1 for
    none. One of several ranges used is use of the epoch."""
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
    """The events of a flight, in the order in which a filter may act on them.

    outputs: (o,) times, s, increasing, at which to answer with all that has arrived by then. tables: of each kind of
    measurement its kind, when they were valid and when they arrived (m,), s, in order.

    A measurement is used for the time it was valid. The filter itself goes no further than nothing older can still
    arrive; for each answer a copy runs ahead from there, with what has arrived in the meantime. Raises ValueError for
    outputs that do not increase.
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
