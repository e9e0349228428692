"""Rounded numbers as text."""

from __future__ import annotations

import math

_WRITTEN_OUT = 1e9
"""Size from which on numbers have a power of ten."""


def digits(value: float, count: int = 3) -> str:
    """Significant digits of a number as text: 1940, where Python's format `.3g` writes 1.94e+03."""
    return write_out(f"{value:.{count}g}")


def share_digits(percent: float) -> int:
    """Significant digits of a share, %, of which three remain of it or of its complement: 30.6, 99.9983."""
    smaller = min(percent, 100.0 - percent)
    if smaller <= 0.0:
        return 3
    return max(3, 3 + math.floor(math.log10(percent)) - math.floor(math.log10(smaller)))


def write_out(text: str) -> str:
    """Write a formatted number without a power of ten, unless it is huge."""
    if "e+" not in text or abs(float(text)) >= _WRITTEN_OUT:
        return text
    return f"{float(text):{'+' if text.startswith('+') else ''}.0f}"
