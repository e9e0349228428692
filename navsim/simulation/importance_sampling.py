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
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.simulation.dispersed_trajectory import Dispersion
from navsim.simulation.flight import Flight
from navsim.simulation.landing import Inputs, draw
from navsim.simulation.sensitivity import Slopes, by_scale, carried, deviations, of_aid
from navsim.statistics.random_streams import generator
from navsim.trajectory.dispersion import PathDeviation

_FULL, _HALF = 0.8, 0.1
"""Shares of the runs that are shifted to a face, and halfway; the rest is not shifted."""
_EVENLY = 0.5
"""Share of the pushes that goes to all faces alike; the rest goes by their probabilities to first order."""
_MOST_EXPONENT = 700.0
"""Largest exponent of a number."""
_STEPS = 1001
"""Places between two faces at which weights are looked at."""


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

    @classmethod
    def of(cls, ways: Dispersion, weights: np.ndarray) -> AirShifts:
        """Those of errors that are sums of positions with weights (K, k, 3)."""
        air, (count, samples) = ways.disturbance, weights.shape[:2]
        sizes = {number: walk.start.shape[0] for number, walk in air.walks.items()}
        at_rest = air.at_rest.way[:, :3]
        walks, covariance = {}, np.zeros((count, count))
        for number, n in sizes.items():
            unit = {other: np.zeros((samples, m, n)) for other, m in sizes.items()}
            unit[number] += np.eye(n)
            rows = np.einsum("Kta,tan->Ktn", weights, air.of_states(unit, n).way[:, :3] - at_rest)
            walks[number] = air.walks[number].carried(rows)
            covariance += np.einsum("itn,jtn->ij", rows, walks[number])
        return cls(weights, walks, covariance, np.einsum("Kta,taw->K", weights, at_rest))

    def off(self, departure: PathDeviation) -> np.ndarray:
        """Errors (K, W) off their mean of runs that nothing else takes off the route."""
        return np.einsum("Kta,taw->Kw", self.weights, departure.way[:, :3]) - self.mean[:, None]


def proposal_shifts(
    flight: Flight, slopes: Slopes, mean: np.ndarray, lower: np.ndarray, upper: np.ndarray, air: AirShifts | None = None
) -> ProposalShifts:
    """The pushes for a box; slopes: of the K errors that it bounds; mean, lower, upper: see `proposal`, which raises
    ValueError; air: see `ProposalShifts`."""
    shifts = carried(flight, slopes)
    pairs = zip(slopes.members(), shifts.members(), strict=True)
    parts = [np.einsum("ki,li->kl", *(m.reshape(m.shape[0], -1) for m in pair)) for pair in pairs]
    covariance = np.sum(parts, axis=0)
    if air is not None:
        covariance = covariance + air.covariance
    return ProposalShifts(slopes, shifts, mean, proposal(mean, 0.5 * (covariance + covariance.T), lower, upper), air)


@dataclass(frozen=True)
class PushedRuns:
    """Pushes of runs that leave the route: what is drawn shifts, whatever trajectory it leads to
    (`landing.Pushes`)."""

    flight: Flight
    tilt: ProposalShifts
    seed: int
    kept: dict[tuple[int, ...], dict[int, np.ndarray]] = field(default_factory=dict)
    """`walks` of runs that have flown: the same runs fly several times."""

    def inputs(self, runs: Sequence[int], inputs: Inputs) -> Inputs:
        """Inputs of runs, shifted."""
        out = _shifted(self.tilt, inputs, self.components(runs))
        ways, flown = self.flight.shared.dispersion, inputs.flown
        if ways is None or flown is None:
            return out
        # errors that depend on the trajectory are those of the run's own
        shared, slopes, pushes = self.flight.shared, self.tilt.slopes, self._each(runs)
        increments = [
            lanes + (own - exact[..., None]) * (triad.scale**2 * pushes @ by_scale(by, exact)).T
            for triad, lanes, own, exact, by in (
                (self.flight.gyro, out.dtheta, flown.dtheta, shared.dtheta, slopes.dtheta),
                (self.flight.accel, out.dv, flown.dv, shared.dv, slopes.dv),
            )
        ]
        aided = tuple(lanes.copy() for lanes in inputs.aided)
        for aid, lanes, exact, by in zip(shared.aids, aided, inputs.aided_exact, slopes.aided, strict=True):
            for lane, push in enumerate(pushes):
                way = ways.of_run(flown, lane)
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
        """The component of each run."""
        return [self.tilt.proposal.drawn(self.seed, run) for run in runs]

    def off(self, runs: Sequence[int]) -> np.ndarray:
        """Errors (K, W) of runs to first order, off their means: sums over all that they draw, with its shift."""
        along, ways = self.flight.along_route, self.flight.shared.dispersion
        assert self.tilt.air is not None
        assert ways is not None
        _, off = shift_inputs(along, self.tilt, draw(along, self.seed, runs), self.components(runs))
        return off + self.tilt.air.off(ways.departure(self.seed, runs, WIDTH, shift=self.walks(runs)))

    def _each(self, runs: Sequence[int]) -> np.ndarray:
        """(W, K) pushes of runs; further lanes repeat the last."""
        own = self.components(runs)
        return self.tilt.proposal.shifts[[*own, *[own[-1]] * (WIDTH - len(own))]]


def shift_inputs(
    flight: Flight, tilt: ProposalShifts, inputs: Inputs, components: list[int]
) -> tuple[Inputs, np.ndarray]:
    """Inputs of runs (lanes), each shifted by its component, and the shift (K, W) of their first-order errors.

    Lanes beyond the components are shifted like the last one. The true values of sensor states do not change.
    """
    out = _shifted(tilt, inputs, components)
    return out, tilt.slopes.times(deviations(flight, out))


def _shifted(tilt: ProposalShifts, inputs: Inputs, components: list[int]) -> Inputs:
    """Inputs of runs, each shifted by its component."""
    lanes = inputs.initial.shape[-1]
    each = np.array([*components, *[components[-1]] * (lanes - len(components))])
    pushes = tilt.proposal.shifts[each]

    def moved(values: np.ndarray, shift: np.ndarray) -> np.ndarray:
        return values + np.ascontiguousarray(np.einsum("k...,wk->...w", shift, pushes))

    shifts = tilt.shifts
    phases = None
    if inputs.phases is not None and shifts.phases is not None:
        phases = moved(inputs.phases, shifts.phases)
    return replace(
        inputs,
        initial=moved(inputs.initial, shifts.initial),
        dtheta=moved(inputs.dtheta, shifts.dtheta),
        dv=moved(inputs.dv, shifts.dv),
        ranges=moved(inputs.ranges, shifts.ranges),
        rates=moved(inputs.rates, shifts.rates),
        phases=phases,
        aided=tuple(moved(a, s) for a, s in zip(inputs.aided, shifts.aided, strict=True)),
    )
