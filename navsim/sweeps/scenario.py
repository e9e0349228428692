"""`kind: sweep`: a study that varies keys of a base scenario."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.results.schema import (
    BEACON_QUANTITIES,
    DOP_QUANTITIES,
    FILTER_QUANTITIES,
    LEVEL_QUANTITIES,
    SWEEP_QUANTITIES,
    TOTAL_QUANTITIES,
    WATCHED_QUANTITIES,
)
from navsim.scenario_files.base import DistinctListOf, Dotted, ListOf, Section, Version, reject
from navsim.statistics.rounding import digits

DOP_OUTPUTS, FILTER_OUTPUTS, OUTPUTS = tuple(DOP_QUANTITIES), tuple(FILTER_QUANTITIES), tuple(SWEEP_QUANTITIES)
"""Outputs of every method; further ones of methods with a filter; all outputs."""
REQUIREMENTS = "requirements"
"""Output that adds a value and a verdict for each requirement of the base scenario."""
BEACON_OUTPUTS = tuple(BEACON_QUANTITIES)
"""Outputs of every method with beacons."""
LEVEL_OUTPUTS, WATCHED_OUTPUTS = tuple(LEVEL_QUANTITIES), tuple(WATCHED_QUANTITIES)
"""Outputs of every method with monitored fixes; further ones of runs with limits."""
TOTAL_OUTPUTS = tuple(TOTAL_QUANTITIES)
"""Outputs of runs that leave their route, and of where they end."""
MOST_VALUES = 100_000
"""Most values an axis may have, counted before they are made."""
MOST_COMBINATIONS = 100_000_000
"""Most combinations of a study."""
MOST_AXES = 31
"""Most axes: a variable of a result has up to 32 dimensions (HDF5, H5S_MAX_RANK), one of them for the sites."""

Value = Annotated[float, Field(ge=-1e12, le=1e12)]


class Grid(Section):
    """Evenly spaced values, both ends included."""

    first: Value
    """first value, in the unit of the key"""
    last: Value
    """last value, in the unit of the key"""
    count: Annotated[int, Field(ge=2, le=MOST_VALUES)]
    """number of values, both ends included"""

    def numbers(self) -> tuple[float, ...]:
        """The values."""
        step = (self.last - self.first) / (self.count - 1)
        return (*(self.first + i * step for i in range(self.count - 1)), self.last)


class Range(Section):
    """Values with a constant step, up to the last."""

    first: Value
    """first value, in the unit of the key"""
    last: Value
    """no value exceeds this, in the unit of the key"""
    step: Annotated[float, Field(ge=1e-12, le=1e12)]
    """difference of neighbouring values, in the unit of the key"""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.last < self.first:
            raise reject("must not lie below first", "last")
        steps = self._steps()
        if steps >= MOST_VALUES:
            raise reject(f"gives {digits(steps + 1.0, 4)} values; at most {MOST_VALUES} are allowed on an axis", "step")
        return self

    def _steps(self) -> float:
        return (self.last - self.first) / self.step + 1e-9

    @property
    def count(self) -> int:
        """Number of values."""
        return int(self._steps()) + 1

    def numbers(self) -> tuple[float, ...]:
        """The values."""
        return tuple(self.first + i * self.step for i in range(self.count))


class Interval(Section):
    """Interval of a Latin hypercube's samples."""

    first: Value
    """lower end, in the unit of the key"""
    last: Value
    """upper end, in the unit of the key"""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.last <= self.first:
            raise reject("must lie above first", "last")
        return self


class Vary(Section):
    """One axis of the study: a key with its values, or several keys that change together."""

    key: Dotted | None = None
    """dotted key of the base scenario, such as pseudolites.s_m"""
    keys: ListOf[Dotted] | None = None
    """keys that change together; `values` is then a list of lists"""
    values: ListOf[Any] | None = None
    """the values one by one; with `keys`, a list of lists"""
    grid: Grid | None = None
    """evenly spaced values by their number"""
    range: Range | None = None
    """evenly spaced values by their step"""
    lhs: Interval | None = None
    """a dimension of the study's Latin hypercube of `samples` points"""

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
        if (self.key is None) == (self.keys is None):
            raise reject("give either key or keys", "key")
        given = [name for name in ("values", "grid", "range", "lhs") if getattr(self, name) is not None]
        if len(given) != 1:
            raise reject("give exactly one of values, grid, range, lhs", given[1] if given else "values")
        if self.keys is not None:
            if self.values is None:
                raise reject("keys that change together need a list of lists here", "values")
            for i, row in enumerate(self.values):
                if not isinstance(row, list) or len(row) != len(self.keys):
                    raise reject(f"expected a list of {len(self.keys)} values, one a key", "values", i)
        if self.values is not None and not self.values:
            raise reject("an empty list", "values")
        if self.values is not None and len(self.values) > MOST_VALUES:
            raise reject(f"{len(self.values)} values; at most {MOST_VALUES} are allowed on an axis", "values")
        return self

    def names(self) -> tuple[str, ...]:
        """The keys of the axis."""
        return (self.key,) if self.key is not None else tuple(self.keys or ())


