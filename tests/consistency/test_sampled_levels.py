"""Risks beyond the levels of a landing, as results have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.integrity.residuals import Monitor
from navsim.integrity.risk import silent
from navsim.results.result import read
from tests.consistency.test_watched_fixes import brief
from tests.helpers import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim

BRANCH = "/integrity/tails"
SHORT = ("--set", "duration_s=20", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf", "--figures", "none")


@pytest.mark.parametrize("method", [pytest.param("monte-carlo", marks=pytest.mark.long), "covariance"])
def test_levels_of_a_landing_keep_what_is_allowed(tmp_path: Path, method: str) -> None:
    """By separation: no fault, all faults and what is not monitored, with the interval; runs again by their seed."""
    section = "integrity={p_constellation: 1.0e-8, tails: {at_s: [0, 7.3], samples: 20000}}"
    found = []
    for name in ("a.h5", "b.h5") if method == "monte-carlo" else ("a.h5",):
        given = ("--set", section, "--set", f"method={method}", "-o", name)
        said = navsim("run", SCENARIOS / "landing.yaml", *SHORT, *given, cwd=tmp_path)
        found.append(read(tmp_path / name))
    result = found[0]
    as_declared(result)
    assert "7 s, up, risk given the worst fault" in said.stdout
    np.testing.assert_array_equal(result[f"{BRANCH}/risk"], found[-1][f"{BRANCH}/risk"])
    np.testing.assert_allclose(result[f"{BRANCH}/at"], [0.5, 7.0])
    assert list(result[f"{BRANCH}/axis"]) == ["east", "north", "up"]
    total, allowed = result[f"{BRANCH}/total"], result[f"{BRANCH}/allowed"]
    np.testing.assert_allclose(allowed, [1e-9, 1e-9, 9.8e-8])
    assert (total[..., 2] <= allowed).all()
    assert (total[..., 0] > 0.01 * allowed).all()
    at = list(result["/integrity/time"]).index(7.0)
    assert result[f"{BRANCH}/level"][1, 2] == result["/integrity/vpl"][at]
    prior = np.array([1.0, *result["/integrity/prior"]])
    unmonitored = result["/integrity/unmonitored"][at] * allowed / 1e-7
    summed = np.nansum(prior * result[f"{BRANCH}/risk"][1, ..., 0], axis=1)
    np.testing.assert_allclose(summed + unmonitored, total[1, :, 0], rtol=1e-9)


def test_risks_of_residuals_are_the_closed_form(tmp_path: Path) -> None:
    section = "integrity={method: chi2, tails: {at_s: [7], samples: 100000}}"
    navsim("run", SCENARIOS / "landing.yaml", *SHORT, "--set", section, "-q", "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    c = brief("integrity={method: chi2}")
    monitor, at = c.flight.monitor, list(result["/integrity/time"]).index(7.0)
    assert isinstance(monitor, Monitor)
    level = float(result[f"{BRANCH}/level"][0, 0])
    assert level == pytest.approx(float(monitor.levels[at, 1]), rel=1e-12)
    for k, name in enumerate(result[f"{BRANCH}/fault"][1:], 1):
        bias = float(result[f"{BRANCH}/bias"][0, 0, k])
        exact = silent(monitor, at, c.shared.signals.names.index(str(name)), bias, level)
        value, low, high = result[f"{BRANCH}/risk"][0, 0, k]
        assert low - 1.5 * (value - low) <= exact <= high + 1.5 * (high - value)  # some two of ten are outside 95 %
        assert result[f"{BRANCH}/effective"][0, 0, k] > 1000
    assert result[f"{BRANCH}/total"][0, 0, 0] == np.nanmax(result[f"{BRANCH}/risk"][0, 0, :, 0])


def test_times_of_samples_lie_within_the_flight(tmp_path: Path) -> None:
    section = "integrity={method: chi2, tails: {at_s: [7, 21]}}"
    said = navsim(
        "run", SCENARIOS / "landing.yaml", *SHORT, "--set", section, "-o", "a.h5", cwd=tmp_path, code=2
    ).stderr
    assert "integrity.tails.at_s" in said
    assert "is not within duration_s, 20 s" in said


def test_where_there_is_no_level_nothing_is_sampled(tmp_path: Path) -> None:
    section = "integrity={tails: {at_s: [7], samples: 1000}}"  # the satellite system is too likely to fail
    navsim("run", SCENARIOS / "landing.yaml", *SHORT, "--set", section, "-q", "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    assert np.isnan(result[f"{BRANCH}/total"]).all()
