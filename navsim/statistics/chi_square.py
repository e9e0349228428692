"""The chi-square distribution, central and not."""

from __future__ import annotations

import math


def quantile(probability: float, degrees: float) -> float:
    """Quantile of the chi-square distribution. Uses only scipy.special, since scipy.stats takes half a second to
    import."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(0.5 * degrees, probability))


def exceeded(probability: float, degrees: float) -> float:
    """The value that is exceeded with this small probability; inf for 0."""
    from scipy.special import gammainccinv

    return float(2.0 * gammainccinv(0.5 * degrees, probability)) if probability > 0.0 else math.inf


def probability_below(value: float, degrees: float, noncentrality: float = 0.0) -> float:
    """The probability of less than a value, of the noncentrality given."""
    from scipy.special import chndtr, gammainc

    if noncentrality == 0.0:
        return float(gammainc(0.5 * degrees, 0.5 * value))
    return float(chndtr(value, degrees, noncentrality))


def noncentrality(value: float, degrees: float, probability: float) -> float:
    """The noncentrality with which a variable is below a value with this probability.

    Raises ValueError where even that of 0 is below it with less.
    """
    from scipy.optimize import brentq

    if probability_below(value, degrees) < probability:
        raise ValueError(f"a chi-square of {degrees} degrees is below {value:g} with less than {probability:g}")
    # by the root, which is a bias in sigmas: the probability falls with it like a normal tail
    root: float = brentq(
        lambda bias: math.log(probability_below(value, degrees, bias * bias) / probability),
        0.0, _beyond(value, degrees, probability), xtol=1e-12,
    )  # fmt: skip
    return root * root


def _beyond(value: float, degrees: float, probability: float) -> float:
    """A bias that is enough, in sigmas."""
    bias = math.sqrt(value) + 1.0
    while probability_below(value, degrees, bias * bias) > probability:
        bias += 1.0
    return bias
