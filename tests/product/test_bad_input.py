# ruff: noqa: E501 - the table of cases reads best with a case a line
"""Every wrong input ends with exit code 2, one clear message with place and key, and no harm done."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from tests import forks
from tests.conftest import SCENARIOS

LANDING = (SCENARIOS / "landing.yaml").read_text()


def navsim(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forks.navsim(*arguments, cwd=cwd, code=None)


def line_of(text: str, start: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if line.strip().startswith(start))


def replaced(old: str, new: str) -> str:
    assert LANDING.count(old) == 1, f"{old!r} stands {LANDING.count(old)} times"
    return LANDING.replace(old, new)


def at(old: str, new: str) -> tuple[str, str]:
    """The scenario with one line changed, and the `file:line` that its message must name."""
    text = replaced(old, new)
    changed = next(
        i for i, (a, b) in enumerate(zip(text.splitlines(), [*LANDING.splitlines(), ""], strict=False), 1) if a != b
    )
    return text, f"s.yaml:{changed}:"


# name, (old text, new text), what the message must say
CASES: list[tuple[str, tuple[str, str], list[str]]] = [
    ("misspelt key at the root", ("duration_s: 120", "duratoin_s: 120"), ["duratoin_s", "unknown key", "'duration_s'"]),
    ("misspelt key in a section", ("  glide_slope_deg: 5", "  glideslope_deg: 5"), ["approach.glideslope_deg", "did you mean 'glide_slope_deg'"]),
    ("misspelt key two levels down", ("  preset: paper ", "  gyro: {drift_deg_hr: 700}\n  preset: paper "), ["imu.gyro.drift_deg_hr", "did you mean 'drift_deg_h'"]),
    ("fraction for a choice", ("  count: 2  ", "  count: 2.0"), ["pseudolites.count", "expected a whole number"]),
    ("key of the other profile", ("  transition_time_s: 0.5", "  flare_height_m: 6"), ["approach.flare_height_m", "unknown key"]),
    ("wrong unit in a key", ("  speed_start_kmh: 130", "  speed_start_ms: 36"), ["approach.speed_start_ms", "speed_start_kmh"]),
    ("duplicate key", ("duration_s: 120", "duration_s: 120\nduration_s: 60"), ["duration_s", "duplicate key", "on line"]),
    ("duplicate key in a section", ("  mask_deg: 5", "  mask_deg: 5\n  mask_deg: 7"), ["sky.mask_deg", "duplicate key", "on line"]),
    ("negative sigma", ("  range_sigma_m: 2.23606797749979\n  range_rate_sigma_m_s: 0.1\n\nsignals", "  range_sigma_m: -2\n  range_rate_sigma_m_s: 0.1\n\nsignals"), ["pseudolites.range_sigma_m", "must be at least 1e-09 m", "-2"]),
    ("text for a number", ("duration_s: 120", "duration_s: two minutes"), ["duration_s", "number", "two minutes"]),
    ("YAML 1.1 boolean", ("  velocity: true", "  velocity: yes"), ["filter.velocity", "expected true or false", "yes"]),
    ("zero duration", ("duration_s: 120", "duration_s: 0"), ["duration_s", "must be above 0 s"]),
    ("shorter than two samples", ("duration_s: 120", "duration_s: 0.011"), ["duration_s", "samples"]),
    ("latitude out of range", ("{lat_deg: 56,", "{lat_deg: 156,"), ["approach.start.lat_deg", "89"]),
    ("unknown profile", ("  profile: paper ", "  profile: papre "), ["approach.profile", "papre", "did you mean 'paper'"]),
    ("unknown kind", ("kind: landing", "kind: landnig"), ["kind", "did you mean 'landing'"]),
    ("another version", ("version: 1", "version: 2"), ["version", "allowed: 1"]),
    ("epoch without zone", ("epoch: 2018-09-13T12:00:00Z", "epoch: 2018-09-13"), ["epoch", "2018-09-13T12:00:00Z"]),
    ("two spellings of one noise", ("  preset: paper ", "  gyro: {noise_deg_h: 30, arw_deg_sqrt_h: 0.05}\n  preset: paper "), ["imu.gyro.arw_deg_sqrt_h", "two spellings"]),
    ("mask above the upper one", ("  mask_deg: 5", "  mask_deg: 50\n  mask_upper_deg: 40"), ["sky.mask_deg", "below mask_upper_deg"]),
    ("list of the wrong length", ("  lever_arm_m: [0, 0, 0] ", "  lever_arm_m: [0, 0] "), ["receiver.lever_arm_m", "too short"]),
    ("pseudolite without place", ("  s_m: 200\n", ""), ["pseudolites.s_m", "needs both"]),
    ("three by count", ("  count: 2 ", "  count: 3 "), ["pseudolites.count", "3 is not allowed", "`sites:"]),
    ("almanac without a file name", ("  source: nominal-glonass ", "  source: almanac "), ["sky.almanac", "file name"]),
    ("almanac that is not there", ("  source: nominal-glonass ", "  almanac: no/such.agl\n  source: almanac "), ["sky.almanac", "no/such.agl", "cannot be read"]),
    ("start and threshold", ("  height_m: 0  ", "  threshold: {lat_deg: 56, lon_deg: 37}\n  height_m: 0  "), ["approach.start", "exactly one"]),
]  # fmt: skip
ELSEWHERE = {
    "pseudolite without place", "almanac without a file name", "almanac that is not there", "duplicate key",
    "duplicate key in a section", "start and threshold",
}  # fmt: skip
"""Cases reported at another line than the first changed one: that of the section, or the second of two."""


@pytest.fixture
def open_executor(tmp_path: Path) -> Path:
    """A folder with an earlier result that nothing may touch."""
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "s.h5").write_bytes(b"earlier result")
    return tmp_path


def assert_refused(done: subprocess.CompletedProcess[str], open_executor: Path, fragments: list[str]) -> None:
    print(done.stderr, end="")
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    for fragment in fragments:
        assert fragment in done.stderr, f"{fragment!r} is missing in:\n{done.stderr}"
    assert (open_executor / "results" / "s.h5").read_bytes() == b"earlier result"


@pytest.mark.parametrize(("name", "change", "fragments"), CASES, ids=[c[0] for c in CASES])
def test_scenario_refused(name: str, change: tuple[str, str], fragments: list[str], open_executor: Path) -> None:
    text, place = at(*change)
    (open_executor / "s.yaml").write_text(text)
    done = navsim("validate", "s.yaml", cwd=open_executor)
    assert_refused(done, open_executor, ["s.yaml:" if name in ELSEWHERE else place, *fragments])


def test_several_files_are_checked_each(open_executor: Path) -> None:
    """Those that are right are told of beside those that are not; what no file says is told with the file's name."""
    (open_executor / "s.yaml").write_text(LANDING)
    (open_executor / "wrong.yaml").write_text(LANDING.replace("mask_deg: 5", "mask_deg: 500"))
    done = navsim("validate", "wrong.yaml", "s.yaml", "none.yaml", cwd=open_executor)
    assert done.returncode == 2
    assert done.stdout == "s.yaml: a valid scenario of kind landing\n"
    first, second = done.stderr.splitlines()
    assert first.startswith("error: wrong.yaml:")
    assert second.startswith("error: none.yaml: there is no such file")
    done = navsim("validate", "s.yaml", "s.yaml", "--set", "x=1", cwd=open_executor)
    assert done.stderr.count("error: s.yaml: --set x=1: x: unknown key") == 2


