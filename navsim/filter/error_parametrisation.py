"""Error parametrisations ("charts") of the filters: the coordinates in which each kind takes the error as Gaussian.

A chart defines the correction of estimate and covariance (`correct`), the error that NEES uses
(`error_in_filter_coordinates`), and the effect of a turn on its axes (`rotate_bias_frame`). See `error_state`,
`invariant`, `tfg`. A chart is a type to kernels, so only the one in use is compiled.

Charts of Lie groups rotate position and velocity errors with attitude errors, except if they are `straight`:

- 1: positions do not rotate. A filter that estimates time-correlated errors of fixes or ranges knows the sum of
  position
  and error better than the position. A rotation of the position alone would spoil the sum.
- 2: velocities do not rotate either. Otherwise a velocity correction due to noise would count as information about
  heading (`steady_force`). `left-invariant` keeps its chart, since it would equal `eskf` otherwise.

`products` is the first state of the products of the position error (`error_products`), 0 without.

Source: `docs/theory/filter.md`, sections 4 to 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import in_kernels
from navsim.compiler.linear import copy
from navsim.filter import eskf, left_invariant, tfg
from navsim.filter.magnetometer_measurements import hard_iron
from navsim.filter.measurement_kinds import AZIMUTH, BEACON, DISTANCE, ELEVATION, FIX, PRODUCT, RANGE, SOURCE
from navsim.filter.records import CONSTRAINED, ESKF, GAUSSIAN_SUM, LEFT_INVARIANT, TFG, FilterModel
from navsim.filter.states import SENSORS


class Eskf(NamedTuple):
    """Chart of `kind: eskf`, and of kinds that differ from it only in the transition (`first_estimates`)."""

    kind: int = ESKF
    straight: int = 0
    body: int = 0
    products: int = 0


class LeftInvariant(NamedTuple):
    """Chart of `kind: left-invariant`."""

    kind: int = LEFT_INVARIANT
    straight: int = 0
    body: int = 0
    products: int = 0


class Tfg(NamedTuple):
    """Chart of `kind: tfg`."""

    kind: int = TFG
    straight: int = 0
    body: int = 0
    products: int = 0


class GaussianSum(NamedTuple):
    """Chart of `kind: gaussian-sum` and of its components: that of `tfg` without held axes."""

    kind: int = GAUSSIAN_SUM
    straight: int = 0
    body: int = 0
    products: int = 0


CHARTS: dict[int, Eskf | LeftInvariant | Tfg | GaussianSum] = {
    ESKF: Eskf(),
    **{kind: Eskf(kind) for kind in CONSTRAINED},
    LEFT_INVARIANT: LeftInvariant(),
    TFG: Tfg(),
    GAUSSIAN_SUM: GaussianSum(),
}
"""Charts of `records.FILTERS`."""
PLAIN = CHARTS[ESKF]
"""Chart of plain errors, in which all kinds predict."""


def chart_of(model: FilterModel) -> Eskf | LeftInvariant | Tfg | GaussianSum:
    """Chart of a filter."""
    plain = model.steady_force and model.kind in (TFG, GAUSSIAN_SUM)
    summed, triad = (FIX, RANGE, SOURCE, BEACON, PRODUCT, AZIMUTH, ELEVATION, DISTANCE), model.declared["sensor"]
    straight = 2 if plain else int(np.isin(triad, summed).any())
    products = SENSORS + int(np.argmax(triad == PRODUCT)) if (triad == PRODUCT).any() else 0
    return CHARTS[model.kind]._replace(straight=straight, body=int(hard_iron(model.declared)), products=products)


def rotate_bias_frame(chart, nav, p, increments, dt):
    """Rotate the axes that a chart keeps, if any: see `tfg.freeze_bias_frame`."""
    raise NotImplementedError("rotate_bias_frame is for kernels")


@in_kernels(rotate_bias_frame)
def _rotate_bias_frame(chart, nav, p, increments, dt):
    if chart.instance_class is Tfg:
        return lambda chart, nav, p, increments, dt: tfg.freeze_bias_frame(nav, p, increments, dt)
    return lambda chart, nav, p, increments, dt: None


def correct(chart, nav, p, x, space):
    """Apply the estimated errors x (n,) and transform P (n, n) to the new estimate, in the chart. space: `workshop`."""
    raise NotImplementedError("correct is for kernels")


@in_kernels(correct)
def _correct(chart, nav, p, x, space):
    if chart.instance_class is Eskf:
        return lambda chart, nav, p, x, space: eskf.correct(nav, p, x, space)
    if chart.instance_class is LeftInvariant:
        return lambda chart, nav, p, x, space: left_invariant.correct(nav, p, x, space)
    return lambda chart, nav, p, x, space: tfg.correct(nav, p, x, space)


def feed_back(chart, nav, x, space):
    """`correct` of the estimate alone, nav (NAV,), in place."""
    raise NotImplementedError("feed_back is for kernels")


@in_kernels(feed_back)
def _feed_back(chart, nav, x, space):
    if chart.instance_class is Eskf:
        return lambda chart, nav, x, space: eskf.inject(nav, x)
    if chart.instance_class is LeftInvariant:
        return lambda chart, nav, x, space: left_invariant.feed_back(nav, x, space)
    return lambda chart, nav, x, space: tfg.feed_back(nav, x, space)


def error_in_filter_coordinates(chart, nav, error, out):
    """The plain error (n,) in the coordinates of the chart, out (n,)."""
    raise NotImplementedError("error_in_filter_coordinates is for kernels")


@in_kernels(error_in_filter_coordinates)
def _error_in_filter_coordinates(chart, nav, error, out):
    if chart.instance_class is Eskf:
        return lambda chart, nav, error, out: copy(error, out)
    if chart.instance_class is LeftInvariant:
        return lambda chart, nav, error, out: left_invariant.error_in_filter_coordinates(error, out, chart.straight)
    return lambda chart, nav, error, out: tfg.error_in_filter_coordinates(nav, error, out, chart.straight, chart.body)


def error_of_output(chart, nav, error, out):
    """`error_in_filter_coordinates` of an output: a sum has the covariance of plain positions and velocities."""
    raise NotImplementedError("error_of_output is for kernels")


@in_kernels(error_of_output)
def _error_of_output(chart, nav, error, out):
    if chart.instance_class is GaussianSum:
        return lambda chart, nav, error, out: tfg.error_in_filter_coordinates(nav, error, out, 2, chart.body)
    return lambda chart, nav, error, out: error_in_filter_coordinates(chart, nav, error, out)
