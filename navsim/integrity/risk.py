"""Integrity risk of a monitor: probability that the position error exceeds a limit without an alarm.

Source: `docs/theory/integrity.md`, section 4. The estimate of a least-squares fix and its residuals are independent, so
the risk of one biased range under the chi-square test is a product.
"""

from __future__ import annotations

import numpy as np

from navsim.integrity.residuals import Monitor
from navsim.integrity.solution import MonitoredFix
from navsim.statistics import chi_square, normal


def silent(monitor: Monitor, epoch: int, source: int, bias: float, limit: float) -> float:
    """The probability of a vertical error beyond a limit, m, without an alarm, where a range has a bias, m."""
    solution = monitor.solution
    degrees = int(solution.degrees[epoch])
    threshold = float(monitor.test.threshold(solution.degrees)[epoch])
    seen = bias * bias * float(solution.visibility[epoch, source])
    beyond = _beyond(solution, epoch, source, bias, limit)
    return beyond * chi_square.probability_below(threshold, degrees, seen)


def _beyond(solution: MonitoredFix, epoch: int, source: int, bias: float, limit: float) -> float:
    """The probability of a vertical error beyond a limit, m, with a bias on a range."""
    moved = solution.estimator[epoch, 2, source] * bias
    sigma = float(np.sqrt(solution.covariance[epoch, 2, 2]))
    return float(normal.exceedance(np.array(limit), moved, sigma))
