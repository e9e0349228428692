"""A landing takes sensors, signals, duration and runway from the result of a replay, and keeps the numbers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from navsim.landing.preflight import warnings_of
from navsim.results.result import Result, Variable, read, write
from navsim.runner.opening import checked
from navsim.scenario.load import read as read_landing
from navsim.scenario.load import read_any, resolved_yaml
from navsim.scenario_files.base import DEG_SQRT_H, MG
from navsim.scenario_files.source import InputError
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import replay_bench

from navsim.replays.alignment import Search
from navsim.replays.white_noise import standstills, white_noise
from tests.recordings import circuit, quadrotor

LANDING = "kind: landing\nversion: 1\nepoch: 2018-09-13T12:00:00Z\n"
PLACED = LANDING + "runway: {threshold: {lat_deg: 56.0, lon_deg: 37.0}, heading_deg: 0, height_m: 0}\n"
SMOOTH = PLACED + "approach: {profile: smooth}\n"
WHITE = "signals: {from: r.h5, hdop: 1, range_sigma_m: 1, range_rate_sigma_m_s: 1}\n"
TUNED = "tuned to the innovations"


@pytest.mark.parametrize(
    ("grade", "receiver", "slow"),
    [("consumer", "single point", False), ("tactical", "RTK", False), ("industrial", "differential", True)],
)
def test_white_noise_is_that_of_the_standstill(grade: str, receiver: str, slow: bool) -> None:
    """In motion it is twice to three times as large; over five such flights the ratio was 0.8 to 1.1."""
    bench = replay_bench.RECEIVERS[receiver]
    trajectory, rng = quadrotor() if slow else circuit(), np.random.default_rng(8)
    samples, fixes, drawn = replay_bench.record(trajectory, grade, bench, rng, 3.0 if slow else 2.0)
    sensors = replay_bench.sensors_of(grade)
    search = Search(None, 0.5, 120.0, sensors["gyro"].bias, 5.0 * sensors["gyro"].markov, sensors["accelerometer"].bias)
    rests = standstills(samples, fixes, search)
    for name, of in (("gyro", "rate"), ("accelerometer", "force")):
        found = white_noise(samples, rests, of)
        assert found is not None
        assert 0.7 < found[0] / drawn[name] < 1.4


def test_without_a_standstill_the_sheet_has_the_noise(place: Path) -> None:
    """The shipped recording begins in the air, with the sensors of its class."""
    flown = read(place / "replay.h5")
    assert float(flown["/tuning/gyro_white_noise"]) == pytest.approx(DEG_SQRT_H)
    assert flown.variables["/tuning/accelerometer_white_noise"].attributes["origin"] == (
        "no rest shows it; imu.sensor_class: consumer"
    )


def stored(text: str, folder: Path) -> dict[str, Any]:
    """The scenario that a result would keep. Read elsewhere, without the replay, it is the same."""
    (folder / "mine.yaml").write_text(text)
    kept = resolved_yaml(read_any(folder / "mine.yaml")[0])
    (folder / "elsewhere").mkdir(exist_ok=True)
    (folder / "elsewhere" / "kept.yaml").write_text(kept)
    assert resolved_yaml(read_any(folder / "elsewhere" / "kept.yaml")[0]) == kept
    found: dict[str, Any] = yaml.safe_load(kept)
    return found


def changed(place: Path, file: Path, **values: tuple[float, str] | None) -> Result:
    """The result of a replay with other tuned values and their origins, or without them, in a file."""
    flown = read(place / "replay.h5")
    for key, value in values.items():
        path = f"/tuning/{key}"
        flown.variables.pop(path, None)
        if value is not None:
            flown.variables[path] = Variable((), np.float64(value[0]), "1", "", {"origin": value[1]})
    write(file, flown)
    return flown


def test_sensors_are_those_of_the_recording(place: Path, tmp_path: Path) -> None:
    """Densities by their keys, bias as estimated with its sigma, in-run errors of the class; given keys stay."""
    flown = changed(place, tmp_path / "replay.h5", gyro_white_noise=(2.0 * DEG_SQRT_H, "at rest"))
    imu = stored(SMOOTH + "imu: {from: replay.h5, rate_hz: 50, gyro: {markov_deg_h: 7}}\n", tmp_path)["imu"]
    bias, sigma = flown["/filter/accelerometer_bias"][-1], flown["/filter/sigma"][-1, 12:15]
    gyro, accelerometer = imu["gyro"], imu["accelerometer"]
    assert (imu["rate_hz"], imu.get("from")) == (50, None)
    assert gyro["arw_deg_sqrt_h"] == pytest.approx(2.0)
    assert (gyro["markov_deg_h"], gyro["markov_time_s"], accelerometer["markov_mg"]) == (7.0, 300.0, 1.0)
    assert accelerometer["bias_mg"] == pytest.approx(np.sqrt(np.mean(bias**2 + sigma**2)) / MG)
    assert 300.0 < gyro["drift_deg_h"] < 3000.0  # one of three axes drawn from 1000


def test_ranges_have_the_errors_of_positions_by_hdop(place: Path, tmp_path: Path) -> None:
    """A position along north has HDOP / sqrt(2) of the error of a range."""
    tuned = {"position_sigma_horizontal": (0.4, TUNED), "velocity_sigma_horizontal": (0.1, TUNED)}
    lasting = {"position_error_horizontal": (1.5, TUNED), "position_error_time": (120.0, TUNED)}
    changed(place, tmp_path / "r.h5", **tuned, **lasting)
    signals = stored(SMOOTH + "signals: {from: r.h5, hdop: 0.8}\n", tmp_path)["signals"]
    factor = np.sqrt(2.0) / 0.8
    assert [signals["range_sigma_m"], signals["range_rate_sigma_m_s"]] == pytest.approx([0.4 * factor, 0.1 * factor])
    assert signals["range_law"] == "constant"
    (kind,) = signals["errors"].values()
    assert (kind["sigma_m"], kind["correlation_time_s"], kind["mapping"]) == (
        pytest.approx(1.5 * factor),
        120.0,
        "none",
    )


def test_ranges_of_a_tight_filter_are_taken_as_they_are(place: Path, tmp_path: Path) -> None:
    changed(place, tmp_path / "r.h5", range_sigma=(1.7, TUNED), range_rate_sigma=(0.06, TUNED))
    signals = stored(SMOOTH + "signals: {from: r.h5, preset: sbas}\n", tmp_path)["signals"]
    assert (signals["range_sigma_m"], signals["range_rate_sigma_m_s"]) == (1.7, 0.06)
    assert signals["range_law"] == "inverse-sine"
    assert signals["errors"]["ionosphere"]["sigma_m"] == 0.3


def test_duration_and_runway_are_those_of_the_recording(place: Path, tmp_path: Path) -> None:
    """The aircraft touches down where the recording ends, or where it is told to, along its course there."""
    flown = changed(place, tmp_path / "r.h5")
    approach = "approach: {profile: recorded, file: r.h5, start_s: 20, touchdown_s: 80}\n"
    scenario = stored(LANDING + approach, tmp_path)
    time, velocity = flown["/filter/time"], flown["/filter/velocity_ned"]
    at = int(np.argmin(np.abs(time - 80.0)))
    runway = scenario["runway"]
    assert scenario["duration_s"] == pytest.approx(time[-1] - 20.0, abs=0.1)
    place = [np.radians(runway["threshold"][key]) for key in ("lat_deg", "lon_deg")]
    assert place == pytest.approx(flown["/filter/position_llh"][at, :2], abs=1e-10)
    assert runway["height_m"] == pytest.approx(flown["/filter/position_llh"][at, 2], abs=1e-3)
    course = np.degrees(np.arctan2(velocity[at, 1], velocity[at, 0])) % 360.0
    assert runway["heading_deg"] == pytest.approx(course, abs=1e-3)
    checked(tmp_path / "mine.yaml", [])


@pytest.mark.parametrize(
    ("runway", "said"),
    [("", ["stays within 5 m above the runway until touchdown"]), ("runway: {height_m: 2}\n", ["148.2 m above"]),
     ("runway: {height_m: 149}\n", ["stays within"])],
)  # fmt: skip
def test_a_runway_at_flying_height_is_doubted(place: Path, tmp_path: Path, runway: str, said: list[str]) -> None:
    """The recording flies level and does not land; beacons would be counted from its height."""
    changed(place, tmp_path / "r.h5")
    approach = "approach: {profile: recorded, file: r.h5, start_s: 20, touchdown_s: 80}\n"
    beacons = "beacons: {sites: [{s_m: 60, l1_m: 150}], rate_hz: 2, sigma_m: 1, range_limit_m: 800}\n"
    (tmp_path / "mine.yaml").write_text(LANDING + runway + approach + beacons)
    doubts = [text for text in warnings_of(*read_landing(tmp_path / "mine.yaml")) if "approach.touchdown_s" in text]
    assert len(doubts) == len(said)
    assert all(part in text for part, text in zip(said, doubts, strict=True))


@pytest.mark.parametrize(
    ("text", "spoil", "key", "said"),
    [
        (SMOOTH + "imu: {from: r.h5}\n", {"gyro_white_noise": None}, "imu.from", "navsim replay LOG.yaml -o FILE"),
        (SMOOTH + "imu: {from: r.h5, preset: stim300}\n", {}, "imu.preset", "leave one of them out"),
        (SMOOTH + "imu: {from: mine.yaml}\n", {}, "imu.from", "mine.yaml: "),
        (SMOOTH + "signals: {from: r.h5}\n", {}, "signals.hdop", "give signals.hdop"),
        (SMOOTH + WHITE, {}, "signals.from", "signals.errors or"),
        (LANDING + "approach: {profile: recorded, file: r.h5, start_s: 900}\n", {}, "approach.start_s", "lasts from"),
    ],
)  # fmt: skip
def test_a_result_that_lacks_something_is_refused(
    place: Path, tmp_path: Path, text: str, spoil: dict[str, None], key: str, said: str
) -> None:
    """With the file, the key and what to write."""
    changed(place, tmp_path / "r.h5", **spoil)
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_any(tmp_path / "mine.yaml")
    (problem,) = caught.value.problems
    assert problem.key == key
    assert said in problem.message


def test_the_result_of_a_bet_has_no_measured_noise(place: Path, tmp_path: Path) -> None:
    predicted = (0.1, "as predicted")
    flown = changed(place, tmp_path / "r.h5", velocity_sigma_horizontal=predicted, position_sigma_horizontal=predicted)
    flown.variables["/summary/bet_until"] = Variable((), np.float64(70.0), "s", "", {"sha256": ""})
    write(tmp_path / "r.h5", flown)
    (tmp_path / "mine.yaml").write_text(SMOOTH + "signals: {from: r.h5, hdop: 1, preset: open-sky}\n")
    with pytest.raises(InputError) as caught:
        read_any(tmp_path / "mine.yaml")
    said = [problem.message for problem in caught.value.problems]
    assert all("name a result of `navsim replay` without --bet" in text for text in said)
    assert [text.rpartition("1 sigma of ")[2] for text in said] == ["a range", "a range rate"]


def test_all_that_a_recording_without_accuracies_lacks_is_said_at_once(place: Path, tmp_path: Path) -> None:
    """The shipped one, tuned; with the two keys of the messages the landing is valid."""
    changed(place, tmp_path / "r.h5", velocity_sigma_horizontal=(0.1, TUNED))
    (tmp_path / "mine.yaml").write_text(SMOOTH + "signals: {from: r.h5, hdop: 1}\n")
    with pytest.raises(InputError) as caught:
        read_any(tmp_path / "mine.yaml")
    assert [problem.key for problem in caught.value.problems] == ["signals.range_sigma_m", "signals.from"]
    given = "signals: {from: r.h5, hdop: 1, range_sigma_m: 0.5, preset: open-sky}\n"
    assert stored(SMOOTH + given, tmp_path)["signals"]["range_sigma_m"] == 0.5
