"""A recorded airliner: filters driven by its own Mode S reports against Singer's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.companions.azimuth.study import ratio, rmse
from tests.helpers import load_script

script: Any = load_script("recorded_approach")
mode_s: Any = load_script("mode_s")


@pytest.fixture(scope="module")
def found(shared: Path) -> Any:
    del shared  # skips where the recording is absent
    return script.tracked(200)


def test_received_reports_never_do_much_harm(found: Any) -> None:
    """In no 60 s worse than 1.10 times either Singer filter, in azimuth and range; better in the turn."""
    tracks, _, counted = found
    stretches = script.windows(tracks, counted)
    assert len(stretches) >= 18
    for errors in (tracks.azimuth, tracks.range):
        for begin, inside in stretches:
            for baseline in ("S1", "S2"):
                assert ratio(errors["received"][:, inside], errors[baseline][:, inside])[0] < 1.10, (begin, baseline)


def test_reports_each_second_beat_singer_in_the_turn(found: Any) -> None:
    """95 % intervals apart."""
    tracks, _, _ = found
    turn = (tracks.time >= script.TURN[0]) & (tracks.time < script.TURN[1])
    for errors in (tracks.azimuth, tracks.range):
        ours = rmse(errors["simulated"][:, turn])
        for baseline in ("S1", "S2"):
            assert ours[2] < rmse(errors[baseline][:, turn])[1]


def test_gaps_and_outliers_are_met(shared: Path) -> None:
    """In the 50 s gap of BDS 5,0 squitters stand in; every node stays near the truth."""
    recording = mode_s.read(shared / "data" / "modes_afr34zg", "afr34zg_lfbo", script.RADAR)
    time = script.TIME
    nodes, source = mode_s.received_nodes(recording, time)
    gap = (time > 975.0) & (time < 1015.0)
    assert np.all(source[gap] == 2)
    flight = mode_s.smoothed(recording, time)
    assert np.abs(nodes[:, 2] - flight.speed).max() < 6.0
    assert np.degrees(np.abs(np.angle(np.exp(1j * (nodes[:, 3] - flight.track))))).max() < 6.0
    assert np.abs(nodes[:, 1]).max() < 12.0
    assert np.sqrt(np.mean((np.interp(recording.positions[:, 0], time, flight.position[:, 0])
                            - recording.positions[:, 1])[60:-60] ** 2)) < 40.0  # fmt: skip
