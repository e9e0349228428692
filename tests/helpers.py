"""Building cases for tests from the shipped scenarios."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from _pytest.mark import ParameterSet

from navsim.filter import states
from navsim.landing import study as landing
from navsim.runner.batches import Ensemble
from navsim.scenario.landing import Landing
from navsim.scenario.load import read
from navsim.simulation.landing_covariance import Analysis

ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = ROOT / "scenarios"


def load_script(name: str) -> ModuleType:
    """A script of scripts/ as a module; scripts import each other by name."""
    if (folder := str(ROOT / "scripts")) not in sys.path:
        sys.path.insert(0, folder)
    return importlib.import_module(name)


def scenario(*assignments: str, name: str = "landing") -> Landing:
    """A shipped scenario with keys set."""
    return read(SCENARIOS / f"{name}.yaml", assignments)[0]


def case(*assignments: str, name: str = "landing") -> landing.Case:
    """A shipped scenario with keys set, ready to fly."""
    return landing.prepare(*read(SCENARIOS / f"{name}.yaml", assignments))


def outputs_at(flown: landing.Case, times: Iterable[float]) -> list[int]:
    """Outputs of the filter that are nearest to times, s."""
    return [int(np.argmin(np.abs(flown.shared.filter_time - t))) for t in times]


def squares_at(flown: landing.Case, ensemble: Ensemble) -> tuple[np.ndarray, np.ndarray]:
    """Mean NEES/15, in the filter's own coordinates, and NEES/6 at 10, 20, ... 120 s."""
    at = outputs_at(flown, range(10, 121, 10))
    return ensemble["nees"].mean(axis=0)[at] / 15, ensemble["nees_position_velocity"].mean(axis=0)[at] / 6


def ratios(ensemble: Ensemble, analysis: Analysis, at: list[int]) -> np.ndarray:
    """RMS errors of position and velocity over runs, divided by the predicted ones, at outputs (o, 6)."""
    predicted = np.sqrt(analysis.variance.sum(axis=0) + analysis.mean**2)
    return (np.sqrt(np.mean(ensemble["error"] ** 2, axis=0)) / predicted)[at, : states.ATT]


def cross(v: np.ndarray) -> np.ndarray:
    """The matrix [v x]."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def in_brief(values: Iterable[Any], *kept: int, whole: bool = False) -> list[Any]:
    """Parameters of a test of which those at the places `kept` run always, the others with `--long` only.

    whole: each is one parameter, although it is a tuple.
    """
    out = []
    for place, value in enumerate(values):
        if not isinstance(value, ParameterSet):
            value = pytest.param(*(value if isinstance(value, tuple) and not whole else (value,)))
        out.append(value if place in kept else value._replace(marks=[*value.marks, pytest.mark.long]))
    return out
