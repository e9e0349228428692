"""Replay: simulated recordings against their truth, real ones against the figures beside them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.filter.design import gate_limits
from navsim.filter.records import REJECTED, TFG
from navsim.formats.conventions import FIX_SIGMAS
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.logs.reading import read_logs
from navsim.logs.tables import log_files
from navsim.replays import flight as simulated
from navsim.replays import study as replay
from navsim.replays.findings import _inconsistent, _tied, _too_calm
from navsim.replays.result_groups import write_filter, write_tuning
from navsim.replays.tuning import ERROR_SIZE, ERROR_TIME, SETTINGS, TuningSearch, _of_lever_arm, tune
from navsim.results import findings
from navsim.results.builder import ResultBuilder
from navsim.results.result import Result, Variable
from navsim.results.schema import REPLAY
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from tests.helpers import SCENARIOS, in_brief
from tests.recordings import (
    LATENCY,
    circuit,
    parked_before,
    quadrotor,
    record,
    sentences_of,
    write_flight,
    write_recording,
)

GIVEN = ("tuning=none", f"gnss.latency_s={LATENCY}", "gnss.velocity_sigma_m_s=[0.1, 0.1]")
"""What fixes of `write_flight` have, which tuning would find."""


def flown(log: Path, *assignments: str) -> Result:
    """The replay of a recording without mistakes: `test_diagnosis` searches those."""
    return replay.compute(replay.prepare(*read_replay(log, ("checks=off", *assignments))))


def errors(result: Result, truth: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position (m), velocity (m/s), attitude (deg) errors NED / roll pitch yaw at the outputs."""
    time, llh, velocity, rpy = truth
    t = result["/filter/time"]

    def at(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(t, time, values[:, i]) for i in range(3)], axis=1)

    ecef = at(ecef_from_llh(llh))
    position = np.einsum("nij,nj->ni", ned_matrix(at(llh)), ecef - ecef_from_llh(result["/filter/position_llh"]))
    turn = at(np.unwrap(rpy, axis=0)) - np.unwrap(result["/filter/attitude_rpy"], axis=0)
    return position, at(velocity) - result["/filter/velocity_ned"], np.degrees((turn + np.pi) % (2 * np.pi) - np.pi)


def remarks(result: Result) -> list[str]:
    return [found.text for found in findings.of(result)]


@pytest.mark.parametrize("missing", [(4, 5, 6), (5,)])
def test_fixes_fly_without_some_of_their_velocities(missing: tuple[int, ...], tmp_path: Path) -> None:
    """A component that is empty in some rows is not zero, and no other one is left out with it."""
    truth = write_flight(tmp_path, duration=60.0)
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    for k in range(1, len(rows), 4):
        rows[k] = ",".join("" if i in missing else cell for i, cell in enumerate(rows[k].split(",")))
    (tmp_path / "gnss.csv").write_text("\n".join([head, *rows]) + "\n")
    result = flown(tmp_path / "log.yaml", *GIVEN)
    assert not remarks(result)
    assert 0.7 < result["/summary/nis"][0] < 1.4
    position, velocity, _ = errors(result, truth)
    late = result["/filter/time"] > 40.0
    assert np.sqrt(np.mean(position[late] ** 2)) < 0.25
    assert np.sqrt(np.mean(velocity[late] ** 2)) < 0.1


@pytest.mark.long
def test_fixes_stamped_too_early_have_a_negative_latency(tmp_path: Path) -> None:
    """Used at the time they are valid; tuned, and as far off as with their right times."""
    truth = write_flight(tmp_path)
    result = flown(tmp_path / "log.yaml", f"gnss.time_offset_s={-0.3 - LATENCY}")
    assert float(result["/tuning/latency"]) == pytest.approx(-0.3, abs=0.02)
    assert not remarks(result)
    position, velocity, attitude = errors(result, truth)
    late = result["/filter/time"] > 40.0
    assert np.sqrt(np.mean(position[late] ** 2)) < 0.25
    assert np.sqrt(np.mean(velocity[late] ** 2)) < 0.15
    assert np.sqrt(np.mean(attitude[late] ** 2)) < 0.5


def test_a_given_negative_latency_is_that_of_the_times(tmp_path: Path) -> None:
    """The same fixes by right times and by early ones: the filter has them at the same moments."""
    write_flight(tmp_path, duration=60.0)
    given = ("tuning=none", "gnss.velocity_sigma_m_s=[0.1, 0.1]")
    right = flown(tmp_path / "log.yaml", *given, f"gnss.time_offset_s={-LATENCY}", "gnss.latency_s=0")
    early = flown(tmp_path / "log.yaml", *given, f"gnss.time_offset_s={-LATENCY - 0.4}", "gnss.latency_s=-0.4")
    np.testing.assert_allclose(early["/innovations/time"], right["/innovations/time"], atol=1e-6)
    np.testing.assert_allclose(early["/innovations/position_ned"], right["/innovations/position_ned"], atol=1e-4)
    np.testing.assert_allclose(early["/filter/position_llh"], right["/filter/position_llh"], rtol=1e-9)
    with pytest.raises(InputError, match="latency_s"):
        flown(tmp_path / "log.yaml", "gnss.latency_s=-1.5")


def test_a_wrong_lever_arm_is_told(tmp_path: Path) -> None:
    """2.5 m to the right of where it is: another one is told, within half a metre and its sigma of the true one."""
    write_flight(tmp_path, duration=60.0)
    result = flown(tmp_path / "log.yaml", "gnss.lever_arm_m=[0.4, 2.3, -0.3]")
    (text,) = [text for text in remarks(result) if "lever arm" in text]
    told = re.search(r"right (-?[0-9.]+) ± ", text)
    assert told is not None
    assert float(told[1]) == pytest.approx(-0.2, abs=0.5)
    assert "clearly better than [0.4, 2.3, -0.3] m" in text


