"""The best placement that a search found, as the checkpoints keep it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.runner.job import JobError


class NoPlacement(JobError):
    """The constraints leave no place, or no placement gives a fix at every epoch."""


@dataclass(frozen=True)
class Found:
    """Best placement of one number of pseudolites."""

    places: np.ndarray
    """(k, 2) s and l1, m."""
    value: float
    """Its objective; not finite if it has none and misses the requirements."""
    tried: dict[str, int]
    """Placements evaluated, by type of evaluation."""
    every: bool
    """The objective of every choice of sites was evaluated."""
    finished: bool
    """The search is complete."""
    load: float = 0.0
    """Load of the requirements. Above 1 no placement was found that meets them, and this one misses the worst of them
    by least."""
    others: tuple[np.ndarray, ...] = ()
    """Next best analysed placements (k, 2), the best first, in case runs contradict this one."""

    @property
    def met(self) -> bool:
        """Whether it meets all decidable requirements."""
        return self.load <= 1.0

    def arrays(self) -> dict[str, np.ndarray]:
        """The object as arrays, for `of`."""
        return {
            "places": self.places, "value": np.array(self.value), "every": np.array(self.every),
            "finished": np.array(self.finished), "way": np.array(list(self.tried)),
            "tried": np.array(list(self.tried.values())), "load": np.array(self.load),
            "others": np.array(self.others).reshape(-1, *self.places.shape),
        }  # fmt: skip

    @staticmethod
    def of(arrays: dict[str, np.ndarray]) -> Found:
        """The object from `arrays`."""
        tried = dict(zip(arrays["way"].tolist(), arrays["tried"].tolist(), strict=True))
        every, finished = bool(arrays["every"]), bool(arrays["finished"])
        others = tuple(arrays["others"])
        return Found(arrays["places"], float(arrays["value"]), tried, every, finished, float(arrays["load"]), others)
