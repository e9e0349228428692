"""The box that landings are to end in: how often they do not, counted or to first order, as `/summary/box`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.landing.case import Case
from navsim.results.builder import ResultBuilder
from navsim.runner.statistics import share_interval
from navsim.statistics import normal

AXES = ("lateral", "along", "vertical")
"""The errors that a box may limit."""


@dataclass(frozen=True)
class ErrorBox:
    """Limits of position errors at a height."""

    height: float
    """Above the runway, m."""
    time: float
    """When the route passes it, s."""
    lower: np.ndarray
    """(3,) least lateral, along-track and vertical error, m, infinite for none."""
    upper: np.ndarray
    """(3,) largest error, likewise."""
    total: bool
    """Limits apply to total system errors, or to touchdowns."""
    place: float
    """Position of the route then, along the runway from the threshold, m, if limits are relative to it, else nan."""

    def beyond(self, errors: np.ndarray) -> np.ndarray:
        """Which errors (..., 3) exceed their limits; those that are no numbers do."""
        return np.logical_not((self.lower <= errors) & (errors <= self.upper))


def box_of(case: Case) -> ErrorBox | None:
    """The box of a case, if it has one."""
    section = case.scenario.box
    if section is None:
        return None
    place = case.preflight.box_place
    lower, upper = map(np.array, section.limits(place))
    return ErrorBox(
        section.height_m, case.preflight.box_time, lower, upper, section.error != "navigation",
        math.nan if section.from_threshold_m is None else place,
    )  # fmt: skip


def write_box(draft: ResultBuilder, box: ErrorBox) -> None:
    """Write the definition of the box."""
    if "/axis" not in draft:
        draft["/summary/box/axis"] = np.array(AXES)
    draft["/summary/box/height"] = box.height
    draft["/summary/box/time"] = box.time
    draft["/summary/box/lower"], draft["/summary/box/upper"] = box.lower, box.upper
    if not math.isnan(box.place):
        draft["/summary/box/place"] = box.place


def write_box_counts(draft: ResultBuilder, box: ErrorBox, errors: np.ndarray, gone: np.ndarray) -> None:
    """The box, and how many errors (run, 3) are outside; runs that have gone around (run,) end nowhere."""
    write_box(draft, box)
    outside = box.beyond(errors) & ~gone[:, None]
    draft["/summary/box/error_run"] = errors
    draft["/summary/box/outside"] = np.int64(outside.any(axis=1).sum())
    draft["/summary/box/probability"] = share_interval(int(outside.any(axis=1).sum()), errors.shape[0])
    of_axes = [share_interval(int(one.sum()), errors.shape[0]) for one in outside.T]
    draft["/summary/box/axis_probability"] = where_limited(box, np.stack(of_axes))
    if box.total:
        chances = np.full(3, np.nan)  # one run has no sigma
        ended = errors[~gone]
        if ended.shape[0] > 1:
            chances = normal.outside(box.lower, box.upper, ended.mean(axis=0), ended.std(axis=0, ddof=1))
        draft["/summary/box/axis_gaussian"] = where_limited(box, chances)


def write_first_order_box(draft: ResultBuilder, box: ErrorBox, mean: np.ndarray, sigma: np.ndarray) -> None:
    """The box, and how often Gaussian errors with these means and sigmas (3,), m, are outside."""
    write_box(draft, box)
    draft["/summary/box/axis_mean"] = mean
    draft["/summary/box/axis_sigma"] = sigma
    draft["/summary/box/axis_first_order"] = where_limited(box, normal.outside(box.lower, box.upper, mean, sigma))


def where_limited(box: ErrorBox, values: np.ndarray) -> np.ndarray:
    """Values of the axes (3, ...), nan of those without a limit."""
    out = values.copy()
    out[~np.isfinite(box.upper)] = np.nan
    return out