@pytest.mark.parametrize("forward", in_brief([10.0, -10.0, 20.0], 0))
def test_a_wrong_forward_lever_arm_is_told_though_the_latency_hides_it(forward: float) -> None:
    """The shipped log, whose arm is 0.4 m forward and whose latency is 0.1 s: at a steady speed another latency hides
    another arm."""
    log = SCENARIOS / "recorded_flight.yaml"
    result = flown(log, f"gnss.lever_arm_m=[{forward}, 0, -0.3]", "outages=[]")
    assert abs(float(result["/tuning/latency"]) - 0.1) > 0.2
    (text,) = [text for text in remarks(result) if "lever arm" in text]
    told = re.search(r"forward about (-?[0-9.]+)", text)
    assert told is not None
    assert float(told[1]) == pytest.approx(0.4, abs=3.0)
    assert "at the mean speed 3.0 m more forward look almost like 0.1 s more latency" in text
    late = re.search(r"with a latency of (-?[0-9.]+) s", text)
    assert late is not None
    assert float(late[1]) == pytest.approx(0.1, abs=0.1)


def test_a_lever_arm_is_told_by_the_axes_that_the_motion_shows() -> None:
    text = _of_lever_arm(np.zeros(3), np.array([-0.7, -0.01, -0.402]), np.array([0.6, 0.09, 0.038]))
    assert text.startswith("a lever arm of right -0.01 ± 0.09, down -0.40 ± 0.04 m (1 sigma)")
    assert "the motion does not show forward. Measure it" in text
    text = _of_lever_arm(np.zeros(3), np.array([-7.0, -0.01, -0.402]), np.array([0.6, 0.09, 0.038]), 0.1, 20.0)
    assert text.startswith("a lever arm of forward about -7.0, right -0.01 ± 0.09, down -0.40 ± 0.04 m (1 sigma)")
    assert "with a latency of 0.10 s explains" in text


def test_a_latency_at_its_bound_is_told(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=60.0)
    result = flown(tmp_path / "log.yaml", f"gnss.time_offset_s={-1.3 - LATENCY}", "checks=off")
    assert float(result["/tuning/latency"]) == pytest.approx(-1.0, abs=0.01)
    assert any("the tuned latency is at its bound of -1 s" in text for text in remarks(result))


def test_a_tuning_that_has_not_converged_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_flight(tmp_path, duration=60.0)
    monkeypatch.setattr("navsim.replays.tuning.EVALUATIONS", 12)
    result = flown(tmp_path / "log.yaml")
    assert any("had not converged after" in text for text in remarks(result))


@pytest.mark.parametrize(("noise", "followed"), in_brief([(0.8, True), (0.02, False)], 0))
def test_positions_that_wander_are_followed(noise: float, followed: bool, tmp_path: Path) -> None:
    """Over 20 s: the filter has states for the error, of the size and time that make the innovations likeliest, and its
    sigmas of position are true."""
    log = write_recording(tmp_path, *record(circuit(), 1, position_noise=noise))
    given = ("gnss.velocity_sigma_m_s=[0.11, 0.13]", "gnss.latency_s=0.1", "imu.accelerometer.vrw_m_s_sqrt_h=2.1")
    truth = circuit().motion(np.arange(1.0, 171.0, 0.05))
    known = truth.time, truth.llh, truth.velocity_ned, truth.rpy
    nees = []
    for keys in (("tuning=none",), ("tuning=likelihood",)):
        result = flown(log, *given, *keys)
        late = result["/filter/time"] > 30.0
        z = errors(result, known)[0] / result["/filter/sigma"][:, :3]
        nees.append(float(np.mean(z[late] ** 2)))
    assert ("/tuning/position_error_time" in result) == followed
    if followed:
        assert 5.0 < float(result["/tuning/position_error_time"]) < 100.0
        assert 0.4 < float(result["/tuning/position_error_horizontal"]) < 2.5
        assert result.variables["/tuning/position_error_time"].attributes["origin"].startswith("tuned")
        assert nees[0] > 9.0
        assert 0.15 < nees[1] < 2.0


def test_lasting_errors_are_as_large_as_the_receiver_claims(tmp_path: Path) -> None:
    """Positions 3 m off during the whole flight: accuracies of the fixes tell the filter so, and innovations alone do
    not, of which the table warns."""
    samples, fixes = record(circuit(), 1, position_noise=0.1, velocity_noise=0.03)
    off = ned_matrix(fixes.llh[0]).T @ np.array([3.0, -2.0, 4.0])
    fixes = replace(fixes, llh=llh_from_ecef(ecef_from_llh(fixes.llh) + off))
    given = ("imu.gyro.arw_deg_sqrt_h=1", "imu.accelerometer.vrw_m_s_sqrt_h=0.5")
    sigma = []
    claims = np.tile([3.0, 4.5, 0.03], (fixes.time.size, 1))
    for accuracy, tuning in ((None, "tuning=none"), (claims, "tuning=likelihood")):
        result = flown(write_recording(tmp_path, samples, replace(fixes, accuracy=accuracy)), tuning, *given)
        told = "errors of the positions that last for minutes" in str(result.attributes["not_judged"])
        assert told == (accuracy is None)
        sigma.append(result["/filter/sigma"][-1, :3])
    assert np.all(sigma[0] < 0.6)
    assert np.all((sigma[1] > 2.0) & (sigma[1] < [4.0, 4.0, 6.0]))
    assert float(result["/tuning/position_sigma_horizontal"]) < 0.4
    assert 2.0 < float(result["/tuning/position_error_horizontal"]) < 4.0
    origins = {path: str(variable.attributes.get("origin")) for path, variable in result.variables.items()}
    assert "determined: 95 % within a factor of" in origins["/tuning/position_error_time"]  # of an error that stays
    assert origins["/tuning/position_sigma_vertical"].startswith("tuned to the innovations, ")
    latency = result.variables["/tuning/latency"].attributes["origin"]
    shown = re.fullmatch(r"tuned to the innovations, 1 sigma ([0-9.]+) s", str(latency))
    assert shown is not None
    assert abs(float(result["/tuning/latency"]) - 0.1) < 4.0 * float(shown[1])


