"""Importance sampling of landings that end outside a box, by a shift of all random inputs.

To first order the error at a height is a linear function of all inputs of a landing (`simulation.sensitivity`). Of all
inputs that bring the error to a face of the box, the likeliest are the covariance of the inputs times the slopes of the
error. The inputs of a run are drawn as usual and then shifted there. The ratio of the densities with and without the
shift depends on that linear function alone, whatever the filter then does. Weighted by it, the runs give unbiased
probabilities.

Runs are drawn from a mixture of shifts: one for each face, some half as far, some none. A weight never exceeds one over
the share of runs without a shift. Errors that no face represents thus cost accuracy but cause no bias.

Equations: `docs/theory/covariance.md`, section 3.

Sources:

- [1] Owen & Zhou, Safe and effective importance sampling, JASA 95 (2000) (mixtures with a defensive component).
- [2] Veach & Guibas, Optimally combining sampling techniques for Monte Carlo rendering, SIGGRAPH (1995) (the balance
  heuristic).
- [3] Bucklew, Introduction to Rare Event Simulation (2004) (shifts to the likeliest way into a rare set).
- [4] Rubinstein & Kroese, The Cross-Entropy Method (2004) (proposals nearest to the rare set, from a few samples).
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter.estimate import in_all_lanes
from navsim.filter.records import REJECTED
from navsim.gnss.fix_states import FIXED, FixStates, StatedFixes, StateHistory
from navsim.simulation.alarm_events import SHARE, AlarmProposal, AlarmPush
from navsim.simulation.along_truth import along_truth
from navsim.simulation.dispersed_trajectory import Dispersion
from navsim.simulation.flight import Flight
from navsim.simulation.landing import fly_inputs
from navsim.simulation.run_inputs import Inputs, draw_inputs, draw_states
from navsim.simulation.sensitivity import Slopes, by_scale, carried, deviations, of_aid, of_states, sensitivity
from navsim.statistics import normal
from navsim.statistics.importance_sampling import LEAST
from navsim.statistics.random_streams import generator
from navsim.trajectory.dispersion import PathDeviation
from navsim.trajectory.guidance import slopes_by_errors

_FULL, _HALF = 0.8, 0.1
"""Shares of the runs that are shifted to a face, and halfway; the rest is not shifted."""
_EVENLY = 0.5
"""Share of the pushes that goes to all faces alike; the rest goes by their probabilities to first order."""
_MOST_EXPONENT = 700.0
"""Largest exponent of a number."""
_STEPS = 1001
"""Places between two faces at which weights are looked at."""
_CHAIN = 0.2
"""Share of the histories of fix states that the chain itself draws."""
_BEFORE = (0.0, 5.0, 15.0)
"""Times before the box until which the state of the other histories is given, s: filters and autopilots are slow."""
_LASTED = (0.0, 2.0)
"""How long it has lasted then at least, in mean times of the state."""
_TRIALS, _FITS = 4, 3
"""Histories of each kind that decide how many runs get it, and the iterations that this takes."""
_FAR = 5.0
"""Limits of the box in sigmas of a fix, from which on a gate rejects the fixes after errors that reach them."""
_KEPT = 16
"""Slopes that are kept for other histories with the same flags."""
_keeping = threading.Lock()
"""Of what threads share in `ShiftsByHistory.kept`; a study that goes to other processes can contain no lock."""


@dataclass(frozen=True)
class Proposal:
    """Proposal density of the inputs: a mixture of shifts."""

    covariance: np.ndarray
    """(K, K) of the errors that a box bounds, to first order."""
    shifts: np.ndarray
    """(C, K) of the components: a push c shifts the means of the errors by covariance c."""
    shares: np.ndarray
    """(C,) of the components; the last does not shift."""

    @property
    def most_weight(self) -> float:
        """No weight is above this."""
        return float(1.0 / self.shares[-1])

    def most_weight_between(self, low: np.ndarray, high: np.ndarray) -> float:
        """No weight is above this where the errors to first order are from low to high (K,) off their means; where
        either is not finite nothing is known of that error."""
        density = float(self.shares[~self.shifts.any(axis=1)].sum())
        for k in np.flatnonzero(np.isfinite(low) & np.isfinite(high)):
            along = self.shifts[:, k] != 0.0  # a push is along one error
            push = self.shifts[along, k, None]
            exponents = push * np.linspace(low[k], high[k], _STEPS) - 0.5 * push**2 * self.covariance[k, k]
            # far faces have pushes beyond any number at their own side, where the least is not
            density += float((self.shares[along] @ np.exp(np.minimum(exponents, _MOST_EXPONENT))).min())
        return 1.0 / density

    def drawn(self, seed: int, run: int) -> int:
        """The component of a run."""
        ends = np.cumsum(self.shares)
        return int(np.searchsorted(ends, generator(seed, run, "tilt").random() * ends[-1], side="right"))

    def log_weights(self, errors: np.ndarray) -> np.ndarray:
        """Logarithms (W,) of the density without pushes over that of the mixture, where the errors to first order are
        (K, W) off their means."""
        square = np.einsum("ci,ij,cj->c", self.shifts, self.covariance, self.shifts)
        exponents = self.shifts @ errors - 0.5 * square[:, None]
        most = exponents.max(axis=0)
        return -(most + np.log(self.shares @ np.exp(exponents - most)))


def proposal(mean: np.ndarray, covariance: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Proposal:
    """The proposal for a box with least and largest errors (K,), infinite for none, that have this mean (K,) and
    covariance (K, K) to first order. Raises ValueError for a limited error that does not vary."""
    from scipy.special import ndtr

    sigma = np.sqrt(np.diagonal(covariance))
    faces = list(itertools.product(np.flatnonzero(np.isfinite(upper)).tolist(), (1.0, -1.0)))
    if not all(sigma[k] > 0.0 for k, _ in faces):
        raise ValueError("an error that the box bounds does not depend on anything that is drawn")
    way = np.array([(upper if sign > 0.0 else lower)[k] - mean[k] for k, sign in faces])
    inside = np.array([sign * w > 0.0 for w, (_, sign) in zip(way, faces, strict=True)])
    to_face = np.zeros((len(faces), upper.size))
    for row, (k, _) in enumerate(faces):
        # a face that the mean error is beyond needs no push
        to_face[row, k] = way[row] / covariance[k, k] if inside[row] else 0.0
    sigmas = np.array([abs(w) / sigma[k] for w, (k, _) in zip(way, faces, strict=True)])
    chance = np.where(inside, ndtr(-sigmas), 1.0)
    # far faces may be beyond any number: their shares among themselves are even then
    likely = chance / chance.sum() if chance.sum() > 0.0 else np.full(len(faces), 1.0 / len(faces))
    share = _EVENLY / len(faces) + (1.0 - _EVENLY) * likely
    return Proposal(
        covariance,
        np.concatenate([to_face, 0.5 * to_face, np.zeros((1, upper.size))]),
        np.concatenate([_FULL * share, _HALF * share, [1.0 - _FULL - _HALF]]),
    )


@dataclass(frozen=True)
class ProposalShifts:
    """Shifts of the inputs of a flight towards the faces of a box."""

    slopes: Slopes
    """Slopes of the K errors that the box bounds."""
    shifts: Slopes
    """Covariance of the inputs times the slopes."""
    mean: np.ndarray
    """(K,) of the errors to first order."""
    proposal: Proposal
    air: AirShifts | None = None
    """Of what moves aircraft off the route beside their estimates; None if all fly it."""


@dataclass(frozen=True)
class AirShifts:
    """Shifts of the walks that move aircraft off the route, as their states."""

    weights: np.ndarray
    """(K, k, 3) of positions, along path axes at the samples, in the K errors."""
    walks: dict[int, np.ndarray]
    """(K, k, n) covariance of a walk's states times their slopes, by number of its stream."""
    covariance: np.ndarray
    """(K, K) of the errors by these walks."""
    mean: np.ndarray
    """(K,) errors where the walks are zero."""
    answered: np.ndarray
    """(K, k, 3, 2) slopes of the errors by what guidance knows of `PathDeviation.displaced`."""

    @classmethod
    def of(cls, ways: Dispersion, weights: np.ndarray) -> AirShifts:
        """Those of errors that are sums of positions with weights (K, k, 3)."""
        air, (count, samples) = ways.disturbance, weights.shape[:2]
        sizes = {number: walk.start.shape[0] for number, walk in air.walks.items()}
        at_rest = air.at_rest
        answered = np.zeros((count, 0, 3, 2))
        if len(at_rest.displaced):
            assert air.air.autopilot is not None
            step = float(air.time[1] - air.time[0])
            answered = -slopes_by_errors(air.air.autopilot, np.arange(samples), air.course, air.slope, step, weights)
        walks, covariance = {}, np.zeros((count, count))
        for number, n in sizes.items():
            unit = {other: np.zeros((samples, m, n)) for other, m in sizes.items()}
            unit[number] += np.eye(n)
            moved = air.of_states(unit, n)
            rows = np.einsum("Kta,tan->Ktn", weights, moved.way[:, :3] - at_rest.way[:, :3])
            if answered.size:
                rows += np.einsum("Ktai,tain->Ktn", answered, moved.displaced - at_rest.displaced)
            walks[number] = air.walks[number].carried(rows)
            covariance += np.einsum("itn,jtn->ij", rows, walks[number])
        mean = np.einsum("Kta,taw->K", weights, at_rest.way[:, :3])
        mean += np.einsum("Ktai,taiw->K", answered, at_rest.displaced)
        return cls(weights, walks, covariance, mean, answered)

    def off(self, departure: PathDeviation) -> np.ndarray:
        """Errors (K, W) off their mean of runs that nothing else takes off the route."""
        out = np.einsum("Kta,taw->Kw", self.weights, departure.way[:, :3]) - self.mean[:, None]
        return out + np.einsum("Ktai,taiw->Kw", self.answered, departure.displaced)


