"""Predictions of the rest of a recording (`navsim replay --bet`)."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import navsim
from navsim.replays.prediction import Prediction, _quantile, verdict_of
from navsim.replays.reading import ReplayError
from navsim.replays.study import Recording
from navsim.results.result import read
from navsim.runner.job import OptionError, prediction_of
from navsim.runner.provenance import stored_options
from navsim.statistics.consistency import effective_count
from tests.recordings import write_flight

GIVEN = {
    "tuning": "none", "gnss.position_sigma_m": [0.3, 0.3], "gnss.velocity_sigma_m_s": [0.1, 0.1],
    "gnss.latency_s": 0.12, "imu.gyro.arw_deg_sqrt_h": 0.486, "imu.accelerometer.vrw_m_s_sqrt_h": 0.17,
    "outages": [{"start_s": [60.0], "duration_s": [5.0]}],
}  # fmt: skip
UNTIL = 45.0


def bet(log: Path, value: float | Path, name: str) -> navsim.ResultFile:
    return navsim.replay(log, bet=value, set=GIVEN, output=log.parent / f"{name}.h5")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bet")
    write_flight(folder, 75.0)
    return folder / "log.yaml"


@pytest.fixture(scope="module")
def scored(log: Path) -> navsim.ResultFile:
    return bet(log, UNTIL, "first")


def test_bands_of_a_right_model_cover_what_follows(log: Path, scored: navsim.ResultFile) -> None:
    """The noise of receiver and sensors is as given. The drift falls later, as heading and biases become known."""
    names = scored["summary/quantity"].tolist()
    assert names[-1] == "drift north, east after 5 s, m"
    for i, name in enumerate(names):
        for share in (50, 95):
            value, low, high = (scored[f"summary/bet_{of}_{share}"][i] for of in ("share", "low", "high"))
            assert low <= value <= high
            assert share / 100.0 < high, name
            assert low < share / 100.0 or name.startswith("drift"), name
    assert stored_options(read(scored.path)).bet == str(UNTIL)  # with which `navsim verify` computes it again
    fixes = int(np.sum(scored["receiver/time"] > UNTIL))
    assert scored["summary/bet_values"][:4].tolist() == [2 * fixes, fixes, 2 * fixes, fixes]
    assert np.all(scored["summary/bet_independent"] <= scored["summary/bet_values"])


def test_what_follows_does_not_change_the_prediction(log: Path, scored: navsim.ResultFile, tmp_path: Path) -> None:
    head, *rows = (log.parent / "gnss.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    moved = [[*row[:4], f"{float(row[4]) + (float(row[0]) > UNTIL):.4f}", *row[5:]] for row in cells]
    for name in ("imu.csv", "log.yaml"):
        (tmp_path / name).write_bytes((log.parent / name).read_bytes())
    (tmp_path / "gnss.csv").write_text("\n".join([head, *map(",".join, moved)]) + "\n")
    other = bet(tmp_path / "log.yaml", UNTIL, "first")
    first, again = (json.loads((folder / "first_bet.json").read_text()) for folder in (log.parent, tmp_path))
    assert first == again
    velocity = scored["summary/quantity"].tolist().index("velocity north, east, m/s")
    assert other["summary/bet_high_95"][velocity] < 0.95  # 1 m/s where 0.1 is predicted
    assert other["summary/bet_verdict"][velocity] == "sigma too small"
    assert scored["summary/bet_verdict"][velocity] == "held"
    (told,) = (found for found in other.findings if found.name == "prediction")
    assert told.against == ("consistent",)
    assert "sigma too small for velocity north, east" in told.text


def test_an_earlier_prediction_is_tested_as_it_was_written(log: Path, scored: navsim.ResultFile) -> None:
    path = log.parent / "first_bet.json"
    again = bet(log, path, "second")
    for name in ("band_50", "share_95", "values"):
        np.testing.assert_array_equal(again[f"summary/bet_{name}"], scored[f"summary/bet_{name}"])
    text = path.read_text()
    path.with_name("changed.json").write_text(text.replace('"until_s": 45.0', '"until_s": 44.0'))
    with pytest.raises(OptionError, match="it was changed"):
        Prediction.read(path.with_name("changed.json"))
    assert {prediction_of(Path(name)).name for name in ("log_bet.h5", "log.h5")} == {"log_bet.json"}
    with pytest.raises(navsim.BadInput, match="--bet 500: the recording ends at 75"):
        bet(log, 500.0, "late")
    with pytest.raises(navsim.BadInput, match=r"--bet 0\.5 leaves .* needed are"):
        bet(log, 0.5, "early")
    with pytest.raises(navsim.BadInput, match=r"--bet 3: no alignment: .* do 2.* s of motion .*; give a later time"):
        bet(log, 3.0, "unaligned")
    with pytest.raises(OptionError, match="expected a time"):
        Prediction.read(log)
    with pytest.raises(OptionError, match="no such file"):
        Prediction.read(log.with_name("none.json"))
    tight = cast(Recording, SimpleNamespace(tuned=("range_rate_sigma", "latency")))
    with pytest.raises(ReplayError, match="another coupling, without range_rate_sigma"):
        Prediction.read(path).tuning(tight)


@pytest.mark.parametrize(("inside", "count", "due"), [
    ((0.5, 0.95), 200.0, "held"), ((0.42, 0.86), 200.0, "sigma too small"), ((0.82, 1.0), 177.0, "sigma too large"),
    ((0.7, 0.85), 200.0, "not Gaussian"), ((0.2, 0.8), 5.0, "held"),
])  # fmt: skip
def test_verdicts_allow_for_chance(inside: tuple[float, float], count: float, due: str) -> None:
    assert verdict_of(inside, count) == due


def test_quantiles_of_a_mixture() -> None:
    assert _quantile(np.full((3, 2), 2.0), 0.95) == pytest.approx(2.0 * 1.959964, rel=1e-6)
    drawn = np.abs(np.random.default_rng(1).standard_normal((200_000, 2)) * [1.0, 4.0])
    assert _quantile(np.array([[1.0, 4.0]]), 0.5) == pytest.approx(float(np.median(drawn)), rel=0.01)


@pytest.mark.parametrize(("keep", "due"), [(0.0, 4000.0), (0.8, 4000.0 * (1.0 - 0.8) / (1.0 + 0.8))])
def test_correlated_values_count_less(keep: float, due: float) -> None:
    """Of a Gauss-Markov sequence the mean has (1 - r) / (1 + r) of its values; ranks of it are close to that."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal(4000)
    for k in range(1, x.size):
        x[k] = keep * x[k - 1] + np.sqrt(1.0 - keep**2) * x[k]
    assert effective_count(x[:, None]) == pytest.approx(due, rel=0.2)
    assert effective_count(np.stack([x, x], axis=1)) == pytest.approx(due, rel=0.2)