@pytest.mark.parametrize("seed", in_brief([3101, 3102, 3103], 0))
def test_lasting_errors_without_claims_are_in_the_sigma(seed: int, tmp_path: Path) -> None:
    """Positions wander by 1.2 m over 120 s, with white noise of six times the velocities' per second, and the receiver
    claims nothing: the NEES of position is near 1."""
    samples, fixes = record(circuit(), seed, position_noise=0.0, velocity_noise=0.05)
    rng, count = np.random.default_rng(seed), fixes.time.size
    off, keep = 1.2 * rng.standard_normal((count, 3)), np.exp(-1.0 / 120.0)
    for k in range(1, count):
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * off[k]
    moved = (off + 0.3 * rng.standard_normal((count, 3))) * [1.0, 1.0, 1.5]
    ecef = ecef_from_llh(fixes.llh) + np.einsum("nji,nj->ni", ned_matrix(fixes.llh), moved)
    given = ("gnss.velocity_sigma_m_s=[0.05, 0.05]", "gnss.latency_s=0.1", "imu.accelerometer.vrw_m_s_sqrt_h=0.5")
    log = write_recording(tmp_path, samples, replace(fixes, llh=llh_from_ecef(ecef)))
    result = flown(log, "tuning=likelihood", *given)
    truth = circuit().motion(np.arange(1.0, 171.0, 0.05))
    off = errors(result, (truth.time, truth.llh, truth.velocity_ned, truth.rpy))[0]
    z = (off / result["/filter/sigma"][:, :3])[result["/filter/time"] > 30.0]
    assert 0.1 < np.mean(z**2) < 4.0
    assert 0.2 < float(result["/tuning/position_sigma_horizontal"]) < 0.45
    assert 30.0 < float(result["/tuning/position_error_time"]) < 300.0


def test_lasting_errors_that_reject_more_fixes_are_left_out(tmp_path: Path) -> None:
    """A smoothing receiver's positions jump: what fits all others best would reject those."""
    recording = replay.prepare(*read_replay(write_recording(tmp_path, *record(circuit(), 1))))

    class Strict(TuningSearch):
        def evaluate(self, values: np.ndarray, judged: bool = True, near: Any = None) -> Any:
            found = super().evaluate(values, judged, near)
            return found if self.kept is not None else replace(found, rejected=found.rejected | (found.cost > most))

    most = np.inf
    search = Strict(recording, lambda _: None)
    now = search.evaluate(recording.settings)
    assert search.lasting(recording.settings, now) is not None
    most = -np.inf
    assert search.lasting(recording.settings, now) is None


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (0, "for minutes: the fixes have no sigma_horizontal_m and no sigma_vertical_m, and no innovation shows them"),
        (1, "no sigma_vertical_m, and"),
        (2, "the accuracies of the fixes count as white noise"),
    ],
)
def test_why_the_size_of_lasting_errors_is_unknown(columns: int, words: str, tmp_path: Path) -> None:
    """Not for want of accuracies that the table has."""
    samples, fixes = record(circuit(), 1)
    claims = np.tile([3.0, 4.5], (fixes.time.size, 1))[:, :columns]
    log = write_recording(tmp_path, samples, replace(fixes, accuracy=claims if columns else None))
    recording = replay.prepare(*read_replay(log, ("tuning=none",)))
    (text,) = recording.unknown_errors(recording.settings)
    assert words in text
    tuned = np.where(np.arange(SETTINGS) == ERROR_SIZE, 2.0, np.where(np.arange(SETTINGS) == ERROR_TIME, 19.3, 0.0))
    assert ("much longer than the 19 s of the tuned error" in recording.unknown_errors(tuned)[0]) == (columns < 2)
    draft = ResultBuilder(REPLAY)
    write_tuning(draft, recording, tune(recording))
    origin = draft.variables["/tuning/position_sigma_horizontal"].attributes["origin"]
    assert origin == ("accuracies of the fixes" if columns == 2 else "2.5 s times the velocity sigma")


def test_an_uncertain_latency_is_in_the_sigma_of_position(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=60.0)
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", *GIVEN)))
    flight, sigma = recording.flight(recording.settings), recording.fix_sigma(recording.settings)
    seen = simulated.fly(flight, recording.design(recording.settings, TFG), sigma, np.arange(40.0, 50.0))
    surely, perhaps = (ResultBuilder(REPLAY, {"mixed": "m"}) for _ in range(2))
    names = [f"state {i}" for i in range(seen.sigma.shape[1])]
    for draft, latency_sigma in ((surely, 0.0), (perhaps, 0.1)):
        write_filter(draft, seen, np.ones(seen.time.size, bool), names, names, latency_sigma)
    more = perhaps["/filter/sigma"] ** 2 - surely["/filter/sigma"] ** 2
    np.testing.assert_allclose(more[:, :3], (0.1 * surely["/filter/velocity_ned"]) ** 2, atol=1e-9)
    assert not more[:, 3:].any()
    assert np.median(more[:, :2].sum(axis=1)) > 1.0


def test_velocities_older_than_positions_are_found(tmp_path: Path) -> None:
    """By 0.4 s: both latencies are found, and as good as given."""
    truth = write_flight(tmp_path, duration=60.0, lag=0.4)
    tuned = flown(tmp_path / "log.yaml", "imu.gyro.arw_deg_sqrt_h=0.5", "imu.accelerometer.vrw_m_s_sqrt_h=0.17")
    assert float(tuned["/tuning/latency"]) == pytest.approx(LATENCY, abs=0.03)
    assert float(tuned["/tuning/velocity_latency"]) == pytest.approx(LATENCY + 0.4, abs=0.03)
    given = flown(tmp_path / "log.yaml", *GIVEN, f"gnss.velocity_latency_s={LATENCY + 0.4}")
    alike = flown(tmp_path / "log.yaml", *GIVEN)
    assert given["/summary/nis"][0] == pytest.approx(1.0, abs=0.3)
    assert alike["/summary/nis"][0] > 3.0
    late = given["/filter/time"] > 20.0
    for position, velocity, _ in (errors(tuned, truth), errors(given, truth)):
        assert np.sqrt(np.mean(position[late] ** 2)) < 0.2
        assert np.sqrt(np.mean(velocity[late] ** 2)) < 0.1


def test_a_known_lag_of_velocities_uses_nothing_of_the_withheld_fix(tmp_path: Path) -> None:
    """Drift is read before the velocity of its fix is used, which is older than its position."""
    write_flight(tmp_path, lag=0.4)
    outage = ("outages=[{start_s: [50], duration_s: [10]}]", *GIVEN, f"gnss.velocity_latency_s={LATENCY + 0.4}")
    drift = flown(tmp_path / "log.yaml", *outage)["/outages/horizontal_error"]
    rows = (tmp_path / "gnss.csv").read_text().splitlines()
    (last,) = [i for i, row in enumerate(rows[1:], 1) if abs(float(row.split(",")[0]) - 59.62) < 1e-6]
    rows[last] = ",".join([*rows[last].split(",")[:4], "", "", ""])
    (tmp_path / "gnss.csv").write_text("\n".join(rows) + "\n")
    np.testing.assert_allclose(flown(tmp_path / "log.yaml", *outage)["/outages/horizontal_error"], drift, rtol=1e-9)


