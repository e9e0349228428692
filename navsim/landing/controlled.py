"""Control variates from the first-order errors of runs, as `/summary/controlled`.

For each run navsim computes the first-order error at the decision heights, at the box, and over the last seconds
(`simulation.first_order`). The covariance analysis gives its exact distribution. This is the control of
`runner.control_variates`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.filter import states
from navsim.landing.case import PERCENTILES, Case, crossing_times, rms_window
from navsim.landing.ensemble import FIRST_ORDER, between_outputs, outputs_around, percent, to_runway
from navsim.landing.error_box import box_of
from navsim.results.builder import ResultBuilder
from navsim.results.estimates import BRANCH
from navsim.results.findings import Finding
from navsim.results.schema import RUNWAY_AXES
from navsim.runner import control_variates
from navsim.runner.batches import Ensemble, Until
from navsim.runner.control_variates import LEAST_RUNS, NONE, Controlled
from navsim.runner.statistics import rms_interval
from navsim.simulation.landing_covariance import AnalysisError
from navsim.statistics import normal
from navsim.statistics.rounding import digits

_PARTS = {"horizontal": [0, 1], "vertical": [2]}
_HELPS = 2.0
"""Gain below which a finding says that first-order errors explain little of the errors."""


@dataclass(frozen=True)
class Controls:
    """The controlled estimates of an ensemble of a case with first-order errors."""

    case: Case
    ensemble: Ensemble

    def rms(self, part: str) -> Controlled:
        """The horizontal or vertical RMS error of position over the last seconds."""
        window, columns = rms_window(self.case), _PARTS[part]
        if not window.any() or self.case.first_order is None:
            return NONE
        mean = self.case.first_order.mean[window][:, columns]
        variance = np.diagonal(self.case.first_order_covariance[window], axis1=1, axis2=2)[:, columns]
        values, square, middle = (
            self.ensemble.per_run(name)[:, columns] for name in ("position_square", FIRST_ORDER, "first_order_mean")
        )
        controls = np.concatenate([square.sum(axis=1, keepdims=True), middle], axis=1)
        exact = np.array([np.mean(np.sum(variance + mean**2, axis=1)), *mean.mean(axis=0)])
        return control_variates.mean(values.sum(axis=1), controls, exact).root()

    def moments(self, times: list[float]) -> tuple[np.ndarray, np.ndarray]:
        """Exact means (h, 2, 3) and covariances (h, 2, 3, 3) of the first-order errors, lateral, along-track, vertical,
        at the outputs before and after times, s."""
        first_order, turn = self.case.first_order, to_runway(self.case)
        assert first_order is not None
        covariance = turn @ self.case.first_order_covariance @ turn.T
        mean = outputs_around(self.case, times, first_order.mean[:, states.SLICES["position"]] @ turn.T)
        flat = outputs_around(self.case, times, covariance.reshape(-1, 9))
        return mean, flat.reshape(*mean.shape, 3)

    def at_heights(self) -> list[list[OneError]]:
        """The errors at the decision heights, axis by axis."""
        times = crossing_times(self.case)
        mean, covariance = self.moments(times)
        sigma = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3))
        late = between_outputs(self.case, np.where(np.isnan(times), 0.0, times))[2]
        errors, linear = (self.ensemble.per_run(name) for name in ("at_height", "first_order_at_height"))
        return [
            [OneError(errors[:, h, i], linear[:, h, :, i], mean[h, :, i], sigma[h, :, i], float(late[h]))
             for h in range(len(times))]
            for i in range(3)
        ]  # fmt: skip

    def outside(self) -> Controlled:
        """The probability to end outside the box, where it limits navigation errors."""
        box = box_of(self.case)
        if box is None or box.total:
            return NONE
        at = round(float(between_outputs(self.case, np.array([box.time]))[2][0]))
        mean, covariance = (each[0, at] for each in self.moments([box.time]))
        errors, linear = self.ensemble.per_run("at_box")[:, 0], self.ensemble.per_run("first_order_at_box")[:, 0, at]
        inside = normal.inside_box(box.lower, box.upper, mean, covariance)
        outside, expected = (np.asarray(box.beyond(each).any(axis=1)) for each in (errors, linear))
        return control_variates.share(outside, expected, 1.0 - inside)


@dataclass(frozen=True)
class OneError:
    """An error of runs (run,), m, at a time between two outputs. linear: (run, 2) the same to first order at these;
    means, sigmas: (2,) exact, of those; late: share of the way to the second output.

    The error is interpolated between the outputs. The variance of an interpolated first-order error is not known
    without the correlation of both. The interpolated square has a known mean, and differs from the square of what is
    interpolated by the square of a small change. An indicator takes the output that is nearer.
    """

    errors: np.ndarray
    linear: np.ndarray
    means: np.ndarray
    sigmas: np.ndarray
    late: float

    def between(self, at_outputs: np.ndarray) -> np.ndarray:
        """Values (..., 2) at the outputs, interpolated."""
        return np.asarray((1.0 - self.late) * at_outputs[..., 0] + self.late * at_outputs[..., 1])

    def exact_rms(self) -> float:
        """The root mean square of the first-order error."""
        return math.sqrt(self.between(self.means**2 + self.sigmas**2))

    def mean(self) -> Controlled:
        """Its mean."""
        return control_variates.mean(self.errors, self.between(self.linear)[:, None], self.between(self.means)[None])

    def rms(self) -> Controlled:
        """Its root mean square."""
        controls = np.stack([self.between(self.linear), self.between(self.linear**2)], axis=1)
        exact = np.array([self.between(self.means), self.exact_rms() ** 2])
        return control_variates.mean(self.errors**2, controls, exact).root()

    def percentile(self, level: float) -> Controlled:
        """A percentile of its size; level: 0 to 1."""
        if not np.isfinite(self.errors).all():
            return NONE
        return control_variates.percentile(np.abs(self.errors), self._sizes, level, self._below)

    def share_below(self, size: float) -> Controlled:
        """The probability of a smaller size."""
        return control_variates.share(np.abs(self.errors) < size, self._sizes < size, self._below(size))

    @property
    def _sizes(self) -> np.ndarray:
        return np.abs(self.linear[:, round(self.late)])

    def _below(self, size: float) -> float:
        mean, sigma = (float(each[round(self.late)]) for each in (self.means, self.sigmas))
        return 1.0 - float(normal.exceedance(np.array(size), mean, sigma)) if sigma > 0.0 else math.nan


def controls_of(case: Case, ensemble: Ensemble) -> Controls | None:
    """Controlled estimates of an ensemble; None where its runs have no first-order error, or are too few."""
    if ensemble.runs < LEAST_RUNS or FIRST_ORDER not in ensemble.columns() or why_none(case):
        return None
    return Controls(case, ensemble)


def why_none(case: Case) -> str:
    """Why a case has no controlled estimates, in words; "" where it has some."""
    if case.first_order is None:
        return case.why_not_linear
    try:
        finite = np.isfinite(case.first_order_covariance).all()
    except AnalysisError as error:
        return str(error)
    return "" if finite else "the covariance analysis is not finite"


def put_controlled(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write `/summary/controlled`."""
    if ensemble.runs < LEAST_RUNS:
        return
    controls = controls_of(case, ensemble)
    if controls is None:
        draft[f"{BRANCH}/why_none"] = why_none(case) or "the runs were flown without their first-order errors"
        return
    for part in _PARTS:
        _put(draft, f"rms/{part}", controls.rms(part))
    draft[f"{BRANCH}/at/height"] = draft["/summary/at/height"]
    for axis, errors in zip(RUNWAY_AXES, controls.at_heights(), strict=True):
        draft[f"{BRANCH}/at/{axis}_run"] = np.stack([one.between(one.linear) for one in errors], axis=1)
        draft[f"{BRANCH}/at/{axis}_exact"] = np.array([one.exact_rms() for one in errors])
        _put(draft, f"at/{axis}", *(one.rms() for one in errors))
        _put(draft, f"at/{axis}_mean", *(one.mean() for one in errors))
        every = [[one.percentile(level / 100.0) for level in PERCENTILES] for one in errors]
        draft[f"{BRANCH}/at/{axis}_percentile"] = np.array([[each.value for each in row] for row in every])
        draft[f"{BRANCH}/at/{axis}_percentile_gain"] = np.array([[each.gain for each in row] for row in every])
    if (box := box_of(case)) is not None and not box.total:
        _put(draft, "box/probability", controls.outside())