def proposal_shifts(
    flight: Flight, slopes: Slopes, mean: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    air: AirShifts | None = None, shifts: Slopes | None = None,
) -> ProposalShifts:  # fmt: skip
    """The pushes for a box; slopes: of the K errors that it bounds; mean, lower, upper: see `proposal`, which raises
    ValueError; air, shifts: see `ProposalShifts`, shifts are computed if None."""
    shifts = carried(flight, slopes) if shifts is None else shifts
    pairs = zip(slopes.members(), shifts.members(), strict=True)
    parts = [np.einsum("ki,li->kl", *(m.reshape(m.shape[0], -1) for m in pair)) for pair in pairs]
    covariance = np.sum(parts, axis=0)
    if air is not None:
        covariance = covariance + air.covariance
    return ProposalShifts(slopes, shifts, mean, proposal(mean, 0.5 * (covariance + covariance.T), lower, upper), air)


@dataclass(frozen=True)
class ShiftsByHistory:
    """Shifts of the inputs of a flight whose fixes have a state: of what is Gaussian given the history of states."""

    flight: Flight
    weights: np.ndarray
    """(K, o, 6) see `sensitivity`."""
    mean: np.ndarray
    """(K,) of the errors that the box bounds, without those of the filter."""
    lower: np.ndarray
    """(K,) of the box, also `upper`."""
    upper: np.ndarray
    air: AirShifts | None
    """See `ProposalShifts`."""
    kept: dict[bytes, tuple[Slopes, Slopes]] = field(default_factory=dict)
    """Slopes and shifts by the sigmas of the fixes in the filter and by rejections, which alone change with a
    history."""

    @property
    def narrowest(self) -> float:
        """Smallest error on the faces of the box."""
        faces = np.abs([self.lower, self.upper])
        return float(faces[np.isfinite(faces)].min())

    @property
    def model(self) -> FixStates:
        """The chain of states."""
        assert self.flight.shared.fix_states is not None
        return self.flight.shared.fix_states

    def of(self, history: StateHistory) -> ProposalShifts:
        """Those of a history. Where wrong fixes are far off, a flight with the shifts tells which fixes the gate
        rejects: after one that it accepts, velocity may still be wrong, and it rejects further ones."""
        time, design = self.flight.shared.signals.time, self.flight.design
        assert design.flag_sigma is not None
        rejected = np.zeros(time.size, bool)
        if self.narrowest > _FAR * np.nanmax(design.flag_sigma[FIXED]) and np.isfinite(design.gate).any():
            rejected = self.model.rejected(history, time, design.max_rejected)
        out = self._with_rejections(history, rejected)
        if not rejected.any():
            return out
        flown = self._rejected(history, out)
        return out if (flown == rejected).all() else self._with_rejections(history, flown)

    @cached_property
    def _exact(self) -> Inputs:
        """Inputs along the route without random errors, but for carrier phases, which stated fixes do not use."""
        flight = self.flight.along_route
        drawn = replace(draw_inputs(flight, 0, (0,)), stated=None)
        initial, dtheta, dv, ranges, rates, *others = deviations(flight, drawn)
        aided = others[len(others) - len(drawn.aided) :]
        return replace(
            drawn, initial=drawn.initial - initial, dtheta=drawn.dtheta - dtheta, dv=drawn.dv - dv,
            ranges=drawn.ranges - ranges, rates=drawn.rates - rates,
            aided=tuple(each - off for each, off in zip(drawn.aided, aided, strict=True)),
        )  # fmt: skip

    def _rejected(self, history: StateHistory, tilt: ProposalShifts) -> np.ndarray:
        """Fixes (e,) that the gate rejects on a flight along the route with the most frequent shift to a face."""
        time, known = self.flight.shared.signals.time, np.zeros((self.flight.shared.signals.time.size, 6))
        place = history.at(time)
        known[:, :3] = self.model.lasting_errors(history)[1][place]
        of_lanes = (
            in_all_lanes(each) for each in (history.state[place], self.model.flags(history, time), known, known)
        )
        inputs = replace(self._exact, stated=StatedFixes(*of_lanes))
        face = int(tilt.proposal.shares[: (tilt.proposal.shares.size - 1) // 2].argmax())
        flown = fly_inputs(self.flight.along_route, _shifted([tilt], inputs, [face]), 1)
        return np.asarray(flown.status[0] == REJECTED)

    def _with_rejections(self, history: StateHistory, rejected: np.ndarray) -> ProposalShifts:
        """Shifts of a history if the gate rejects these fixes (e,)."""
        shared = self.flight.shared
        flags, sigma = self.model.flags(history, shared.signals.time), self.flight.design.flag_sigma
        assert sigma is not None
        key = sigma[flags].tobytes() + rejected.tobytes()
        with _keeping:
            known = self.kept.get(key)
        if known is None:
            slopes = sensitivity(self.flight, along_truth(self.flight, flags, rejected), self.weights)
            known = slopes, carried(self.flight, slopes, history)
            with _keeping:
                while len(self.kept) >= _KEPT:
                    self.kept.pop(next(iter(self.kept)))
                self.kept[key] = known
        slopes, shifts = known
        ranges, rates, _ = of_states(shared, slopes, history)
        lasting = self.model.lasting_errors(history)[1][history.at(shared.signals.time)]
        mean = self.mean + slopes.mean + np.einsum("kea,ea->k", slopes.ranges, lasting)
        return proposal_shifts(self.flight, slopes, mean, self.lower, self.upper, self.air,
                               replace(shifts, ranges=ranges, rates=rates))  # fmt: skip

    def chances(self, tilt: ProposalShifts) -> np.ndarray:
        """Probabilities (K,) that each error is beyond its limits, to first order, with shifts of a history."""
        chance = normal.outside(self.lower, self.upper, tilt.mean, np.sqrt(np.diagonal(tilt.proposal.covariance)))
        return np.where(np.isfinite(self.upper), chance, 0.0)


class DrawnHistory(NamedTuple):
    """History of the fix states of a run."""

    history: StateHistory
    log_weight: float
    """Logarithm of its weight."""
    from_chain: bool
    """Whether the chain itself drew it."""


@dataclass(frozen=True)
class HistoryProposal:
    """Proposal density of the histories of fix states: a mixture of the chain, and of the chain given that it has a
    state from one time to another.

    Given that, the density of a history is that of the chain over the probability of the state from then to then, for
    histories that have it, and 0 for others.
    """

    shifts: ShiftsByHistory
    since: np.ndarray
    """(C,) times of the components, s."""
    until: np.ndarray
    """(C,) likewise."""
    state: np.ndarray
    """(C,) states of the components."""
    shares: np.ndarray
    """(C,) of the components; the rest is that of the chain itself."""

    @classmethod
    def of(cls, shifts: ShiftsByHistory, box_time: float) -> HistoryProposal:
        """Half of the runs given a state go to all components alike, half by the probabilities of leaving the box, to
        first order: the mixture that is nearest to the histories outside [4]."""
        model = shifts.model
        given = [
            (max(box_time - before - lasted * model.mean_time[n], 0.0), max(box_time - before, 0.0), n)
            for before, lasted in itertools.product(_BEFORE, _LASTED)
            for n in np.flatnonzero(model.shares > LEAST)
        ]
        since, until, state = map(np.array, zip(*given, strict=True))
        out, likely = cls(shifts, since, until, state, np.zeros(state.size)), np.full(state.size, 1.0 / state.size)
        drawn = [out.history_of(generator(c, k, "tilt", 2), c) for c in range(state.size) for k in range(_TRIALS)]
        density = np.array([out._densities(history) for history in drawn])
        tilts = [shifts.of(model.with_forced(history)) for history in drawn]
        outside = np.minimum(np.sum([shifts.chances(tilt) for tilt in tilts], axis=1), 1.0) / density.mean(axis=1)
        some = outside > LEAST * outside.sum()
        density, outside = density[some], outside[some]
        for _ in range(_FITS if outside.size else 0):
            of_each = density * likely
            likely = outside @ (of_each / of_each.sum(axis=1, keepdims=True)) / outside.sum()
        return replace(out, shares=(1.0 - _CHAIN) * (_EVENLY / state.size + (1.0 - _EVENLY) * likely))

    @property
    def most_weight(self) -> float:
        """No weight is above this."""
        return 1.0 / _CHAIN

    def history_of(self, rng: np.random.Generator, component: int) -> StateHistory:
        """History without forced states that a component draws; one beyond the last is the chain."""
        model, end = self.shifts.model, float(self.shifts.flight.shared.signals.time[-1])
        if component >= self.state.size:
            return model.unforced(rng, end)
        given = int(self.state[component]), float(self.since[component]), float(self.until[component])
        return model.unforced(rng, end, *given)

    def _densities(self, history: StateHistory) -> np.ndarray:
        """Densities (C,) of a history by each component over that by the chain."""
        model, place = self.shifts.model, history.at(self.since)
        has = (history.state[place] == self.state) & (place == history.at(self.until))
        lasts = np.exp((self.since - self.until) / model.mean_time[self.state])
        return np.where(has, 1.0 / (model.shares[self.state] * lasts), 0.0)

    def drawn(self, seed: int, run: int) -> DrawnHistory:
        """That of a run."""
        rng, ends = generator(seed, run, "tilt", 1), np.cumsum(self.shares)
        component = int(np.searchsorted(ends, rng.random(), side="right"))
        history = self.history_of(rng, component)
        density, chain = _CHAIN + self.shares @ self._densities(history), component == self.state.size
        return DrawnHistory(self.shifts.model.with_forced(history), -float(np.log(density)), chain)


@dataclass(frozen=True)
class PushedRuns:
    """Pushes of runs: what is drawn shifts, whatever trajectory it leads to (`landing.Pushes`)."""

    flight: Flight
    tilt: ProposalShifts
    seed: int
    histories: HistoryProposal | None = None
    """Of fixes that have a state; shifts are then by history, instead of `tilt`."""
    alarms: AlarmProposal | None = None
    """Alarms in some of the runs instead of shifts to the box; None without."""
    kept: dict[tuple[int, ...], dict[int, np.ndarray]] = field(default_factory=dict)
    """`walks` of runs that have flown: the same runs fly several times."""
    by_run: dict[int, tuple[DrawnHistory, ProposalShifts]] = field(default_factory=dict)
    """`histories_of` and `tilts` of runs likewise."""
    by_alarm: dict[int, AlarmPush] = field(default_factory=dict)
    """Their pushes to alarms likewise."""
    moved: dict[tuple[int, ...], Inputs] = field(default_factory=dict)
    """`_along_route` of the last runs."""

    def tilts(self, runs: Sequence[int]) -> list[ProposalShifts]:
        """The shifts of each lane, or one for all."""
        if self.histories is None:
            return [self.tilt]
        return [tilt for _, tilt in self._by_history([*runs, *[runs[-1]] * (WIDTH - len(runs))])]

    def histories_of(self, runs: Sequence[int]) -> list[DrawnHistory]:
        """Histories of the fix states of runs; none if fixes have none."""
        return [] if self.histories is None else [drawn for drawn, _ in self._by_history(runs)]

    def _by_history(self, runs: Sequence[int]) -> list[tuple[DrawnHistory, ProposalShifts]]:
        """History and shifts of each run."""
        assert self.histories is not None
        for run in set(runs) - self.by_run.keys():
            drawn = self.histories.drawn(self.seed, run)
            self.by_run[run] = drawn, self.histories.shifts.of(drawn.history)
        return [self.by_run[run] for run in runs]

    def inputs(self, runs: Sequence[int], inputs: Inputs) -> Inputs:
        """Inputs of runs, shifted."""
        tilts, shared = self.tilts(runs), self.flight.shared
        inputs = self._stated(runs, inputs)
        out = self._with_alarms(runs, _shifted(tilts, inputs, self.components(runs)))
        ways, flown = self.flight.shared.dispersion, inputs.flown
        if ways is None or flown is None:
            return out
        pushes = self._each(runs)

        def scaled(pushes: np.ndarray, by: list[np.ndarray]) -> np.ndarray:
            if len(by) == 1:
                return (pushes @ by[0]).T
            return np.stack([push @ own for push, own in zip(pushes, by, strict=True)], axis=-1)

        # errors that depend on the trajectory are those of the run's own
        increments = [
            lanes + (own - exact[..., None]) * scaled(triad.scale**2 * pushes, [by_scale(m, exact) for m in by])
            for triad, lanes, own, exact, by in (
                (self.flight.gyro, out.dtheta, flown.dtheta, shared.dtheta, [t.slopes.dtheta for t in tilts]),
                (self.flight.accel, out.dv, flown.dv, shared.dv, [t.slopes.dv for t in tilts]),
            )
        ]
        aided = tuple(lanes.copy() for lanes in inputs.aided)
        for k, (aid, lanes, exact) in enumerate(zip(shared.aids, aided, inputs.aided_exact, strict=True)):
            for lane, push in enumerate(pushes):
                way, by = ways.of_run(flown, lane), _of_lane(tilts, lane).slopes.aided[k]
                lanes[..., lane] += of_aid(aid, np.tensordot(push, by, 1)[None], exact[..., lane], way)[0]
        return replace(out, dtheta=increments[0], dv=increments[1], aided=aided)

    def walks(self, runs: Sequence[int]) -> dict[int, np.ndarray]:
        """Shifts (k, n, W) of the states of the walks, by number of their stream."""
        assert self.tilt.air is not None
        if (key := tuple(runs)) not in self.kept:
            pushes = self._each(runs)
            self.kept[key] = {n: np.einsum("Ktn,wK->tnw", one, pushes) for n, one in self.tilt.air.walks.items()}
        return self.kept[key]

    def components(self, runs: Sequence[int]) -> list[int]:
        """The component of each run; the last one, which does not shift, where a test is to alarm."""
        proposals = [_of_lane(self.tilts(runs), lane).proposal for lane in range(len(runs))]
        return [
            one.shares.size - 1 if self.is_to_alarm(run) else one.drawn(self.seed, run)
            for one, run in zip(proposals, runs, strict=True)
        ]

    def is_to_alarm(self, run: int) -> bool:
        """Whether a run draws its ranges given an alarm."""
        return self.alarms is not None and self.alarms.is_chosen(self.seed, run)

    def _along_route(self, runs: Sequence[int]) -> Inputs:
        """Inputs of runs along the route, shifted."""
        if (key := tuple(runs)) not in self.moved:
            self.moved.clear()
            inputs = self._stated(runs, draw_inputs(self.flight.along_route, self.seed, runs))
            inputs = _shifted(self.tilts(runs), inputs, self.components(runs))
            if self.alarms is not None:
                for lane, run in enumerate(runs):
                    self.by_alarm[run] = self.alarms.push(self.seed, run, inputs, lane)
            self.moved[key] = self._with_alarms(runs, inputs)
        return self.moved[key]

    def _with_alarms(self, runs: Sequence[int], inputs: Inputs) -> Inputs:
        """Inputs with the ranges of runs in which a test is to alarm."""
        if self.alarms is None:
            return inputs
        if not self.by_alarm.keys() >= set(runs):
            self._along_route(runs)
        ranges, rates = inputs.ranges.copy(), inputs.rates.copy()
        phases = None if inputs.phases is None else inputs.phases.copy()
        for lane, run in enumerate([*runs, *[runs[-1]] * (WIDTH - len(runs))]):
            if (shift := self.by_alarm[run].shift) is not None:
                ranges[..., lane] += shift[0]
                rates[..., lane] += shift[1]
                if phases is not None and shift[2] is not None:
                    phases[..., lane] += shift[2]
        return replace(inputs, ranges=ranges, rates=rates, phases=phases)

    def off(self, runs: Sequence[int]) -> np.ndarray:
        """Errors (K, W) of runs to first order, off their means: sums over all that they draw, with its shift."""
        along, ways = self.flight.along_route, self.flight.shared.dispersion
        tilts = self.tilts(runs)
        moved = deviations(along, self._along_route(runs))
        if len(tilts) == 1:
            off = tilts[0].slopes.times(moved)
        else:
            each = [tilt.slopes.times([m[..., [k]] for m in moved]) for k, tilt in enumerate(tilts)]
            off = np.concatenate(each, axis=1)
        if ways is None or self.tilt.air is None:
            return off
        return off + self.tilt.air.off(ways.departure(self.seed, runs, WIDTH, shift=self.walks(runs)))

    def log_weights(self, runs: Sequence[int], off: np.ndarray) -> np.ndarray:
        """Logarithms (r,) of the density of what runs drew over that of what they were drawn from; off: see `off`."""
        tilts = self.tilts(runs)
        if self.histories is None:
            out = tilts[0].proposal.log_weights(off)
        else:
            out = np.concatenate([tilt.proposal.log_weights(off[:, [k]]) for k, tilt in enumerate(tilts)])
        out = out[: len(runs)]
        if self.alarms is not None:
            alarmed = np.array([self.by_alarm[run].log_ratio for run in runs])
            out = -np.logaddexp(np.log1p(-SHARE) - out, np.log(SHARE) + alarmed)
        if self.histories is not None:
            out = out + [drawn.log_weight for drawn in self.histories_of(runs)]
        return out

    def _stated(self, runs: Sequence[int], inputs: Inputs) -> Inputs:
        """Inputs of runs with their own histories of fix states."""
        if self.histories is None:
            return inputs
        histories = [drawn.history for drawn in self.histories_of(runs)]
        return replace(inputs, stated=draw_states(self.flight.shared, self.seed, runs, histories))

    def _each(self, runs: Sequence[int]) -> np.ndarray:
        """(W, K) pushes of runs; further lanes repeat the last."""
        return _pushes(self.tilts(runs), self.components(runs), WIDTH)


def shift_inputs(
    flight: Flight, tilt: ProposalShifts, inputs: Inputs, components: list[int]
) -> tuple[Inputs, np.ndarray]:
    """Inputs of runs (lanes), each shifted by its component, and the shift (K, W) of their first-order errors.

    Lanes beyond the components are shifted like the last one. The true values of sensor states do not change.
    """
    out = _shifted([tilt], inputs, components)
    return out, tilt.slopes.times(deviations(flight, out))


def _of_lane(tilts: Sequence[ProposalShifts], lane: int) -> ProposalShifts:
    """The shifts of a lane, of one each or one for all."""
    return tilts[lane % len(tilts)]


def _pushes(tilts: Sequence[ProposalShifts], components: list[int], lanes: int) -> np.ndarray:
    """(W, K) pushes of lanes by their components; further lanes repeat the last."""
    each = [*components, *[components[-1]] * (lanes - len(components))]
    return np.stack([_of_lane(tilts, lane).proposal.shifts[c] for lane, c in enumerate(each)])


def _shifted(tilts: Sequence[ProposalShifts], inputs: Inputs, components: list[int]) -> Inputs:
    """Inputs of runs, each shifted by its component."""
    pushes = _pushes(tilts, components, inputs.initial.shape[-1])

    def moved(values: np.ndarray, shifts: list[np.ndarray]) -> np.ndarray:
        if len(shifts) == 1:
            return values + np.ascontiguousarray(np.einsum("k...,wk->...w", shifts[0], pushes))
        return values + np.stack([np.tensordot(p, s, 1) for p, s in zip(pushes, shifts, strict=True)], axis=-1)

    each = [tilt.shifts for tilt in tilts]
    ranges, rates = [s.ranges for s in each], [s.rates for s in each]
    out = replace(
        inputs,
        initial=moved(inputs.initial, [s.initial for s in each]),
        dtheta=moved(inputs.dtheta, [s.dtheta for s in each]),
        dv=moved(inputs.dv, [s.dv for s in each]),
        aided=tuple(moved(a, [s.aided[k] for s in each]) for k, a in enumerate(inputs.aided)),
    )
    if (stated := inputs.stated) is not None:
        of_fixes = [np.concatenate(both, axis=2) for both in zip(ranges, rates, strict=True)]
        return replace(out, stated=stated._replace(error=moved(stated.error, of_fixes)))
    phases = None
    if inputs.phases is not None and each[0].phases is not None:
        phases = moved(inputs.phases, [s.phases for s in each if s.phases is not None])
    return replace(out, ranges=moved(inputs.ranges, ranges), rates=moved(inputs.rates, rates), phases=phases)