def test_claimed_accuracies_weigh_the_fixes(tmp_path: Path) -> None:
    """A receiver that claims half of its errors, and for two fixes of three ten times as much as for the third: the
    noise of the usual fix is tuned, the others have theirs in proportion. Fixes of a quality below 3 have no height."""
    truth = write_flight(tmp_path)
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    rng, out = np.random.default_rng(3), []
    for i, row in enumerate(rows):
        cells = row.split(",")
        factor = 1.0 if i % 3 == 2 else 10.0
        more = np.sqrt(factor**2 - 1.0)
        north, east, down = 0.3 * more * rng.standard_normal(3)
        cells[1] = f"{float(cells[1]) + north / 111200.0:.10f}"
        cells[2] = f"{float(cells[2]) + east / (111300.0 * np.cos(np.radians(float(cells[1])))):.10f}"
        cells[3] = f"{float(cells[3]) - down:.4f}"
        cells[4:7] = [f"{float(v) + 0.1 * more * rng.standard_normal():.4f}" for v in cells[4:7]]
        out.append(
            ",".join([*cells, *(f"{factor * claim:g}" for claim in (0.15, 0.15, 0.05)), "2" if i == 40 else "3"])
        )
    names = "sigma_horizontal_m,sigma_vertical_m,sigma_speed_m_s,quality"
    (tmp_path / "gnss.csv").write_text("\n".join([f"{head},{names}", *out]) + "\n")
    log = tmp_path / "log.yaml"
    given = (f"gnss.latency_s={LATENCY}", "imu.gyro.arw_deg_sqrt_h=0.5", "imu.accelerometer.vrw_m_s_sqrt_h=0.17")
    recording = replay.prepare(*read_replay(log, given))
    assert "1 fixes of a quality below 3, which have no height" in recording.warnings
    assert float(rows[40].split(",")[0]) not in recording.fixes.time
    weighed = replay.compute(recording)
    assert float(weighed["/tuning/velocity_sigma_horizontal"]) == pytest.approx(1.0, rel=0.4)
    assert float(weighed["/tuning/position_sigma_horizontal"]) == pytest.approx(3.0, rel=0.4)
    (tmp_path / "gnss.csv").write_text("\n".join([head, *(",".join(row.split(",")[:7]) for row in out)]) + "\n")
    alike = flown(log, *given)
    rms = []
    for result in (weighed, alike):
        late = result["/filter/time"] > 30.0
        rms.append(np.sqrt(np.mean(errors(result, truth)[0][late] ** 2)))
    assert rms[0] < 0.7 * rms[1]


def test_evidence_of_a_good_flight(tmp_path: Path) -> None:
    """Of a flight as the filter believes it: what is due is there, of each motion, quantity and length of outage."""
    write_flight(tmp_path, duration=200.0)
    result = flown(tmp_path / "log.yaml", *GIVEN, "gnss.position_sigma_m=[0.3, 0.3]",
                   "outages=[{start_s: [40, 60, 80, 100, 120, 140, 160], duration_s: [5, 10]}]")  # fmt: skip
    assert result["/summary/motion"].tolist() == ["all", "moving", "parked", "straight", "turning"]
    for name in ("nis", "nis_position", "nis_velocity"):
        values = result[f"/summary/{name}"]
        assert np.all((values[[0, 1, 4]] > 0.6) & (values[[0, 1, 4]] < 1.5))
        assert np.isnan(values[2])
    for name in ("position", "velocity"):
        assert abs(float(result[f"/summary/lag1_{name}"])) < 0.2
    assert np.all((result["/summary/drift_nees"] > 0.2) & (result["/summary/drift_nees"] < 2.5))


def test_parked_fixes_do_not_tune(tmp_path: Path) -> None:
    """However many a slow flight has: its own fixes in motion do; of one that never moves nothing is tuned."""
    hovering = record(quadrotor(70.0), 1, rate=25.0, fix_rate=2.0, position_noise=0.3)
    samples, fixes = parked_before(*hovering, 100.0)
    given = ("tuning=likelihood", "alignment.heading_deg=40.1", "alignment.heading_sigma_deg=5",
             "imu.gyro.arw_deg_sqrt_h=1", "imu.accelerometer.vrw_m_s_sqrt_h=1", "gnss.latency_s=0.1")  # fmt: skip
    result = flown(write_recording(tmp_path, samples, fixes), *given)
    assert 0.05 < float(result["/tuning/velocity_sigma_horizontal"]) < 0.12  # 0.01 m/s at rest, 0.1 m/s in flight
    assert 0.7 < result["/summary/nis"][1] < 1.4
    assert not remarks(result)
    standing = write_recording(tmp_path, samples.between(0.0, 100.0), fixes.take(fixes.time < 100.0))
    result = flown(standing, *given)
    (text,) = remarks(result)
    assert text.startswith("nothing is tuned: 0 fixes are in motion (faster than 0.5 m/s)")
    assert float(result["/tuning/velocity_sigma_horizontal"]) == 0.3
    assert result.variables["/tuning/velocity_sigma_horizontal"].attributes["origin"] == "given"


def test_innovations_larger_than_believed_are_told(tmp_path: Path) -> None:
    """Also below the factor that a simulated filter is doubted from."""
    write_flight(tmp_path, duration=60.0)
    given = ("tuning=none", f"gnss.latency_s={LATENCY}")
    for sigma, told in ((0.06, True), (0.1, False)):
        result = flown(tmp_path / "log.yaml", *given, f"gnss.velocity_sigma_m_s=[{sigma}, {sigma}]")
        assert (1.9 if told else 0.7) < result["/summary/nis"][0] < (3.5 if told else 1.3)
        assert any("have a NIS of" in text for text in remarks(result)) == told


