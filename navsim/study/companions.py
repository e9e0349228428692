"""The companion papers' systems, each computed by one call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from navsim.io.results import Result
from navsim.study import atc, azimuth, elevation


class Compute(Protocol):
    """compute(scenario, seed, runs or None, done) -> result; `done(n)` is told how much is finished."""

    def __call__(self, scenario: Any, seed: int, runs: int | None, done: Callable[[int], None]) -> Result: ...


@dataclass(frozen=True)
class Companion:
    """A kind of scenario: how it is computed, how far its progress counts and of what, what --json prints."""

    compute: Compute
    extent: Callable[[Any], int]
    unit: str
    summary: tuple[str, ...]


COMPANIONS = {
    "mls-elevation": Companion(
        elevation.compute,
        lambda scenario: int(scenario.montecarlo.experiments),
        "experiments",
        ("/filter/steady", "/band_theory", "/montecarlo/fraction", "/nominal/worst", "/nominal/peak", "/audit"),
    ),
    "atc-tracking": Companion(atc.compute, atc.extent, "cases", ("/summary", "/limits")),
    "azimuth-tracking": Companion(azimuth.compute, azimuth.extent, "cases", ("/summary", "/map")),
}
"""By kind."""
