"""Clocks of one-way ranges beside an inertial sensor, as states.

A pseudorange contains the receiver's clock and that of its transmitter, each with offset and rate:

    r_i = |p - p_i| + c (dt_receiver - dt_i) + e

Ranges show only differences of clocks, so one clock is the reference. The others are counted against it, and share its
noise and its uncertainty at the start. Without the reference, an offset of all transmitters could not be told from one
of the receiver.

Source: `docs/theory/beacons.md`, section 3; the same model as of ranges alone (`ranging.model`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import states
from navsim.filter.design import SensorDesign
from navsim.filter.measurement_kinds import BEACON, BEACON_STATES, BeaconTable
from navsim.filter.records import REJECTED
from navsim.filter.states import Block, ReferenceClock
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.clock_noise import step_covariance
from navsim.ranging.evaluation import unobserved_states
from navsim.ranging.model import RECEIVER, UNKNOWN_CLOCK
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
FAR = 5.0
"""Offset of a clock, in the 1 sigma that the log expects, beyond which a finding is reported."""
MOSTLY = 0.5
"""Share of a source's ranges."""
_FIRST = 5
"""Number of first ranges whose median shows the offset of a clock."""


def _state_name(clock: str) -> str:
    """Name of the states of a clock: with "" in it that of the offset, with "_rate" that of the rate."""
    return RECEIVER_CLOCK if clock == RECEIVER else _OF_SOURCE + clock


def one_way_blocks(names: tuple[str, ...], clocks: OneWayClocks) -> list[tuple[Block, float]]:
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
    nav: np.ndarray, matrix: np.ndarray, flight: RecordedFlight, begin: PartStart, sensors: SensorDesign
) -> np.ndarray:
    """Navigation state (NAV,) with first offsets of the clocks of one-way ranges; propagates P (n, n) of the clocks, as
    it is at the start of the flight, to the start of a part, in place."""
    if not sensors.clocks:
        return nav
    offsets = np.array([first for first, _ in sensors.clocks])
    _let_go_on(matrix, offsets, sensors, begin.alignment.time - flight.start.alignment.time)
    out = np.zeros(states.NAV_SENSORS + matrix.shape[0] - states.SENSORS)
    out[: nav.size] = nav
    ahead, of_receiver = _receiver_offset(flight, begin, sensors)
    at = offsets - states.SENSORS + states.NAV_SENSORS
    out[at[:1] if of_receiver else at] = ahead if of_receiver else -ahead
    return out


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


def _receiver_offset(flight: RecordedFlight, begin: PartStart, sensors: SensorDesign) -> tuple[float, bool]:
    """The receiver's offset against the sources by the first ranges after a start, m, and whether it is a state.

    It is that against the reference if this is a source with ranges, otherwise the median of all sources. The filter's
    prior is wide compared with its error.
    """
    axes = {block.first for block in sensors.blocks if block.sensor == BEACON and block.clock is not None}
    excess, count = _first_excess(flight, begin), len(axes)
    of_receiver = BEACON_STATES * count in axes
    clock = BEACON_STATES * count + 3
    chosen = [away for beacon, away in excess.items() if of_receiver and clock + 2 * beacon not in axes]
    chosen = chosen or list(excess.values())
    return (float(np.median(chosen)) if chosen else 0.0), of_receiver


def _first_excess(flight: RecordedFlight, begin: PartStart) -> dict[int, float]:
    """How much longer the first ranges of each source (its number) after a start are than its distance, m, by the
    nearest fixes (median)."""
    fixed, out = np.flatnonzero(np.isfinite(flight.llh[:, 0])), {}
    for aid in flight.aids:
        if not isinstance(aid.table, BeaconTable):
            continue
        later = np.flatnonzero((aid.time > begin.alignment.time) & np.isfinite(aid.table.range))[:_FIRST]
        if later.size:
            apart = np.abs(flight.arrival[fixed] - aid.time[later, None])
            here = flight.llh[fixed[np.argmin(apart, axis=1)]] if fixed.size else begin.llh[None]
            beacon = int(aid.table.beacon[later[0]])
            away = np.linalg.norm(ecef_from_llh(here) - aid.table.position[beacon], axis=1)
            out[beacon] = float(np.median(aid.table.range[later] - away))
    return out


def find_far_clocks(
    flight: RecordedFlight, flown: Replayed, names: tuple[str, ...], clocks: OneWayClocks
) -> list[Finding]:
    """Finding of sources whose ranges the gate mostly rejected, and whose clocks are farther apart at the first ranges
    than the log expects."""
    excess = {names[beacon]: away for beacon, away in _first_excess(flight, flight.start).items()}
    reference = excess.get(clocks.datum, float(np.median(list(excess.values()))) if excess else 0.0)
    apart = {name: abs(away - reference) for name, away in excess.items()}
    rejected = [
        names[int(aid.table.beacon[0])]
        for aid, own in zip(flight.aids, flown.aids, strict=True)
        if isinstance(aid.table, BeaconTable) and aid.time.size and np.mean(own.status == REJECTED) > MOSTLY
    ]
    far = [name for name in rejected if apart.get(name, 0.0) > FAR * clocks.offset_sigma_m]
    if not far:
        return []
    most = digits(max(apart[name] for name in far), 2)
    text = (
        f"the filter rejects ranges of {', '.join(far)}: at the first ranges their clocks are up to {most} m apart "
        f"from the others, where clocks.offset_sigma_m is {clocks.offset_sigma_m:g} m. Write "
        f"`clocks: {{offset_sigma_m: {most}}}`"
    )
    return [Finding("clock_offset", text, (), len(far), len(apart))]


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