@pytest.mark.parametrize(
    ("vertical", "rough"),
    in_brief([
        (False, False), (True, True),
        *(pytest.param(vertical, not vertical, marks=pytest.mark.long) for vertical in (False, True)),
    ], 0),
)  # fmt: skip
def test_a_simulated_recording_is_recovered(rough: bool, vertical: bool, tmp_path: Path) -> None:
    truth = write_flight(tmp_path, rough=rough, vertical=vertical)
    result = flown(tmp_path / "log.yaml")
    position, velocity, attitude = errors(result, truth)
    late = result["/filter/time"] > 40.0
    assert np.sqrt(np.mean(position[late, :2] ** 2)) < 0.3
    assert np.sqrt(np.mean(velocity[late] ** 2)) < 0.15
    assert np.sqrt(np.mean(attitude[late, :2] ** 2)) < 0.3
    assert np.sqrt(np.mean(attitude[late, 2] ** 2)) < 1.0
    assert float(result["/tuning/latency"]) == pytest.approx(LATENCY, abs=0.02)
    assert 0.7 < result["/summary/nis"][1] < 1.4
    sigma = result["/filter/sigma"][late]
    scaled = np.concatenate([position[late], velocity[late], np.radians(attitude[late])], axis=1) / sigma[:, :9]
    assert np.sqrt(np.mean(scaled**2)) < 1.6


def test_what_is_wrong_with_a_recording_is_counted(tmp_path: Path) -> None:
    write_flight(tmp_path, rough=True)
    found = replay.prepare(*read_replay(tmp_path / "log.yaml")).warnings
    for fragment in ("samples out of order", "samples with the time of another", "fixes out of order",
                     "3 placeholders before the first fix", "fixes with the time of another"):  # fmt: skip
        assert any(fragment in warning for warning in found), (fragment, found)


def test_the_files_are_pinned(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=30.0)
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",)))
    sums = recording.scenario.imu.file_sha256, recording.scenario.gnss.file_sha256
    assert None not in sums
    replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", f"imu.file_sha256={sums[0]}")))
    with pytest.raises(InputError, match="not this one"):
        replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", f"gnss.file_sha256={sums[0]}")))


def test_a_gap_is_bridged_with_a_covariance_that_knows_it(tmp_path: Path) -> None:
    truth = write_flight(tmp_path)
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    (tmp_path / "imu.csv").write_text("\n".join(lines[:2500] + lines[2600:]) + "\n")  # 50 to 52 s
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", "gnss.latency_s=0.12")))
    result = replay.compute(recording)
    assert any("no samples for 2" in found.text for found in findings.of(result))
    position, _, attitude = errors(result, truth)
    t = result["/filter/time"]
    sigma = result["/filter/sigma"]
    # answers come a latency after the state they rest on
    after, before = (t > 52.2) & (t < 52.6), (t > 49.0) & (t < 49.8)
    assert sigma[after, 6].mean() > 5.0 * sigma[before, 6].mean()
    scaled = np.abs(np.concatenate([position, np.radians(attitude)], axis=1) / sigma[:, [0, 1, 2, 6, 7, 8]])
    assert np.max(scaled[after]) < 4.0
    assert np.sqrt(np.mean(position[t > 70.0] ** 2)) < 0.5


def test_smoothing_is_better_than_filtering(tmp_path: Path) -> None:
    """Both by the same noise and latency: tuning is the filter's, and costs some hundred flights."""
    truth = write_flight(tmp_path)
    filtered = errors(flown(tmp_path / "log.yaml", *GIVEN), truth)
    smoothed = errors(flown(tmp_path / "log.yaml", *GIVEN, "filter.kind=rts"), truth)
    for a, b in zip(filtered, smoothed, strict=True):
        assert np.sqrt(np.mean(b[50:] ** 2)) < np.sqrt(np.mean(a[50:] ** 2))


def without(path: Path, first: float, last: float) -> None:
    """Take the rows of first < time < last out of a table."""
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(r for r in rows if not first < float(r.split(",")[0]) < last)]) + "\n")


@pytest.mark.parametrize(("kind", "fixes_lost"), in_brief([("rts", True), ("map", False)], 0))
def test_smoothing_carries_across_a_gap(kind: str, fixes_lost: bool, tmp_path: Path) -> None:
    """No samples for two seconds, while the flight rolls from one turn into the other: what came later corrects what
    was before and within, and the sigmas are those of the errors."""
    truth = write_flight(tmp_path)
    without(tmp_path / "imu.csv", 50.0, 52.0)
    if fixes_lost:
        without(tmp_path / "gnss.csv", 49.5, 52.5)
    # smoothers couple by the measured force, so the filter beside them does
    filtered = flown(tmp_path / "log.yaml", *GIVEN, "filter.steady_force=false")
    smoothed = flown(tmp_path / "log.yaml", *GIVEN, f"filter.kind={kind}")
    t, sigma = smoothed["/filter/time"], smoothed["/filter/sigma"]
    before, within, around = (t > 49.7) & (t < 50.0), (t > 50.3) & (t < 52.2), (t > 49.0) & (t < 55.0)
    if not fixes_lost:
        assert np.all(sigma[before, :2] < 0.8 * filtered["/filter/sigma"][before, :2])
    for a, b in zip(errors(filtered, truth), errors(smoothed, truth), strict=True):
        assert rms(b[within].ravel()) < 0.7 * rms(a[within].ravel())
    position, velocity, attitude = errors(smoothed, truth)
    scaled = np.concatenate([position, velocity, np.radians(attitude)], axis=1) / sigma[:, :9]
    assert rms(scaled[around].ravel()) < 1.6
    assert np.max(np.abs(scaled[around])) < 4.0


def test_answers_before_a_gap_are_of_their_own_time(tmp_path: Path) -> None:
    """An answer rests on a state a latency old, carried on: also where samples are missing on the way."""
    truth = write_flight(tmp_path)
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    (tmp_path / "imu.csv").write_text("\n".join(lines[:2500] + lines[2520:]) + "\n")  # 50 to 50.4 s
    result = flown(tmp_path / "log.yaml", "tuning=none", f"gnss.latency_s={LATENCY}", "filter.output_rate_hz=50")
    position, _, _ = errors(result, truth)
    t = result["/filter/time"]
    # one latency is 6 m of flight: a state not carried on would show
    assert np.abs(position[(t > 50.0) & (t < 50.4)]).max() < 2.0


