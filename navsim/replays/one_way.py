"""Clocks of one-way ranges beside an inertial sensor, as states.

A pseudorange contains the receiver's clock and that of its transmitter, each with offset and rate:

    r_i = |p - p_i| + c (dt_receiver - dt_i) + e

Ranges show only differences of clocks, so one clock is the reference. The others are counted against it, and share its
noise and its uncertainty at the start. Without the reference, an offset of all transmitters could not be told from one
of the receiver.

Source: `docs/theory/beacons.md`, section 3; the same model as of ranges alone (`ranging.model`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign, SensorDesign
from navsim.filter.measurement_kinds import BEACON, BEACON_STATES, BeaconTable
from navsim.filter.records import NOT_USED, REJECTED
from navsim.filter.states import Block, ReferenceClock
from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh, ned_matrix
from navsim.gnss.clock_noise import step_covariance
from navsim.ranging.evaluation import unobserved_states
from navsim.ranging.model import UNKNOWN_CLOCK
from navsim.ranging.scenario import RECEIVER
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, several
from navsim.sensors.beacons import RECEIVER_CLOCK, clock_blocks
from navsim.statistics.consistency import correlated_states
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.replays.flight import Replayed
    from navsim.replays.recorded_flight import PartStart, RecordedFlight
    from navsim.replays.scenario import OneWayClocks

_OF_SOURCE = "transmitter_clock{}_"
"""Name of the states of a source's clock, before the source's name."""
FAR, FAST = 5.0, 3.0
"""Offset and rate of a clock, in the 1 sigma that the log expects, beyond which a finding is reported."""
MOSTLY = 0.5
"""Share of a source's ranges."""
_FIRST, _FIRST_S = 5, 5.0
"""Number of first ranges, and their time, s, that show offset and rate of a clock; the longer one."""
_PAIRED = 40
"""Most ranges of a source whose pairs show a rate."""
_SHORTEST = 1.0
"""Shortest time that shows a rate, s."""
_GAP = 10.0
"""Longest interval of fixes between which a position is interpolated, s."""
_COMPARED_S = 60.0
"""Time in which rates of two clocks are compared, s."""
UNKNOWN_RATE = 20e-6 * SPEED_OF_LIGHT
"""1 sigma of the receiver's rate where ranges do not show it, m/s: 20 ppm, an uncompensated quartz."""


def _state_name(clock: str) -> str:
    """Name of the states of a clock: with "" in it that of the offset, with "_rate" that of the rate."""
    return RECEIVER_CLOCK if clock == RECEIVER else _OF_SOURCE + clock


def range_clock_blocks(names: tuple[str, ...], clocks: OneWayClocks) -> list[tuple[Block, float]]:
    """States of all clocks of these sources but the reference, with their 1 sigma, m, m/s."""
    sigma = dict.fromkeys(names, (clocks.offset_sigma_m, clocks.rate_sigma_m_s)) | {RECEIVER: UNKNOWN_CLOCK}
    density = dict.fromkeys(names, clocks.sources.densities()) | {RECEIVER: clocks.receiver.densities()}
    offset, rate = sigma[clocks.datum]
    reference = ReferenceClock(*density[clocks.datum], offset**2, rate**2)
    receiver = BEACON_STATES * len(names)
    first = {RECEIVER: receiver} | {name: receiver + 3 + 2 * i for i, name in enumerate(names)}
    out: list[tuple[Block, float]] = []
    for name in (RECEIVER, *names):
        if name != clocks.datum:
            out += clock_blocks(_state_name(name), first[name], density[name], sigma[name], reference)
    return out


def start_clocks(
    nav: np.ndarray, matrix: np.ndarray, flight: RecordedFlight, begin: PartStart, design: FilterDesign
) -> np.ndarray:
    """Navigation state (NAV,) with first offsets and rates of the clocks of one-way ranges.

    P (n, n) of the clocks is propagated in place from the start of the flight to that of a part.
    """
    sensors = design.sensors
    if not sensors.clocks:
        return nav
    offsets = np.array([first for first, _ in sensors.clocks])
    line = _receiver_clock(flight, begin, design)
    own, sign = (offsets[:1], 1.0) if line.of_receiver else (offsets, -1.0)
    _add(matrix, own, -np.diag(np.square(UNKNOWN_CLOCK)))  # known anew by the ranges of this part
    _let_go_on(matrix, offsets, sensors, begin.alignment.time - flight.start.alignment.time)
    _add(matrix, own, line.covariance)
    out = np.zeros(states.NAV_SENSORS + matrix.shape[0] - states.SENSORS)
    out[: nav.size] = nav
    at = own - states.SENSORS + states.NAV_SENSORS
    out[at], out[at + 1] = sign * line.offset, sign * line.rate
    return out