def test_several_mistakes_are_reported_together(open_executor: Path) -> None:
    text = LANDING.replace("duration_s: 120", "duratoin_s: 120").replace("mask_deg: 5", "mask_deg: 500")
    text = text.replace("  preset: paper ", "  accelerometer:\n    bias_mg: -1\n  preset: paper ")
    (open_executor / "s.yaml").write_text(text)
    done = navsim("validate", "s.yaml", cwd=open_executor)
    assert_refused(done, open_executor, ["duratoin_s", "sky.mask_deg", "imu.accelerometer.bias_mg"])
    assert done.stderr.count("error:") == 3
    places = [line_of(text, start) for start in ("duratoin_s", "bias_mg", "mask_deg")]
    reported = [int(line.split("s.yaml:")[1].split(":")[0]) for line in done.stderr.splitlines()]
    assert reported == sorted(places)


WHOLE_FILES: list[tuple[str, bytes, list[str]]] = [
    ("empty", b"", ["s.yaml:1:1", "empty"]),
    ("comments only", b"# nothing\n", ["s.yaml:1:1", "empty"]),
    ("not YAML", b"kind: landing\n  version: [1\n", ["s.yaml:2:", "not YAML"]),
    ("a list", b"- kind: landing\n", ["s.yaml:1:1", "mapping"]),
    ("binary", bytes(range(128, 256)), ["s.yaml", "not a text file"]),
    ("two documents", b"kind: landing\n---\nkind: landing\n", ["s.yaml:2:", "not YAML"]),
    ("no colon", b"kind: landing\npseudolites:\n  s_m 300\n  l1_m: 1\n", ["s.yaml:3:3", "there is no colon here"]),
    ("no colon in the first line", b"version 1\n\n# landing\nkind: landing\n", ["s.yaml:1:1", "no colon here"]),
    ("no colon in a list", b"kind: landing\nevents:\n  - what step\n    at_s: 3\n", ["s.yaml:3:3", "no colon here"]),
    ("two colons", b"version: 1\nkind: landing: 3\n", ["s.yaml:2:14", "mapping values are not allowed here"]),
    ("tabs", b"kind: landing\nrunway:\n\theading_deg: 0\n", ["s.yaml:3:", "not YAML", "write spaces"]),
]