def test_without_velocities_the_start_has_one_from_the_positions(tmp_path: Path) -> None:
    """A flight under way, its fixes without velocity: it starts with the speed it has, and counts as moving."""
    write_flight(tmp_path)
    lines = (tmp_path / "gnss.csv").read_text().splitlines()
    rows = [",".join([*line.split(",")[:4], "", "", ""]) for line in lines[1:]]
    (tmp_path / "gnss.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",)))
    flight = recording.flight(recording.settings)
    expected = np.linalg.norm(flight.start.velocity[:2])
    assert expected > 20.0
    assert flight.speed.min() > 20.0
    result = replay.compute(recording)
    assert np.linalg.norm(result["/filter/velocity_ned"][0, :2]) == pytest.approx(expected, abs=3.0)
    assert np.isfinite(result["/summary/nis"][:2]).all()


def test_outages_withheld_and_drift(tmp_path: Path) -> None:
    write_flight(tmp_path)
    result = flown(
        tmp_path / "log.yaml", "tuning=none", "gnss.latency_s=0.12",
        "outages=[{start_s: [50, 60], duration_s: [5, 20]}, {start_s: 70, duration_s: 3, withhold: true}]",
    )  # fmt: skip
    assert not any(found.text.startswith("outages.") for found in findings.of(result))
    length = result["/outages/end"] - result["/outages/start"]
    drift = result["/outages/horizontal_error"]
    assert sorted(length) == [3.0, 5.0, 5.0, 20.0, 20.0]
    assert np.isfinite(drift).all()
    assert drift[length == 20.0].max() > drift[length == 5.0].max()
    t = result["/innovations/time"]
    withheld = np.isnan(result["/innovations/position_ned"][:, 0])
    np.testing.assert_array_equal(withheld, (t >= 70.0) & (t <= 73.0))


def test_outages_that_are_not_flown_are_said(tmp_path: Path) -> None:
    """Of one that begins or ends where nothing is recorded there is no drift, and it is not passed over."""
    write_flight(tmp_path)
    recording = replay.prepare(
        *read_replay(tmp_path / "log.yaml", ("tuning=none", "outages=[{start_s: [50, 6000], duration_s: [5, 1000]}]"))
    )
    (told,) = [text for text in recording.warnings if text.startswith("outages: ")]
    assert told.startswith("outages: 3 of 4 reach beyond the replayed part, ")
    assert told.endswith(", and have no drift: 6000 to 6005 s, 50 to 1050 s, 6000 to 7000 s")


def test_nmea_is_as_good_as_a_table(tmp_path: Path) -> None:
    """The same fixes as GGA and RMC sentences, whose resolution is a centimetre and 0.005 m/s."""
    write_flight(tmp_path)
    sentences = sentences_of(tmp_path / "gnss.csv")
    sentences.insert(7, "$GPGGA,garbled*00")
    (tmp_path / "gnss.nmea").write_text("\r\n".join(sentences))
    by_table = replay.prepare(*read_replay(tmp_path / "log.yaml"))
    by_nmea = replay.prepare(*read_replay(tmp_path / "log.yaml", (f"gnss.file={tmp_path}/gnss.nmea",)))
    np.testing.assert_allclose(by_nmea.fixes.time, by_table.fixes.time, atol=1e-4)
    np.testing.assert_allclose(by_nmea.fixes.llh, by_table.fixes.llh, atol=2e-3)
    np.testing.assert_allclose(by_nmea.fixes.llh[:, :2], by_table.fixes.llh[:, :2], atol=1e-8)
    np.testing.assert_allclose(by_nmea.fixes.velocity[:, :2], by_table.fixes.velocity[:, :2], atol=2e-3)
    assert any("corrupt NMEA" in warning for warning in by_nmea.warnings)


# --- real flights, against the figures of plain filters (docs/replay.md)

THOR = """kind: replay
version: 1
imu: {{file: {folder}/imu.csv.gz}}
gnss: {{file: {folder}/gnss.csv}}
start_s: 150
outages:
  - {{start_s: [250, 280, 310, 340, 370, 400, 430, 460, 490], duration_s: [10, 30]}}
"""


TUNED = {
    "/tuning/velocity_sigma_horizontal": 0.2237, "/tuning/velocity_sigma_vertical": 0.2611,
    "/tuning/gyro_noise_density": 2.936e-3, "/tuning/accelerometer_noise_density": 0.09791, "/tuning/latency": 0.0580,
}  # fmt: skip
"""What tuning finds for that flight, in 40 s, rounded."""


def as_tuned() -> tuple[str, ...]:
    """The keys that give what `TUNED` has."""
    horizontal, vertical, gyro, accelerometer, latency = TUNED.values()
    return (
        "tuning=none", f"gnss.velocity_sigma_m_s=[{horizontal}, {vertical}]", f"gnss.latency_s={latency}",
        f"imu.gyro.arw_deg_sqrt_h={np.degrees(gyro) * 60.0}",
        f"imu.accelerometer.vrw_m_s_sqrt_h={accelerometer * 60.0}",
    )  # fmt: skip


@pytest.fixture(scope="module")
def thor_log(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("thor") / "log.yaml"
    log.write_text(THOR.format(folder=shared / "data/fw_thor75"))
    return log


@pytest.fixture(scope="module", params=["as tuned", pytest.param("tuning", marks=pytest.mark.long)])
def thor(request: pytest.FixtureRequest, shared: Path, thor_log: Path) -> tuple[Result, Any]:
    """Flown with the noise and latency that tuning finds, which it finds anew where there is time."""
    folder = shared / "data/fw_thor75"
    import gzip

    with gzip.open(folder / "onboard_nav.csv.gz", "rt") as file:
        onboard = np.genfromtxt(file, delimiter=",", names=True)
    result = flown(thor_log, *(as_tuned() if request.param == "as tuned" else ()))
    for name, value in TUNED.items():
        assert float(result[name]) == pytest.approx(value, rel=1e-3), name
    return result, onboard


def rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.nanmean(np.asarray(x) ** 2, axis=0))