def _add(p: np.ndarray, offsets: np.ndarray, covariance: np.ndarray) -> None:
    """Add a covariance (2, 2) of offset and rate, which the clocks have in common, to P (n, n) in place; offsets: of
    the states."""
    for i, j in np.ndindex(2, 2):
        p[np.ix_(offsets + i, offsets + j)] += covariance[i, j]


@dataclass(frozen=True)
class _ReceiverClock:
    """The receiver's clock against the sources' at a start, by a line through the first ranges less distances."""

    offset: float
    """m."""
    rate: float
    """m/s, 0 if unknown."""
    covariance: np.ndarray
    """(2, 2) of offset and rate; wide compared with the error of the line."""
    of_receiver: bool
    """Whether they are states; otherwise the receiver's clock is the reference."""


def _let_go_on(p: np.ndarray, offsets: np.ndarray, sensors: SensorDesign, dt: float) -> None:
    """Propagate P (n, n) of the clocks over dt, s, in place."""
    if dt <= 0.0:
        return
    clocks = np.stack([offsets, offsets + 1], axis=1).ravel()
    noise = np.array([[one.phase, one.frequency] for _, one in sensors.clocks])
    gathered = np.kron(np.ones((offsets.size,) * 2), _noise(np.array(sensors.reference_clock[:2]), dt))
    for k, density in enumerate(noise):
        gathered[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += _noise(density, dt)
    on = np.kron(np.eye(offsets.size), np.array([[1.0, dt], [0.0, 1.0]]))
    p[np.ix_(clocks, clocks)] = on @ p[np.ix_(clocks, clocks)] @ on.T + gathered


def _noise(density: np.ndarray, dt: float) -> np.ndarray:
    """Covariance (2, 2) that the noise of a clock adds to offset and rate over dt, s."""
    offset, both, rate = step_covariance(density, np.array(dt))
    return np.array([[offset, both], [both, rate]])


def _receiver_clock(flight: RecordedFlight, begin: PartStart, design: FilterDesign) -> _ReceiverClock:
    """The line is that of the reference if this is a source that is heard among the first, otherwise the median of the
    sources heard then. Its sigmas are those of `UNKNOWN_CLOCK` at the first ranges."""
    axes = {block.first for block in design.sensors.blocks if block.sensor == BEACON and block.clock is not None}
    of_receiver, clock = BEACON_STATES * len(axes) in axes, BEACON_STATES * len(axes) + 3
    heard = {beacon: _first_of(*each) for beacon, each in _excess(flight, begin, design.latency).items()}
    first = min((time[0] for time, _ in heard.values()), default=0.0)
    early = {beacon: each for beacon, each in heard.items() if each[0][0] <= first + _FIRST_S}
    of_datum = [each for beacon, each in early.items() if of_receiver and clock + 2 * beacon not in axes]
    slopes = np.array([_slope(*each) for each in of_datum])
    if not np.isfinite(slopes).any():
        slopes = np.array([_slope(*each) for each in early.values()])
    shown = slopes[np.isfinite(slopes)]
    rate = float(np.median(shown)) if shown.size else 0.0
    sigma = np.array([UNKNOWN_CLOCK[0], UNKNOWN_CLOCK[1] if shown.size else UNKNOWN_RATE])
    if not early:
        return _ReceiverClock(0.0, rate, np.diag(sigma**2), of_receiver)
    used = of_datum or list(early.values())
    away = [np.median(each - rate * (time - begin.alignment.time)) for time, each in used]
    back = np.array([[1.0, begin.alignment.time - float(np.median([np.median(time) for time, _ in used]))], [0.0, 1.0]])
    return _ReceiverClock(float(np.median(away)), rate, back @ np.diag(sigma**2) @ back.T, of_receiver)


def _first_of(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first of some values and of their times (k,), s, `_PAIRED` at most."""
    last = max(time[0] + _FIRST_S, time[min(_FIRST, time.size) - 1])
    return _thinned(time[time <= last], value[time <= last])


def _thinned(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`_PAIRED` values at most, spread evenly."""
    few = np.unique(np.linspace(0, time.size - 1, min(time.size, _PAIRED)).astype(int))
    return time[few], value[few]


def _slope(time: np.ndarray, value: np.ndarray) -> float:
    """Median slope of all pairs of values at times (k,), s (Theil-Sen); nan if they are too close."""
    later = time - time[:, None]
    if not later.max(initial=0.0) >= _SHORTEST:
        return np.nan
    apart = later > 0.0
    return float(np.median((value - value[:, None])[apart] / later[apart]))


def _excess(flight: RecordedFlight, begin: PartStart, latency: float) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Times (k,), s, and excesses over the distance (k,), m, of the ranges of each source (its number) after a start.

    Ranges without a fix near them are left out. latency: of the fixes, s.
    """
    here, place = _places(flight, begin, latency)
    out = {}
    for aid in flight.aids:
        if not isinstance(aid.table, BeaconTable) or here.size < 2:
            continue
        after = np.searchsorted(here, aid.time)
        known = (after > 0) & (after < here.size) & np.isfinite(aid.table.range)
        known &= np.diff(here)[np.clip(after - 1, 0, here.size - 2)] <= _GAP
        if known.any():
            time, beacon = aid.time[known], int(aid.table.beacon[0])
            at = np.stack([np.interp(time, here, axis) for axis in place.T], axis=1)
            away = np.linalg.norm(at - aid.table.position[beacon], axis=1)
            out[beacon] = time, aid.table.range[known] - away
    return out


def _places(flight: RecordedFlight, begin: PartStart, latency: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (k,), s, and positions (k, 3), ECEF, m, at a start and at the fixes after it; the first seconds by the
    velocity of the start, if no fix follows soon."""
    start, first = begin.alignment.time, ecef_from_llh(begin.llh)
    valid = flight.arrival - latency
    fixed = np.isfinite(flight.llh[:, 0]) & (valid > start)
    time, place = valid[fixed], ecef_from_llh(flight.llh[fixed])
    if not time.size or time[0] > start + _GAP:
        ahead = first + _FIRST_S * ned_matrix(begin.llh).T @ begin.velocity
        time, place = np.append(start + _FIRST_S, time), np.concatenate([ahead[None], place])
    return np.append(start, time), np.concatenate([first[None], place])


def find_far_clocks(
    flight: RecordedFlight, flown: Replayed, names: tuple[str, ...], clocks: OneWayClocks
) -> list[Finding]:
    """Findings of sources whose ranges the gate mostly rejected, and whose clocks are farther apart at the start, or
    in rate, than the log expects."""
    excess = {names[beacon]: each for beacon, each in _excess(flight, flight.start, 0.0).items()}
    rejected = [
        names[int(aid.table.beacon[0])]
        for aid, own in zip(flight.aids, flown.aids, strict=True)
        if isinstance(aid.table, BeaconTable) and _mostly_rejected(own.status)
    ]
    start = flight.start.alignment.time
    apart = {name: _against(excess, name, clocks.datum, start) for name in rejected if name in excess}
    out = []
    for name, k, limit, words in (
        ("offset", 0, FAR * clocks.offset_sigma_m, ("offset_sigma_m", "m", "at the start their clocks are")),
        ("rate", 1, FAST * clocks.rate_sigma_m_s, ("rate_sigma_m_s", "m/s", "rates of their clocks are")),
    ):
        far = [source for source, each in apart.items() if each[k] > limit]
        if far:
            key, unit, what = words
            most = digits(max(apart[source][k] for source in far), 2)
            text = (
                f"the filter rejects ranges of {', '.join(far)}: {what} up to {most} {unit} apart from the others, "
                f"where clocks.{key} is {getattr(clocks, key):g} {unit}. Write `clocks.{key}: {most}`"
            )
            out.append(Finding(f"clock_{name}", text, (), len(far), len(names)))
    return out


def _mostly_rejected(status: np.ndarray) -> bool:
    """Whether most ranges that the filter weighed have the status of rejection, (k,) int."""
    return bool(np.sum(status == REJECTED) > MOSTLY * np.sum(status != NOT_USED))


def _against(
    excess: dict[str, tuple[np.ndarray, np.ndarray]], name: str, datum: str, start: float
) -> tuple[float, float]:
    """How far the clock of a source is from those of others at a time start, s: offset, m, and rate, m/s, without sign.

    The other is the reference if ranges of both are from the same seconds, otherwise the median of all. A rate within
    its noise counts as 0.
    """
    found = {other: _difference(excess[name], each, start) for other, each in excess.items()}
    if np.isfinite(found.get(datum, (np.nan,))[0]):
        found = {datum: found[datum]}
    both = np.array([each for each in found.values() if np.isfinite(each[0])])
    offset, rate = np.median(both, axis=0)
    return abs(float(offset)), abs(float(rate))


def _difference(
    own: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray], start: float
) -> tuple[float, float]:
    """Offset at a time start, s, and rate of one series against another, m, m/s; nan if they have no times in common, a
    rate of 0 if it is within its noise."""
    (time, value), (there, reference) = own, other
    after = np.clip(np.searchsorted(there, time), 1, max(there.size - 1, 1))
    common = (time >= there[0]) & (time <= there[-1])
    if there.size > 1:
        common &= there[after] - there[after - 1] <= _GAP
    if not common.any():
        return np.nan, np.nan
    time, apart = time[common], (value - np.interp(time, there, reference))[common]
    first, (time, apart) = time[0], _thinned(time[time <= time[0] + _COMPARED_S], apart[time <= time[0] + _COMPARED_S])
    rate = _slope(time, apart)
    if np.isnan(rate):  # the common times are too short to show one
        rate = 0.0
    left = apart - rate * (time - first)
    middle = float(np.median(left))
    noise = 1.5 * np.median(np.abs(left - middle)) * np.sqrt(12.0 / time.size) / max(time[-1] - first, _SHORTEST)
    rate = rate if abs(rate) > FAR * noise else 0.0
    return middle - rate * (first - start), rate


def write_clocks(
    draft: ResultBuilder, flown: Replayed, wanted: np.ndarray, sensors: SensorDesign, names: tuple[str, ...],
    clocks: OneWayClocks,
) -> None:  # fmt: skip
    """Offset and rate of each clock against the reference, at wanted outputs (t,) bool; at the end with their 1 sigma,
    or nan where the ranges do not show them."""
    shown, every = [name for name in (RECEIVER, *names) if name != clocks.datum], list(draft["/filter/state"])
    offset = np.array([every.index(_state_name(name).format("")) for name in shown])
    variance, value = np.diagonal(flown.covariance), flown.navigation[:, states.NAV_SENSORS - states.SENSORS :]
    first = np.diagonal(sensors.covariance(np.ones(states.SENSORS)))
    draft.put("/clock", np.array(shown, dtype=object), {"datum": clocks.datum})
    for what, at in (("offset", offset), ("rate", offset + 1)):
        seen = ~unobserved_states(first[at], variance[at])
        draft[f"/filter/clock_{what}"] = value[wanted][:, at]
        draft[f"/summary/clock_{what}"] = np.where(seen, value[-1, at], np.nan)
        draft[f"/summary/clock_{what}_sigma"] = np.where(seen, flown.sigma[-1, at], np.nan)


def alike_states(flown: Replayed, names: list[str]) -> list[Finding]:
    """Finding of states of position and ranges that the geometry cannot tell apart at the end.

    Two clocks do not count: they are correlated by the reference against which both are counted.
    """
    of_ranges = [k for k, name in enumerate(names) if name.startswith(("position_", "beacons_", "transmitter_"))]
    clocks = [k for k in of_ranges if names[k].startswith(("beacons_clock", "transmitter_clock"))]
    found = correlated_states(flown.covariance, np.array(of_ranges))
    pairs = [pair for pair in found if pair[0] not in clocks or pair[1] not in clocks]
    if not pairs:
        return []
    shown = [states.display_name(name) for name in names]
    worst = "; ".join(f"{shown[a]} and {shown[b]} ({c:+.4f})" for a, b, c in pairs[:4])
    text = (
        f"at the end the geometry cannot tell apart {several(len(pairs), 'pair')} of states (correlation beyond 0.99): "
        f"{worst}. Only a combination of each pair is known to its sigma"
    )
    return [Finding("correlated_states", text, count=len(pairs), of=len(of_ranges))]