@pytest.mark.parametrize(("name", "content", "fragments"), WHOLE_FILES, ids=[c[0] for c in WHOLE_FILES])
def test_file_refused(name: str, content: bytes, fragments: list[str], open_executor: Path) -> None:
    (open_executor / "s.yaml").write_bytes(content)
    assert_refused(navsim("validate", "s.yaml", cwd=open_executor), open_executor, fragments)


def test_folder_and_missing_file_refused(open_executor: Path) -> None:
    (open_executor / "folder.yaml").mkdir()
    assert_refused(navsim("run", "folder.yaml", cwd=open_executor), open_executor, ["folder.yaml", "this is a folder"])
    assert_refused(navsim("run", "none.yaml", cwd=open_executor), open_executor, ["none.yaml", "there is no such file"])


def near(text: str) -> str:
    return (
        text.replace("frame: table1", "frame: runway").replace("s_m: 200", "s_m: 1").replace("l1_m: 5000", "l1_m: 30")
    )


TOGETHER: list[tuple[str, Callable[[str], str], list[str]]] = [
    ("pseudolite inside the aircraft", near, ["s.yaml:", "pseudolites.s_m", "PL1", "10 m"]),
    ("fixes faster than the IMU", lambda t: t.replace("rate_hz: 10  ", "rate_hz: 100  ").replace("  rate_hz: 100\n", "  rate_hz: 50\n"), ["receiver.rate_hz", "faster than the IMU"]),
    ("aircraft that stops", lambda t: t.replace("profile: paper", "profile: smooth").replace("  transition_time_s: 0.5 ", "  speed_is: air\n  rollout_deceleration_m_s2: 3 "), ["approach.profile", "2 m/s", "speed_is: ground"]),
    ("flare higher than the glide", lambda t: t.replace("profile: paper", "profile: smooth").replace("  transition_time_s: 0.5 ", "  flare_height_m: 150 "), ["approach", "no path meets these numbers"]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "fragments"), TOGETHER, ids=[c[0] for c in TOGETHER])
def test_values_that_do_not_fit_together(
    name: str, change: Callable[[str], str], fragments: list[str], open_executor: Path
) -> None:
    text = change(LANDING)
    assert text != LANDING
    (open_executor / "s.yaml").write_text(text)
    assert_refused(navsim("validate", "s.yaml", cwd=open_executor), open_executor, fragments)


SETTINGS: list[tuple[str, list[str]]] = [
    ("sky.msak_deg=3", ["--set sky.msak_deg=3", "did you mean 'mask_deg'"]),
    ("sky.mask_deg", ["--set sky.mask_deg", "dotted.key=value"]),
    (
        "filter.imu={gyro: {markov_deg_h: 100}}",
        ["filter.imu.gyro.markov_time_s", "an exponentially correlated error needs its correlation time"],
    ),
    ("sky.mask_deg=[1", ["--set sky.mask_deg=[1", "not YAML"]),
    ("receiver.lever_arm_m.7=1", ["list of 3"]),
]


