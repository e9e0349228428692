"""Recorded flights that begin with a known state, and fixes whose covariance stands in the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.replays import study as replay
from navsim.replays.reading import read as read_log
from navsim.results import findings
from navsim.results.result import Result
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from tests.consistency.test_replay import errors, flown
from tests.recordings import LATENCY, write_flight

FIXED = ("tuning=none", f"gnss.latency_s={LATENCY}", "checks=off")
SIGMAS = ("sigma_n_m", "sigma_e_m", "sigma_d_m", "sigma_vn_m_s", "sigma_ve_m_s", "sigma_vd_m_s")


def known(truth: tuple[np.ndarray, ...], at: float, **changes: object) -> str:
    """The key for the true state at a time."""
    time, llh, velocity, rpy = truth
    k = int(np.searchsorted(time, at - 1e-9))
    section = {
        "time_s": float(time[k]), "lat_deg": float(np.degrees(llh[k, 0])), "lon_deg": float(np.degrees(llh[k, 1])),
        "height_m": float(llh[k, 2]), "velocity_m_s": velocity[k].tolist(),
        "attitude_deg": np.degrees(rpy[k]).tolist(), "position_sigma_m": [0.1] * 3, "velocity_sigma_m_s": [0.05] * 3,
        "attitude_sigma_deg": [0.1, 0.1, 0.2], **changes,
    }  # fmt: skip
    return "alignment.known={" + ", ".join(f"{key}: {value}" for key, value in section.items()) + "}"


def with_columns(folder: Path, columns: dict[str, list[str]]) -> None:
    """Add columns to the table of fixes."""
    head, *rows = (folder / "gnss.csv").read_text().splitlines()
    cells = [",".join([row, *(column[k] for column in columns.values())]) for k, row in enumerate(rows)]
    (folder / "gnss.csv").write_text("\n".join([",".join([head, *columns]), *cells]) + "\n")


def count(folder: Path) -> int:
    return len((folder / "gnss.csv").read_text().splitlines()) - 1


@pytest.mark.parametrize("at", [0.02, 30.0])
def test_a_flight_begins_with_the_state_that_is_known(at: float, tmp_path: Path) -> None:
    """At its time, with its values and sigmas, and nothing is aligned."""
    truth = write_flight(tmp_path, duration=60.0)
    log = tmp_path / "log.yaml"
    result = flown(log, *FIXED, known(truth, at), "filter.output_rate_hz=fixes", "gnss.velocity_sigma_m_s=[0.1, 0.1]")
    assert result["/filter/time"][0] == pytest.approx(at, abs=1e-9)
    position, velocity, attitude = errors(result, truth)
    assert np.abs(position[0]).max() < 1e-6
    assert np.abs(velocity[0]).max() < 1e-9
    assert np.abs(attitude[0]).max() < 1e-9
    sigma = result["/filter/sigma"][0]
    np.testing.assert_allclose(sigma[:9], [0.1] * 3 + [0.05] * 3 + np.radians([0.1, 0.1, 0.2]).tolist(), rtol=1e-12)
    claimed = np.degrees(np.linalg.norm(result["/filter/sigma"][:, 6:9], axis=1))
    assert np.all(np.linalg.norm(attitude, axis=1) < 3.0 * claimed)
    assert 0.5 < result["/summary/nis"][0] < 1.5
    fixes = result["/innovations/time"]
    assert fixes[0] == pytest.approx(np.ceil((at + 1e-6) / 0.5) * 0.5 + LATENCY, abs=1e-3)
    np.testing.assert_allclose(result["/filter/time"][1:], fixes)
    assert not [found for found in findings.of(result) if "not flown" in found.text]


def test_a_known_start_is_at_a_time_of_the_recording(tmp_path: Path) -> None:
    truth = write_flight(tmp_path, duration=30.0)
    log = tmp_path / "log.yaml"
    for assignments, key, words in (
        ((known(truth, 1.0, time_s=-5.0),), "alignment.known.time_s", "before the first sample"),
        ((known(truth, 1.0, time_s=500.0),), "alignment.known.time_s", "500 leaves"),
        ((known(truth, 1.0), "start_s=2"), "start_s", "leave one of them out"),
        ((known(truth, 1.0), "end_s=0.5"), "end_s", "after alignment.known.time_s"),
        ((known(truth, 1.0), "alignment.heading_deg=30"), "alignment.heading_deg", "leave one of them out"),
        ((known(truth, 1.0, attitude_sigma_deg=[1, 1]),), "alignment.known.attitude_sigma_deg", ""),
    ):
        with pytest.raises(InputError) as refused:
            flown(log, *FIXED, *assignments)
        assert key in str(refused.value)
        assert words in str(refused.value)


def test_fixes_are_weighed_by_their_own_covariance(tmp_path: Path) -> None:
    """As by the same sigmas of all fixes; fixes without any have those of the log."""
    truth = write_flight(tmp_path, duration=30.0)
    log, start = tmp_path / "log.yaml", known(truth, 0.02)
    given = ("gnss.position_sigma_m=[0.3, 0.4]", "gnss.velocity_sigma_m_s=[0.1, 0.2]")
    usual = flown(log, *FIXED, start, *given)
    m = count(tmp_path)
    own = [["" if k % 3 == 2 else s for k in range(m)] for s in ("0.3", "0.3", "0.4", "0.1", "0.1", "0.2")]
    with_columns(tmp_path, dict(zip(SIGMAS, own, strict=True)))
    mixed = flown(log, *FIXED, start, *given)
    other = flown(log, *FIXED, start, "gnss.position_sigma_m=[3, 4]", "gnss.velocity_sigma_m_s=[1, 2]")
    for path in ("/innovations/position_ned_sigma", "/filter/position_llh", "/filter/sigma"):
        np.testing.assert_allclose(mixed[path], usual[path], rtol=1e-9)
        assert np.abs(other[path] / usual[path] - 1.0).max() > 1e-9


def test_correlations_of_a_fix_count(tmp_path: Path) -> None:
    """Sigmas and correlations of errors that are 3 m to the north-east and 0.3 m across: the innovations have those
    sigmas along both."""
    truth = write_flight(tmp_path, duration=30.0)
    m = count(tmp_path)
    long, short = 9.0, 0.09
    both = np.sqrt(0.5 * (long + short))
    columns = {name: [f"{both:.12f}"] * m for name in SIGMAS[:2]} | {SIGMAS[2]: ["1"] * m}
    columns["corr_n_e"] = [f"{(long - short) / (long + short):.12f}"] * m
    with_columns(tmp_path, columns)
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", (*FIXED, known(truth, 0.02))))
    covariance = recording.flight(recording.settings).covariance
    along, across = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0), np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(along @ covariance[:, :3, :3] @ along, long, rtol=1e-9)
    np.testing.assert_allclose(across @ covariance[:, :3, :3] @ across, short, rtol=1e-9)
    assert np.isnan(covariance[:, 3:]).all()
    result = replay.compute(recording)
    first = result["/innovations/position_ned_sigma"][0, :2]
    assert np.all((first > both) & (first < np.hypot(both, 1.0)))


def test_sigmas_of_the_table_are_not_tuned(tmp_path: Path) -> None:
    truth = write_flight(tmp_path, duration=60.0)
    m = count(tmp_path)
    with_columns(tmp_path, {name: ["0.3" if k < 3 else "0.1"] * m for k, name in enumerate(SIGMAS)})
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", (known(truth, 0.02),)))
    assert recording.free.tolist() == [2, 3, 4]
    only = ("tuning=none", known(truth, 0.02), f"gnss.latency_s={LATENCY}")
    result = flown(tmp_path / "log.yaml", *only)
    assert origin(result, "velocity_sigma_horizontal") == "not used: each fix has its own"
    assert 0.7 < result["/summary/nis"][0] < 1.4


def origin(result: Result, name: str) -> str:
    return str(result.variables[f"/tuning/{name}"].attributes["origin"])


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"sigma_n_m": "1", "sigma_e_m": "1"}, "give all of sigma_n_m, sigma_e_m, sigma_d_m, or none"),
        (dict.fromkeys(SIGMAS[:3], "-1"), "sigma_n_m"),
        (dict.fromkeys(SIGMAS[:3], "1") | {"corr_n_e": "2"}, "corr_n_e"),
        (
            dict.fromkeys(SIGMAS[:3], "1") | {"corr_n_e": "0.9", "corr_n_d": "0.9", "corr_e_d": "-0.9"},
            "the correlations corr_n_e, corr_n_d, corr_e_d of this fix are impossible",
        ),
    ],
)
def test_a_table_of_no_covariance_is_refused(columns: dict[str, str], words: str, tmp_path: Path) -> None:
    """With its line; a lenient reader leaves the row out."""
    write_flight(tmp_path, duration=30.0)
    m = count(tmp_path)
    with_columns(tmp_path, {name: ["" if k != 5 else value for k in range(m)] for name, value in columns.items()})
    with pytest.raises(InputError, match=r"gnss\.csv:7:") as refused:
        flown(tmp_path / "log.yaml", *FIXED)
    assert words in str(refused.value)
    log, document = read_replay(tmp_path / "log.yaml", (*FIXED, "skip_bad_records=true"))
    read = read_log(log, document)
    assert read.fixes.time.size == m - 1
    assert any("1 rows left out" in text for text in read.warnings)


def test_lasting_errors_of_fixes_are_states(tmp_path: Path) -> None:
    """All fixes off by the same metres: a filter that takes their errors for noise is sure of a wrong position, one
    that follows what lasts of them knows how little it knows, from an alignment and from a known state."""
    truth = write_flight(tmp_path, duration=60.0)
    north, east, down = 5.0, -4.0, 6.0
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    shifted = []
    for row in rows:
        t, lat, lon, height, *velocity = row.split(",")
        place = float(lat) + north / 111.3e3, float(lon) + east / (111.3e3 * np.cos(np.radians(float(lat))))
        shifted.append(",".join([t, *(f"{angle:.10f}" for angle in place), f"{float(height) - down:.4f}", *velocity]))
    (tmp_path / "gnss.csv").write_text("\n".join([head, *shifted]) + "\n")
    given = (*FIXED, "gnss.velocity_sigma_m_s=[0.1, 0.1]", "gnss.position_sigma_m=[0.3, 0.3]")
    lasting = "gnss.errors=[{correlation_time_s: 1000, position_sigma_m: [4, 5]}]"
    for start, assignments in (("aligned", ()), ("known", (known(truth, 0.02, position_sigma_m=[20, 20, 20]),))):
        ratio = {}
        for way, errors_of_fixes in (("noise", ()), ("states", (lasting,))):
            result = flown(tmp_path / "log.yaml", *given, *assignments, *errors_of_fixes)
            position, _, _ = errors(result, truth)
            late = result["/filter/time"] > 20.0
            ratio[way] = np.abs(position[late] / result["/filter/sigma"][late, :3]).max()
        assert ratio["noise"] > 10.0, start
        assert ratio["states"] < 2.5, start
        sigma = result["/filter/sigma"][late]
        assert result["/filter/state"][15:].tolist() == [f"fix_error_1_{axis}" for axis in ("north", "east", "down")]
        np.testing.assert_allclose(sigma[:, :3], np.tile([4.0, 4.0, 5.0], (late.sum(), 1)), rtol=0.1)
        np.testing.assert_allclose(sigma[:, 15:], 1.0, rtol=0.1)


def test_lasting_errors_need_sigmas_or_columns(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=30.0)
    for errors_, words in (
        ("[{correlation_time_s: 100}]", "give one of position_sigma_m and states"),
        ("[{correlation_time_s: 100, position_sigma_m: [1, 1], states: 3}]", "give one of position_sigma_m and states"),
        ("[{correlation_time_s: 100, states: 3}]", "the header lacks error1_n, error1_e, error1_d, error1_vn"),
    ):
        with pytest.raises(InputError) as refused:
            flown(tmp_path / "log.yaml", *FIXED, f"gnss.errors={errors_}")
        assert words in str(refused.value)