def _put(draft: ResultBuilder, name: str, *found: Controlled) -> None:
    """Write estimates with their gains, of all heights or a single one."""
    values, gains = np.stack([one.value for one in found]), np.array([one.gain for one in found])
    several = name.startswith("at/")
    draft[f"{BRANCH}/{name}"] = values if several else values[0]
    draft[f"{BRANCH}/{name}_gain"] = gains if several else gains[0]


def far_from_first_order(case: Case, ensemble: Ensemble) -> list[Finding]:
    """Findings about errors that the first-order errors hardly explain."""
    controls = controls_of(case, ensemble)
    if controls is None:
        return []
    found = {f"{part} RMS": controls.rms(part) for part in _PARTS}
    little = [f"{name} {one.correlation:.2f}" for name, one in found.items() if one.gain < _HELPS]
    if not little:
        return []
    text = f"the errors are far from first order (correlation with the first-order error: {', '.join(little)})"
    return [Finding("far_from_first_order", f"{text}: a covariance analysis is not valid for this flight")]


_UNTIL = re.compile(r"\s*(rms_horizontal|rms_vertical)\s+within\s+([0-9.]+)\s*%\s*")


def stopping_rule(case: Callable[[], Case], expression: str) -> Until:
    """`rms_horizontal within 2%`: true once the 95 % interval reaches no further than that from its value, the
    controlled one where it is the narrower. case: known once runs are.

    Raises ValueError for anything else.
    """
    match = _UNTIL.fullmatch(expression)
    if match is None:
        rare = "; a probability goes with --method rare" if "probability" in expression else ""
        form = "`rms_horizontal within 2%` or `rms_vertical within 2%`"
        raise ValueError(f"{expression!r}: expected {form}{rare}")
    share = percent(match.group(2), expression, 0.001, 1000.0)
    name = match.group(1)
    part = name.removeprefix("rms_")

    def judge(ensemble: Ensemble) -> tuple[bool, str]:
        value, low, high = rms_interval(ensemble.per_run("position_square")[:, _PARTS[part]])
        controls = controls_of(case(), ensemble)
        if controls is not None and (better := controls.rms(part)).helps:
            value, low, high = better.value
        within = 0.0 if value == 0.0 else 0.5 * (high - low) / value  # errors of 0 are known exactly
        return bool(within <= share), f"{name} {digits(value)} m within {digits(100.0 * within, 2)}%"

    return Until(judge)
