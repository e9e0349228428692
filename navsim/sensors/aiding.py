"""Declaration of a sensor that aids the filter beside the receiver.

A sensor is one class: its name, its numbers and their unit, how they are simulated, its time-correlated errors, and
what the filter makes of them. Events, updates, smoother, covariance analysis, error budget, rare events, result file
and tables take it from there. Only the linearisation stands elsewhere, as a kernel (`filter.measurement_models`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from navsim.filter.states import Block
from navsim.gnss.pseudolite_clock import WanderingClocks
from navsim.statistics.random_streams import branch
from navsim.trajectory.kinematics import Frame, Moving


@dataclass(frozen=True)
class SensorError:
    """A time-correlated error of a sensor: `AidingSensor.components` independent stationary Gauss-Markov processes."""

    name: str
    """Name in the error budget, after that of the sensor. Errors of one name are one source."""
    sigma: float
    """1 sigma."""
    time: float
    """Correlation time, s; inf: constant in each run."""


def estimated(errors: Sequence[SensorError]) -> tuple[int, ...]:
    """Places of the errors of a filter model that have a state: those whose sigma is not 0."""
    return tuple(k for k, error in enumerate(errors) if error.sigma > 0.0)


class AidingSensor(ABC):
    """A sensor beside the receiver."""

    name: ClassVar[str]
    """Name of its section in scenarios and of its group in results. Its states begin with the first word of it."""
    kind: ClassVar[int]
    """Kind of its measurements (`filter.measurement_kinds`)."""
    numbers: ClassVar[tuple[str, ...]]
    """Name of each number of a measurement."""
    unit: ClassVar[str]
    """Unit of the numbers."""
    components: ClassVar[int] = 1
    """Components of each time-correlated error."""
    sources: int = 0
    """Number of transmitters whose rejections by the gate are counted apart; 0: it has none."""

    @property
    def transmitters(self) -> int:
        """Number of transmitters on the ground that a monitor of the filter can exclude."""
        return self.sources

    def transmitter_at(self, time: np.ndarray) -> np.ndarray:
        """Which of them each measurement at times (m,), s, is of."""
        return np.zeros(time.size, np.int64)

    rate: float
    """Hz."""
    latency: float
    """s."""

    varies: ClassVar[bool] = False
    """Whether a run may lack measurements that the route has: answers are lost, or it leaves the coverage."""
    clock: WanderingClocks | None = None
    """Clock of its receiver, whose offset is in each number; None without. Its constant offset is the last of `errors`
    beside."""
    has_outliers: bool = False
    """Whether its truth has outliers, which make its innovations larger than the filter expects."""

    @abstractmethod
    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Measurements (m, k) without errors that are drawn, at times (m,), s; nan where it measures nothing."""

    def on_route(self, flight: Moving, time: np.ndarray) -> AidingSensor:
        """The sensor with what it knows of the quality of its measurements along a flight, at times (m,), s."""
        return self

    @abstractmethod
    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, k) of the white noise of measurements (m, k)."""

    @abstractmethod
    def table(self, frame: Frame, measured: np.ndarray) -> Any:
        """Table of its kind from measurements (m, k), or (m, k, W) in lanes."""

    @property
    @abstractmethod
    def is_true_model(self) -> bool:
        """Whether the filter model equals the sensor."""

    @property
    def design_latency(self) -> float:
        """Age of a measurement on arrival in the filter model, s."""
        return 0.0

    @property
    def state_scale(self) -> float:
        """A state of the filter is this factor times the error that it stands for."""
        return 1.0

    @property
    def slope(self) -> np.ndarray:
        """Derivatives (k, k) of the innovation by the numbers."""
        return np.eye(len(self.numbers))

    @property
    def errors(self) -> tuple[SensorError, ...]:
        """Time-correlated errors."""
        return ()

    def effects(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Derivatives (m, k, c) of the numbers by the components of each error, at times (m,), s."""
        return ()

    @property
    def mean_errors(self) -> np.ndarray:
        """Mean of each error (j,); `noise_free` includes it."""
        return np.zeros(len(self.errors))

    def drawn_errors(self, time: np.ndarray, draw: np.random.Generator) -> list[np.ndarray]:
        """Each error (c, m) of a run, without its mean, at ascending times (m,), s. Each has its own random numbers."""
        out = []
        for k, error in enumerate(self.errors):
            own = branch(draw, 1 + k)
            out.append(np.stack([drawn_process(time, error.sigma, error.time, own) for _ in range(self.components)]))
        return out

    def errors_between(
        self, at: np.ndarray, time: np.ndarray, drawn: Sequence[np.ndarray], draw: np.random.Generator
    ) -> list[np.ndarray]:
        """Each error (c, o) of a run at other times (o,), s, given those (c, m) at its measurements (m,), s."""
        return [
            np.stack([between(at, time, one, error.sigma, error.time, draw) for one in of_error])
            for error, of_error in zip(self.errors, drawn, strict=True)
        ]

    def drawn_clock(self, time: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Offset, m, and rate, m/s, of its clock (2, m) in a run at times (m,), s, without the constant offset."""
        assert self.clock is not None
        return np.asarray(self.clock.drawn(time, [self._of_clock(draw)])[:, :, 0, 0])

    def clock_between(self, at: np.ndarray, time: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """The same at other times (o,), s."""
        assert self.clock is not None
        known = self.drawn_clock(time, draw)[..., None]
        return np.asarray(self.clock.drawn_between(at, time, known, self._of_clock(draw))[..., 0])

    def _of_clock(self, draw: np.random.Generator) -> np.random.Generator:
        return branch(draw, 2 + len(self.errors))

    def spoiled(self, measured: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Measurements (m, k) of a run with what is no Gaussian error: outliers, nan where one is lost."""
        return measured

    @property
    def followed(self) -> tuple[int, ...]:
        """Errors that the filter estimates, as places in `errors`, in the order of its states; the rate of a clock
        comes behind them."""
        return ()

    def states(self, step: float) -> tuple[tuple[Block, float], ...]:
        """States for these errors, `components` for each, and their initial 1 sigma; step: of the filter, s."""
        return ()


def drawn_process(time: np.ndarray, sigma: float, correlation: float, draw: np.random.Generator) -> np.ndarray:
    """A stationary Gauss-Markov process (m,) of a run at ascending times (m,), s."""
    if math.isinf(correlation):
        return np.full(time.size, sigma * draw.standard_normal())
    new = (sigma * draw.standard_normal(time.size)).tolist()
    out = new[:1]
    for (kept, added), one in zip(_steps(time.tobytes(), correlation), new[1:], strict=True):
        out.append(kept * out[-1] + added * one)
    return np.array(out)


@lru_cache(maxsize=16)
def _steps(time: bytes, correlation: float) -> list[tuple[float, float]]:
    """What a process keeps of its value over each step between times, s, and what its noise of 1 sigma adds."""
    kept = np.exp(-np.diff(np.frombuffer(time)) / correlation)
    return [(float(share), float(np.sqrt(1.0 - share**2))) for share in kept]


def between(
    at: np.ndarray, time: np.ndarray, value: np.ndarray, sigma: float, correlation: float, draw: np.random.Generator
) -> np.ndarray:
    """The process of `drawn_process` at other ascending times (o,), s, given its values (m,) at times (m,), s."""
    if math.isinf(correlation):
        return np.full(at.size, value[0])
    values, out, last = [*value.tolist(), 0.0], [], 0.0
    weights = _weights(at.tobytes(), time.tobytes(), correlation)
    normals = iter(draw.standard_normal(sum(each is not None for *_, each in weights)).tolist())
    for before, after, weight in weights:
        last = last if before is None else values[before]
        if weight is not None:
            of_last, of_later, both, spread = weight
            last = (of_last * last + of_later * values[after]) / both + sigma * spread * next(normals)
        out.append(last)
    return np.array(out)


Weight = tuple[float, float, float, float]
"""Weights of the values before and after, their divisor, and the standard deviation for a sigma of 1."""


@lru_cache(maxsize=16)
def _weights(at: bytes, time: bytes, correlation: float) -> list[tuple[int | None, int, Weight | None]]:
    """For each time of `between`: two known values by number, and their weights.

    The first is the last known value before it; None if the time of `between` before it is later. The second is the
    next known value, with a number beyond the last if there is none. Weights are None where the value is known.
    """
    out: list[tuple[int | None, int, Weight | None]] = []
    previous, known = -np.inf, np.frombuffer(time)
    times = np.frombuffer(at)
    for t, k in zip(times, np.searchsorted(known, times).tolist(), strict=True):
        newer = k > 0 and known[k - 1] >= previous
        before, after = known[k - 1] if newer else previous, known[k] if k < known.size else np.inf
        kept, left = np.exp(-(t - before) / correlation), np.exp(-(after - t) / correlation)
        both, weight = 1.0 - (kept * left) ** 2, None
        if both > 0.0:
            spread = np.sqrt((1.0 - kept**2) * (1.0 - left**2) / both)
            each = kept * (1.0 - left**2), left * (1.0 - kept**2), both, spread
            weight = float(each[0]), float(each[1]), float(each[2]), float(each[3])
        out.append((k - 1 if newer else None, k, weight))
        previous = t
    return out
