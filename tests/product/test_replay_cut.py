"""Recordings of which little is left: short files, filtered rows, spans that hold nothing. Each ends in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.formats.conventions import GnssConvention
from navsim.formats.recording import read_fixes, read_imu
from navsim.recording_checks.diagnosis import diagnose
from navsim.recording_checks.mistakes import Log
from tests.conftest import SCENARIOS
from tests.mistakes import MISTAKES, Made
from tests.product.test_fuzz_readers import sentence
from tests.recordings import circuit, record, sentences_of

SHIPPED = SCENARIOS / "recorded_flight.yaml"


def replayed(folder: Path, *assignments: str) -> tuple[int, str]:
    """Exit code of a dry run of the shipped flight with keys set, and what it said."""
    keys = [word for assignment in assignments for word in ("--set", assignment)]
    run = CliRunner().invoke(app, ["replay", str(SHIPPED), "--dry-run", "-o", str(folder / "out.h5"), *keys])
    assert run.exception is None or isinstance(run.exception, SystemExit), run.exception
    return run.exit_code, run.output


@pytest.mark.parametrize("last", [2.0, 5.0, 12.0, 16.3, 30.7, 30.9, 31.2, 45.0, 46.5])
def test_a_flight_of_any_length_is_judged(last: float) -> None:
    """With two windows no clock offset outside of those tolerated can be judged."""
    samples = read_imu(SCENARIOS / "data" / "flight_imu.csv.gz")[0]
    fixes = read_fixes(SCENARIOS / "data" / "flight_gnss.csv")[0]
    log = Log(samples.between(-np.inf, last), fixes.take(fixes.time <= last))
    assert diagnose(log) == []


def test_positions_that_nothing_explains() -> None:
    """Latitudes over 90 degrees in every unit, and positions that contradict the velocities in every unit."""
    samples = read_imu(SCENARIOS / "data" / "flight_imu.csv.gz")[0]
    fixes = read_fixes(SCENARIOS / "data" / "flight_gnss.csv")[0]
    far = replace(fixes, llh=fixes.llh * [3.0, 10.0, 1.0])
    unknown = replace(far, velocity=np.full_like(far.velocity, np.nan))
    as_written = GnssConvention(angle_unit="1e-7 deg")
    (found,) = diagnose(Log(samples, unknown, gnss=as_written))
    assert str(found) == "latitudes reach 168.087 degrees: no known unit of the angles explains it"
    assert found.section == "gnss"
    wild = replace(fixes, velocity=5.0 * np.random.default_rng(3).permuted(fixes.velocity, axis=0))
    (found,) = diagnose(Log(samples, wild))
    assert str(found).endswith("position and velocity contradict each other")


@pytest.mark.parametrize(
    ("assignments", "expected"),
    [
        (("start_s=1e6",), "start_s: 1000000 leaves 0 samples and 0 fixes; needed are 10 and 4 (samples 0.0 to"),
        (("end_s=2", "checks=off"), "end_s: 2 leaves 100 samples and 3 fixes; needed are 10 and 4"),
        (("end_s=0.3",), "end_s: 0.3 leaves"),
        (("start_s=90", "end_s=91"), "end_s: 91 leaves"),
        (("gnss.spacing_s=50",), "gnss.spacing_s: 50 leaves 3 fixes; needed are 4"),
        (("gnss.time_offset_s=1e5", "checks=warn"), "gnss.time_offset_s: the recordings have no common time (samples"),
        (("gnss.time_offset_s=119", "checks=off"), "gnss.time_offset_s: the recordings have in common only"),
    ],
)
def test_too_little_in_common_is_wrong_input(assignments: tuple[str, ...], expected: str, tmp_path: Path) -> None:
    code, said = replayed(tmp_path, *assignments)
    assert expected in said
    assert code == 2
    assert ("no common time" in said) == ("no common time" in expected)


def test_the_key_to_blame_is_named(tmp_path: Path) -> None:
    """Both ends where each alone leaves enough, else the one that does not."""
    _, said = replayed(tmp_path, "start_s=90", "end_s=91")
    assert "start_s: 90 leaves" in said
    assert "end_s: 91 leaves" in said
    _, said = replayed(tmp_path, "start_s=119.8", "end_s=119.9")
    assert "start_s: 119.8 leaves" in said
    assert "end_s: " not in said


@pytest.mark.parametrize("unit", ["m/s", "km/h"])
def test_speeds_of_sentences_have_no_key(unit: str, tmp_path: Path) -> None:
    """What a receiver writes in another unit than NMEA's is said; no key is proposed that is refused."""
    sentences = sentences_of(SCENARIOS / "data" / "flight_gnss.csv", speed_unit=unit)
    (tmp_path / "fixes.nmea").write_text("\r\n".join(sentences))
    code, said = replayed(tmp_path, f"gnss.file={tmp_path / 'fixes.nmea'}")
    assert code == 2
    assert f"the sentences seem to give speeds as if {unit} were due, not kn (" in said
    assert "; write" not in said


