"""Rounded numbers as text."""

from __future__ import annotations

import math

_WRITTEN_OUT = 1e9
"""Size from which on numbers have a power of ten."""
_MOST_DIGITS = 6
"""Significant digits of a share beyond which it counts as the required one."""


def digits(value: float, count: int = 3) -> str:
    """Significant digits of a number as text: 1940, where Python's format `.3g` writes 1.94e+03."""
    return write_out(f"{value:.{count}g}")


def value_text(value: float, sigma: float) -> str:
    """A number to the first digit of its 1 sigma, > 0: -0.40 for -0.402 with 0.04, 270 for 271 with 90."""
    last = math.floor(math.log10(float(f"{sigma:.1g}")))
    return f"{round(value, -last) + 0.0:.{max(-last, 0)}f}"


def share_text(percent: float, required: float) -> str:
    """A share, %, as text: three significant digits, or two of its complement: 30.6, 99.83.

    A tenth of what `required`, %, leaves free, at most 0.01 %, is the smallest share or complement that is shown, since
    no model is true so far out: > 99.99. A share that is not the required one has the digits that tell them apart.
    """
    smaller, least = min(percent, 100.0 - percent), min(required, 100.0 - required, 0.1) / 10.0
    if smaller <= 0.0:
        return f"{percent:g}"
    if smaller < least:
        return f"< {least:.3g}" if percent < 50.0 else f"> {100.0 - float(f'{least:.3g}'):.10g}"
    kept = max(3, 2 + math.floor(math.log10(percent)) - math.floor(math.log10(smaller)))
    while float(text := f"{percent:.{kept}g}") == required != percent and kept < _MOST_DIGITS:
        kept += 1
    return text


def write_out(text: str) -> str:
    """Write a formatted number without a power of ten, unless it is huge."""
    if "e+" not in text or abs(float(text)) >= _WRITTEN_OUT:
        return text
    return f"{float(text):{'+' if text.startswith('+') else ''}.0f}"