def test_thor_innovations(thor: tuple[Result, Any]) -> None:
    """Take-off, circuits, landing: innovations no larger than an untuned filter's, sigma as large as they are."""
    result, _ = thor
    t = result["/innovations/time"]
    circuits = (t > 230.0) & (t < 570.0)
    assert np.all(np.round(rms(result["/innovations/position_ned"][circuits]), 1) <= [1.4, 0.8, 1.4])
    assert np.all(np.round(rms(result["/innovations/velocity_ned"][circuits]), 2) <= [0.56, 0.53, 0.32])
    # NIS counts no fix that the gate rejected: flown without the gate, by the noise tuned without it, all fixes have
    # 0.76 and those in motion 1.01 (limit 0.7), and the same noise with the gate 0.56 and 0.75. What is missing are the
    # squares of the launch and of jumps of the receiver. Down: 0.314 m/s without the gate, 0.322 with it, since the
    # noise that is tuned is another one.
    assert np.all((result["/summary/nis"][:2] > [0.5, 0.7]) & (result["/summary/nis"][:2] < 1.4))
    assert result["/innovations/time"][-1] > 690.0
    # the receiver had 0 to 4 satellites in the first 20 s after launch
    assert np.all((result["/lost/start"] > 211.0) & (result["/lost/end"] < 232.0))
    # no divergence: the last innovations, on the ground, are small
    assert np.abs(result["/innovations/position_ned"][-20:]).max() < 2.0


def test_thor_attitude_against_onboard(thor: tuple[Result, Any]) -> None:
    result, onboard = thor
    # aligned anew at 225 s, after the receiver's errors of the launch: its own heading settles until 270 s. To keep the
    # attitude of before does not help: fixes that the gate let pass at the launch had turned it by 12 degrees with 1.5
    # claimed, and so kept it contradicts the fixes again from 228 to 238 s. Without the gate nothing is aligned anew,
    # and yaw is within 1.0 degrees from 230 s on
    for axis, (name, limit, first) in enumerate(
        (("roll_deg", 1.3, 230.0), ("pitch_deg", 0.7, 230.0), ("yaw_deg", 1.0, 270.0))
    ):
        keep = (onboard["t_s"] > first) & (onboard["t_s"] < 570.0)
        ours = np.degrees(np.unwrap(result["/filter/attitude_rpy"][:, axis]))
        there = np.interp(onboard["t_s"][keep], result["/filter/time"], ours)
        difference = (there - onboard[name][keep] + 180.0) % 360.0 - 180.0
        assert np.round(rms(difference - np.median(difference)), 1) <= limit, name


def test_thor_drift_without_fixes(thor: tuple[Result, Any]) -> None:
    result, _ = thor
    assert np.all(result["/summary/duration"] == [10.0, 30.0])
    assert np.all(result["/summary/drift_median"] <= [9.9, 108.0])
    assert np.all(result["/summary/drift_max"] <= [38.0, 264.0])


def test_comma_against_its_pose(shared: Path, tmp_path: Path) -> None:
    """A car, imported: standard deviations against the pose reference after ten seconds."""
    folder = shared / "data/comma2k19_ex1"
    log_files(read_logs([folder]), folder.name).write(tmp_path)
    result = flown(tmp_path / "log.yaml")
    assert 0.7 < result["/summary/nis"][1] < 1.4
    from scipy.spatial.transform import Rotation

    time = np.load(folder / "global_pose_frame_times.npy")
    t = result["/filter/time"]
    keep = (time > t[0] + 10.0) & (time < t[-1])
    pose = {
        n: np.load(folder / f"global_pose_frame_{n}.npy")[keep] for n in ("positions", "velocities", "orientations")
    }

    def at(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time[keep], t, values[:, i]) for i in range(3)], axis=1)

    c_ne = ned_matrix(llh_from_ecef(pose["positions"]))
    ours = at(ecef_from_llh(result["/filter/position_llh"]))
    position = np.einsum("nij,nj->ni", c_ne, ours - pose["positions"]).std(axis=0)
    velocity = (at(result["/filter/velocity_ned"]) - np.einsum("nij,nj->ni", c_ne, pose["velocities"])).std(axis=0)
    c_nb = c_ne @ Rotation.from_quat(pose["orientations"][:, [1, 2, 3, 0]]).as_matrix()
    there = Rotation.from_matrix(c_nb).as_euler("ZYX")[:, ::-1]
    turn = np.degrees((at(np.unwrap(result["/filter/attitude_rpy"], axis=0)) - there + np.pi) % (2 * np.pi) - np.pi)
    assert np.all(np.round(position[:2], 2) <= [0.20, 0.11])
    assert np.round(np.sqrt(np.mean(velocity[:2] ** 2)), 2) <= 0.04
    assert np.all(np.round(turn[:, :2].std(axis=0), 2) <= [0.13, 0.19])
    assert np.round(turn[:, 2].std(), 1) <= 1.0


def test_levelling_at_rest_with_a_known_heading(tmp_path: Path) -> None:
    """Standing still: roll and pitch from the accelerometers, gyro biases from the mean, the heading as given; without
    a heading there is nothing to find it from, and that is said."""
    rng = np.random.default_rng(2)
    roll, pitch, heading = np.radians([3.0, -5.0, 40.0])
    bias = np.array([0.002, -0.001, 0.003])
    up = 9.815 * np.array([np.sin(pitch), -np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)])
    time = np.arange(0.0, 60.0, 0.02)
    table = np.column_stack([time, bias + 1e-3 * rng.standard_normal((time.size, 3)),
                             up + 0.02 * rng.standard_normal((time.size, 3))])  # fmt: skip
    head = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(tmp_path / "imu.csv", table, "%.9f", ",", header=head, comments="")
    rows = [
        f"{t:.1f},{56.0 + 2e-7 * rng.standard_normal():.9f},37.0,100.0,0.01,-0.02,0.0" for t in np.arange(0.2, 60.0)
    ]
    (tmp_path / "gnss.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s", *rows]) + "\n")
    (tmp_path / "log.yaml").write_text("kind: replay\nversion: 1\nimu: {file: imu.csv}\ngnss: {file: gnss.csv}\n")
    given = ("tuning=none", "alignment={heading_deg: 40, heading_sigma_deg: 2}")
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", given))
    np.testing.assert_allclose(recording.alignment.gyro_bias, bias, atol=1e-4)
    result = replay.compute(recording)
    first = np.degrees(result["/filter/attitude_rpy"][5])
    assert np.all(np.abs(first - np.degrees([roll, pitch, heading])) < [0.1, 0.1, 1.0])
    with pytest.raises(replay.ReplayError, match="heading"):
        replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",)))