def test_sentences_in_order_raise_no_alarm(tmp_path: Path) -> None:
    (tmp_path / "fixes.nmea").write_text("\r\n".join(sentences_of(SCENARIOS / "data" / "flight_gnss.csv")))
    code, said = replayed(tmp_path, f"gnss.file={tmp_path / 'fixes.nmea'}")
    assert (code, "warning" in said) == (0, False)
    code, said = replayed(tmp_path, f"gnss.file={tmp_path / 'fixes.nmea'}", "gnss.time_offset_s=5")
    assert code == 2
    assert "write `gnss: {time_offset_s: " in said


def as_kind(line: str, quality: int, mode: str) -> str:
    """A sentence of `sentences_of` whose receiver says that it got the position in another way."""
    body = line[1:-3].split(",")
    body[6 if body[0] == "GPGGA" else -1] = str(quality) if body[0] == "GPGGA" else mode
    return sentence(",".join(body)).strip()


def test_only_what_a_receiver_measured_is_flown(tmp_path: Path) -> None:
    """Its dead reckoning and a simulator's fixes are left out and counted; the latter are taken when asked for."""
    whole = sentences_of(SCENARIOS / "data" / "flight_gnss.csv")
    mixed = list(whole)
    mixed[300:306] = [as_kind(line, 6, "E") for line in whole[300:306]]
    mixed[400:408] = [as_kind(line, 8, "S") for line in whole[400:408]]
    (tmp_path / "fixes.nmea").write_text("\r\n".join(mixed))
    fixes = f"gnss.file={tmp_path / 'fixes.nmea'}"
    code, said = replayed(tmp_path, fixes)
    assert code == 0, said
    assert f" {len(whole) // 2 - 8} fixes" in said
    assert "3 NMEA epochs of the receiver's own dead reckoning (quality 6 or mode E)" in said
    assert "4 NMEA epochs of a simulator" in said
    assert "`gnss.simulator_fixes: true`" in said
    code, said = replayed(tmp_path, fixes, "gnss.simulator_fixes=true")
    assert (code, "simulator" in said) == (0, False)
    assert f" {len(whole) // 2 - 4} fixes" in said


OF_FIXES = [made for made in MISTAKES if next(iter(made.remedy)).startswith("gnss.")]
VERTICAL = {"vertical velocity in km/h", "vertical velocity in ft/min", "climb in ft/min"}
UNSEEN = {"height in feet", "heights and climbs in feet", "vertical sign", *VERTICAL}
"""Those that fixes without a vertical velocity do not show, of tables either."""


@pytest.mark.parametrize("made", OF_FIXES[::3], ids=lambda made: made.name)
def test_no_key_of_tables_is_proposed_for_sentences(made: Made) -> None:
    """Whatever is wrong with fixes without a vertical velocity."""
    samples, fixes = record(circuit(), 1, velocities="horizontal")
    wrong = made.make(samples, fixes)
    of_table = {key for mistake in diagnose(Log(*wrong)) for remedy in mistake.remedies for key in remedy}
    assert bool(of_table & made.remedy.keys()) == (made.name not in UNSEEN)
    for mistake in diagnose(Log(*wrong, sentences=True)):
        keys = {key for remedy in mistake.remedies for key in remedy if key.startswith("gnss.")}
        assert keys <= {"gnss.time_offset_s"}, mistake