@pytest.mark.parametrize(("setting", "fragments"), SETTINGS, ids=[s[0] for s in SETTINGS])
def test_setting_refused(setting: str, fragments: list[str], open_executor: Path) -> None:
    (open_executor / "s.yaml").write_text(LANDING)
    assert_refused(navsim("validate", "s.yaml", "--set", setting, cwd=open_executor), open_executor, fragments)


ALMANAC = b"""13 09 2018    3600
 1   1  1  13 09 2018  0.955206250E+04  0.000000000E+00  0.000000000E+00 -0.305175781E-04
-0.9923382E+00  0.6754875E-02 -0.2874756E-01  0.4005432E-03 -0.2656180E+04  0.8544922E-03
"""
ALMANACS: list[tuple[str, bytes, list[str]]] = [
    ("cut in half", ALMANAC[: len(ALMANAC) * 3 // 4], ["a.agl:3", "expected 6 numbers"]),
    ("cut at a line", b"".join(ALMANAC.splitlines(True)[:2]), ["a.agl:2", "ends within a satellite"]),
    ("empty", b"", ["empty"]),
    ("another format", b"<html>\n<body>\n</body>\n", ["a.agl:1"]),
    (
        "YUMA cut short",
        b"******** Week 837 almanac for PRN-01 ********\nID: 01\nHealth: 000\n",
        ["a.agl:3", "too few lines"],
    ),
    ("garbled number", ALMANAC.replace(b"0.4005432E-03", b"0.40O5432E-03"), ["a.agl:3", "0.40O5432E-03"]),
    (
        "eccentricity of a comet",
        ALMANAC.replace(b"0.4005432E-03", b"0.9005432E+00"),
        ["a.agl:3", "eccentricity"],
    ),
    ("slot 99", ALMANAC.replace(b" 1   1  1", b"99   1  1"), ["a.agl:2", "slot"]),
    ("slot twice", ALMANAC * 2, ["a.agl:5", "twice"]),
    ("31 September", ALMANAC.replace(b"1  13 09 2018", b"1  31 09 2018"), ["a.agl:2", "no such date"]),
]


@pytest.mark.parametrize(("name", "content", "fragments"), ALMANACS, ids=[c[0] for c in ALMANACS])
def test_almanac_refused(name: str, content: bytes, fragments: list[str], open_executor: Path) -> None:
    (open_executor / "a.agl").write_bytes(content)
    (open_executor / "s.yaml").write_text(
        LANDING.replace("source: nominal-glonass", "almanac: a.agl\n  source: almanac")
    )
    done = navsim("run", "s.yaml", "-o", "results/new.h5", cwd=open_executor)
    assert_refused(done, open_executor, ["sky.almanac", *fragments])
    assert not (open_executor / "results" / "new.h5").exists()


def test_wrong_checksum_refused(open_executor: Path) -> None:
    (open_executor / "a.agl").write_bytes(ALMANAC)
    (open_executor / "s.yaml").write_text(
        LANDING.replace("source: nominal-glonass", f"almanac: a.agl\n  almanac_sha256: '{'0' * 64}'\n  source: almanac")
    )
    done = navsim("run", "s.yaml", "-o", "results/new.h5", cwd=open_executor)
    assert_refused(done, open_executor, ["sky.almanac", "checksum"])


def test_output_refused(open_executor: Path) -> None:
    (open_executor / "s.yaml").write_text(LANDING)
    (open_executor / "file").write_text("")
    with h5py.File(open_executor / "other.h5", "w") as other:
        other["x"] = 1.0
    (open_executor / "link.h5").symlink_to("nowhere/x.h5")
    for target, fragments in (
        ("no/such/folder/x.h5", ["no/such/folder", "no such folder"]),
        ("x.txt", ["x.txt", "a result is an HDF5 file", "write x.h5"]),
        ("file/x.h5", ["file"]),
        ("results", ["results", "this is a folder"]),
        ("/proc/x.h5", ["/proc", "cannot be written"]),
        ("results/s.h5", ["results/s.h5", "not a readable HDF5 file", "not overwritten"]),
        ("other.h5", ["other.h5", "not a navsim result", "not overwritten"]),
        (f"{250 * 'a'}.h5", ["aaa.h5: cannot be written: File name too long"]),
        ("link.h5", ["link.h5 ->", "nowhere/x.h5: results cannot be written there: No such file or directory"]),
    ):
        assert_refused(navsim("run", "s.yaml", "-o", target, cwd=open_executor), open_executor, fragments)
    with h5py.File(open_executor / "other.h5") as other:
        assert other["x"][()] == 1.0


def test_a_folder_for_a_result_is_made(tmp_path: Path) -> None:
    """As results/ is by default. Seen before: `-o results/x.h5` in an empty folder was refused."""
    (tmp_path / "s.yaml").write_text(LANDING)
    navsim("run", "s.yaml", "-o", "results/x.h5", "--figures", "none", "-q", cwd=tmp_path)
    assert (tmp_path / "results/x.h5").is_file()
    refused = navsim("run", "s.yaml", "-o", "folder/deeper/x.h5", cwd=tmp_path)
    assert "folder/deeper: no such folder" in refused.stderr
    assert not (tmp_path / "folder").exists()
    for name, command in {"s.yaml": ("init",), "e.h5": ("export", "results/x.h5", "--csv")}.items():
        navsim(*command, "-o", f"{name}_made/{name}", cwd=tmp_path)
        assert any((tmp_path / f"{name}_made").iterdir())
        refused = navsim(*command, "-o", f"folder/deeper/{name}", cwd=tmp_path)
        assert "folder/deeper: no such folder" in refused.stderr
    assert not (tmp_path / "folder").exists()
    navsim("evidence", "results/x.h5", cwd=tmp_path)
    assert (tmp_path / "results" / "x_evidence" / "x.h5").is_file()


@pytest.mark.parametrize("command", ["show", "plot", "report", "cite"])
def test_result_refused(command: str, open_executor: Path) -> None:
    with h5py.File(open_executor / "other.h5", "w") as other:
        other["x"] = 1.0
    damaged = bytearray((open_executor / "other.h5").read_bytes())
    damaged[96:400] = bytes(304)
    (open_executor / "damaged.h5").write_bytes(damaged)
    for name, fragments in (
        ("other.h5", ["other.h5", "not a navsim result"]),
        ("damaged.h5", ["damaged.h5", "damaged"]),
        ("results/s.h5", ["not a readable HDF5 file"]),
        ("none.h5", ["no such file"]),
        ("results", ["results"]),
    ):
        assert_refused(navsim(command, name, cwd=open_executor), open_executor, fragments)


@pytest.mark.parametrize("case", [("groups.speed.alpha_1_s=0.3",), ("groups.track.alpha_1_s=2", "further_cases=[]")])
def test_a_decay_within_a_scan_is_refused(case: tuple[str, ...], open_executor: Path) -> None:
    """It alternated, with negative variances."""
    words = [word for setting in case for word in ("--set", setting)]
    done = navsim("run", SCENARIOS / "atc_tracking.yaml", *words, cwd=open_executor)
    assert_refused(done, open_executor, [case[0].split("=")[0], "1 - alpha T"])


def test_options_refused(open_executor: Path) -> None:
    (open_executor / "s.yaml").write_text(LANDING)
    for options in (
        ["--runs", "0"],
        ["--seed", "-1"],
        ["--keep", "some"],
        ["--no-such-option"],
        ["--workers", "0"],
        ["--runs", "1_000"],
        ["--runs", "١"],
        ["--first-run", "1e3"],
        ["--seed", str(2**63)],
        ["--until", "rms_horizontal within 0%"],
    ):
        done = navsim("run", "s.yaml", *options, cwd=open_executor)
        assert_refused(done, open_executor, [options[0]])
    live = navsim("live", "s.yaml", "--silence", "nan", cwd=open_executor)
    assert_refused(live, open_executor, ["--silence", "expected a number from 0.1", "'nan'"])
    assert_refused(navsim("schema", "landnig", cwd=open_executor), open_executor, ["landing"])
    assert_refused(navsim("init", "nothing", cwd=open_executor), open_executor, ["landing"])
    assert_refused(navsim("init", "-o", "s.yaml", cwd=open_executor), open_executor, ["exists already"])
    assert (open_executor / "s.yaml").read_text() == LANDING