def test_derivatives_of_a_tuning_are_smooth(tmp_path: Path) -> None:
    """With a fix that the gate rejects, small changes of the settings are small changes of the likelihood."""
    write_flight(tmp_path, duration=60.0)
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    time, lat, rest = rows[60].split(",", 2)
    rows[60] = f"{time},{float(lat) + 0.01},{rest}"
    (tmp_path / "gnss.csv").write_text("\n".join([head, *rows]) + "\n")
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("checks=warn",)))
    search = TuningSearch(recording, lambda _: None)
    now = search.evaluate(recording.settings)
    assert np.flatnonzero(now.rejected).tolist() == [60]
    assert np.isnan(now.cost[60])
    step = np.where(np.arange(recording.settings.size) == 0, 1.01, 1.0)
    near = search.evaluate(recording.settings * step, near=now)
    assert near.flown.parts[0][1] == now.flown.parts[0][1]
    assert 0.1 < abs(now.excess(near)) < 10.0
    assert now.information([near], np.array([0.01]))[0, 0] > 10.0


def test_a_rejected_fix_counts_by_its_own_noise(tmp_path: Path) -> None:
    """In the tuning, where some fixes have a covariance and others not: settings that have a fix rejected never win,
    however much wider its own noise is than the usual."""
    write_flight(tmp_path)
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    own = [60.0, 60.0, 90.0, 6.0, 6.0, 9.0]
    spread = [",".join(map(str, own)) if i % 2 else ",,,,," for i in range(len(rows))]
    lines = [f"{head},{','.join(FIX_SIGMAS)}", *(f"{row},{more}" for row, more in zip(rows, spread, strict=True))]
    (tmp_path / "gnss.csv").write_text("\n".join(lines) + "\n")
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=likelihood",)))
    settings = recording.settings
    flight = recording.flight(settings)
    counts, limit = recording.of_rejected(settings, flight), gate_limits(recording.scenario.filter.gate.probability)[6]
    has_own = np.isfinite(flight.covariance[:, 0, 0])
    assert 10 < has_own.sum() < flight.arrival.size - 10
    np.testing.assert_allclose(counts[has_own], 0.5 * limit + np.sum(np.log(own)))
    usual = np.sum(np.log(recording.fix_sigma(settings)))
    np.testing.assert_allclose(counts[~has_own], 0.5 * limit + usual)
    assert np.sum(np.log(own)) > usual + 10.0
    # the same flight, one of whose fixes of its own noise is rejected
    seen = simulated.fly(flight, recording.design(settings, TFG), recording.fix_sigma(settings), np.empty(0))
    one = int(np.flatnonzero(has_own & (seen.degrees == 6))[10])
    status, rejected = seen.status.copy(), seen.rejected.copy()
    status[one], rejected[one] = REJECTED, 1
    every = np.ones(flight.arrival.size, bool)
    without = replace(seen, status=status, rejected=rejected)
    assert without.surprise(every, counts) > seen.surprise(every, counts)


@pytest.mark.parametrize(("fixes", "nis", "told"), [
    (1, (3.17, 4.0, 3.17), None), (50, (3.17, 3.0, 3.4), ""), (50, (2.1, 4.0, 0.2), "position"),
    (50, (2.1, 0.2, 4.0), "velocity"), (50, (1.7, 1.7, 1.7), None),
])  # fmt: skip
def test_a_few_large_innovations_are_no_finding(fixes: int, nis: tuple[float, ...], told: str | None) -> None:
    """Many of positions, or of velocities, are: each by itself."""
    result = {
        "/innovations/degrees": np.full(200, 6), "/summary/motion": np.array(["all", "straight"], dtype=object),
        "/summary/degrees_of_freedom": np.array([1200, 6 * fixes]), "/summary/motion_fixes": np.array([200, fixes]),
        **{f"/summary/nis{of}": np.array([1.05, each])
           for of, each in zip(("", "_position", "_velocity"), nis, strict=True)},
    }  # fmt: skip
    found = _inconsistent(result)
    assert [f"the {told} innovations of".replace("  ", " ") in one.text for one in found] == [True] * (told is not None)
    assert not any("position" in one.text for one in _inconsistent(result, of_positions=False))


@pytest.mark.parametrize(("position", "fixes", "origin", "told"), [
    (1.68, 100, "2.5 s times the velocity sigma", True), (1.68, 10, "2.5 s times the velocity sigma", True),
    (0.5, 100, "2.5 s times the velocity sigma", False), (1.68, 100, "given", False),
])  # fmt: skip
def test_positions_that_scatter_more_than_their_tied_sigma_are_told(
    position: float, fixes: int, origin: str, told: bool
) -> None:
    values = {
        "/tuning/position_sigma_horizontal": 0.24, "/tuning/position_sigma_vertical": 0.44,
        "/summary/motion": np.array(["all", "moving"]), "/summary/nis_position": np.array([1.0, position]),
        "/summary/nis_velocity": np.array([1.0, 0.27]), "/innovations/degrees": np.full(100, 6),
        "/summary/motion_fixes": np.array([100, fixes]),
    }  # fmt: skip
    result = Result({}, {path: Variable((), data, "", "", {"origin": origin}) for path, data in values.items()})
    found = _tied(result)
    assert bool(found) is told
    assert not told or found[0].text.endswith("gnss.position_sigma_m: [0.31, 0.57]")  # sigma times the root of NIS
    assert not told or bool(found[0].against) is (fixes == 100)  # of ten fixes chance explains it
    result.variables["/summary/bet_until"] = Variable((), np.float64(1600000070.0), "", "")
    # values of what was predicted would be no test; times may be those since 1970
    assert not told or "(--set end_s=1600000070)" in _tied(result)[0].text


@pytest.mark.parametrize(("nis", "fixes", "told"), [(0.24, 100, True), (0.24, 3, False), (0.7, 1000, False)])
def test_untuned_noise_that_is_too_large_is_told(nis: float, fixes: int, told: bool) -> None:
    result = {
        "/innovations/degrees": np.full(fixes, 6), "/summary/motion": np.array(["all", "moving"], dtype=object),
        "/summary/degrees_of_freedom": np.array([12 * fixes, 6 * fixes]), "/summary/nis": np.array([1.0, nis]),
    }  # fmt: skip
    assert [each.against for each in _too_calm(result)] == [()] * told