class Sweep(Section):
    """Every combination of the listed settings of a base scenario."""

    kind: Literal["sweep"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    base: str
    """scenario file, relative to this one"""
    set: dict[Dotted, Any] = Field(default_factory=dict)
    """settings of the base that stay the same: dotted keys and values"""
    vary: Annotated[ListOf[Vary], Field(min_length=1)]
    """axes of the study; every combination is computed"""
    method: Literal["dop", "covariance", "monte-carlo"] = "dop"
    """dop: geometry alone; covariance: linear covariance analysis; monte-carlo: runs"""
    # mypy knows no choice of names that are computed
    outputs: DistinctListOf[Literal[(*OUTPUTS, REQUIREMENTS)]] = ()  # type: ignore[valid-type]
    """outputs to store; default: all that the method gives of geometry and filter. To be named: those of the
    integrity monitor (hpl_p95 to hmi), of beacons (beacons_pdop to beacons_vdop_p50), of total system errors and ends
    of runs (lateral_total_touchdown to go_around). Also verdicts on the base scenario's requirements"""
    runs: Annotated[int, Field(ge=1, le=100_000_000)] = 100
    """Monte Carlo runs a combination"""
    samples: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """points of the Latin hypercube"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        seen: list[str] = []
        for i, axis in enumerate(self.vary):
            for name in axis.names():
                if name in seen or name in self.set:
                    raise reject(f"'{name}' is set twice", "vary", i)
                seen.append(name)
        sampled = [i for i, axis in enumerate(self.vary) if axis.lhs is not None]
        if sampled and self.samples is None:
            raise reject("a Latin hypercube needs its number of points here", "samples")
        if not sampled and self.samples is not None:
            raise reject("no axis has `lhs`", "samples")
        if len(self.shape) > MOST_AXES:
            raise reject(f"{len(self.shape)} axes; at most {MOST_AXES} are allowed", "vary")
        if self.combinations > MOST_COMBINATIONS:
            counts = " x ".join(map(str, self.shape))
            many = digits(self.combinations, 4) if self.combinations > 10**12 else str(self.combinations)
            raise reject(f"{many} combinations ({counts}); at most {MOST_COMBINATIONS} are allowed", "vary")
        if self.method == "dop":
            for i, name in enumerate(self.outputs):
                if name in FILTER_OUTPUTS:
                    raise reject(f"method dop flies no filter: '{name}' needs covariance or monte-carlo", "outputs", i)
        if self.method != "monte-carlo":
            for i, name in enumerate(self.outputs):
                if name in (*WATCHED_OUTPUTS, *TOTAL_OUTPUTS):
                    raise reject(f"'{name}' is of runs: it needs method monte-carlo", "outputs", i)
        return self

    @property
    def shape(self) -> tuple[int, ...]:
        """Points of each axis, counted without making them; those of a Latin hypercube are one axis."""
        counts: list[int] = []
        for i, axis in enumerate(self.vary):
            spread = axis.grid or axis.range
            if axis.lhs is None:
                counts.append(spread.count if spread is not None else len(axis.values or ()))
            elif all(earlier.lhs is None for earlier in self.vary[:i]):
                counts.append(self.samples or 0)
        return tuple(counts)

    @property
    def combinations(self) -> int:
        """Number of combinations."""
        return math.prod(self.shape)

    def wanted(self) -> tuple[str, ...]:
        """The outputs to store."""
        return self.outputs or (DOP_OUTPUTS if self.method == "dop" else (*DOP_OUTPUTS, *FILTER_OUTPUTS))
