"""Semi-physical runs: a stream in place of the receiver or of the IMU, whole and broken, over every kind of line."""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import time
import tty
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.cli.recorded import _ended_by_signals
from navsim.filter.estimate import estimate
from navsim.filter.measurement_kinds import FIX, Measurements
from navsim.filter.records import ImuData, schedule
from navsim.formats.export import export
from navsim.formats.stream import Lines, StreamError, open_source
from navsim.landing import study as landing
from navsim.live import session as flying
from navsim.live.session import Session
from navsim.replays.source_clock import start_time
from navsim.results.result import read
from navsim.runner.executor import threads
from navsim.sensors import imu
from navsim.simulation.measurement_tables import table_of_fixes
from navsim.simulation.measurements import measured, receiver_fixes
from navsim.statistics.random_streams import generator
from tests.forks import installed
from tests.helpers import SCENARIOS, case, in_brief
from tests.layout import as_declared
from tests.product.test_fuzz_readers import sentence

SHORT = ("receiver.rate_hz=2", "imu.rate_hz=20", "duration_s=60", "filter.velocity=true")
SCENARIO = ("live", str(SCENARIOS / "landing.yaml"), *(x for a in SHORT for x in ("--set", a)))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A landing, its result, and its fixes as lines of CSV and NMEA."""
    return written(case(*SHORT), tmp_path_factory.mktemp("live"))


@pytest.fixture(scope="module")
def circled(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The same of a circuit."""
    return written(case(*SHORT[:2], name="circuit"), tmp_path_factory.mktemp("circuit"))


def written(c: Any, folder: Path) -> Any:
    result = landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    export(result, folder / "r.h5", ["csv", "nmea"])
    return c, result, folder / "r_gnss.csv", folder / "r.nmea"


def lines_of(text: str) -> Lines:
    lines = Lines()
    lines.put(text.encode())
    lines.close()
    return lines


def test_the_simulators_own_fixes_give_the_simulated_run(flown: Any) -> None:
    """The chain cut at the receiver and put together again is the chain."""
    c, result, table, _ = flown
    session = Session(c, "receiver", 1)
    session.pump(lines_of(table.read_text()), 1.0)
    ours, theirs = session.filter.estimates(), result["/filter/error"][0, 1:]
    assert session.counts["used"] == theirs.shape[0]
    assert not session.counts["corrupt"] + session.counts["late"] + session.counts["lost"]
    np.testing.assert_allclose(ours["error"][:, :9], theirs[:, :9], atol=2e-3)
    np.testing.assert_allclose(ours["sigma"], result["/filter/sigma"][0, 1:], rtol=1e-2)


@pytest.mark.parametrize("how", in_brief(["states", "inflate"], 0))
def test_errors_that_last_are_followed_as_in_a_landing(how: str, tmp_path: Path) -> None:
    """By the geometry of the scenario's epoch; a table that does not say what they do to fixes is never read."""
    c = case(*SHORT, "signals.preset=open-sky", f"filter.fix_errors={how}")
    result = landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    export(result, tmp_path / "r.h5", ["csv"])
    session = Session(c, "receiver", 1)
    session.pump(lines_of((tmp_path / "r_gnss.csv").read_text()), 1.0)
    ours, theirs = session.filter.estimates(), result["/filter/error"][0, 1:]
    np.testing.assert_allclose(ours["error"][:, :9], theirs[:, :9], atol=2e-3)
    np.testing.assert_allclose(ours["sigma"], result["/filter/sigma"][0, 1:], rtol=1e-2)
    flight, one = session.filter.flight, np.zeros((1, 3))
    if how == "states":
        bare = Measurements.of({FIX: table_of_fixes(flight.design, one, one, np.eye(6)[None])})
        at = schedule(np.array([0.1]), (FIX, np.array([0.1]), np.array([0.1])))
        still = ImuData(np.array([0.0, 0.1]), one, one)
        with pytest.raises(ValueError, match="does not say what the errors do"):
            estimate(still, bare, at, session.filter.state, flight.model)


def test_fixes_that_cannot_be_weighed_are_no_result(flown: Any) -> None:
    c, _, table, _ = flown
    session = Session(c, "receiver", 1)
    session.noise[...] = np.diag([25.0, 25.0, 25.0, -1e9, -1e9, -1e9])
    session.pump(lines_of(table.read_text()), 1.0)
    assert "none of the 120 fixes could be used" in session.result().attributes["verdict"]


def test_a_header_names_the_columns(flown: Any) -> None:
    """A receiver's table has columns of its own in between; a header of other names is spoken of."""
    c, result, table, _ = flown
    head, *rows = table.read_text().splitlines()
    more = [f"{row.split(',', 1)[0]},319569.2,{row.split(',', 1)[1]}" for row in rows]
    session, ours, warned = flew(c, [head.replace("t_s,", "t_s,gps_tow_s,"), *more])
    np.testing.assert_allclose(ours["/innovations/time"], result["/geometry/time"], atol=1e-6)
    assert not warned
    said: list[str] = []
    session = Session(c, "receiver", 1, tell=said.append)
    session.take("t_s,latitude,longitude,h_m")
    assert said == [
        "warning: the header lacks lat_deg, lon_deg, vn_m_s, ve_m_s, vd_m_s; columns are taken in the order "
        "t_s, lat_deg, lon_deg, h_m, vn_m_s, ve_m_s, vd_m_s"
    ]


def test_nmea_in_place_of_the_receiver(flown: Any) -> None:
    c, result, _, nmea = flown
    session = Session(c, "receiver", 1)
    session.pump(lines_of(nmea.read_text()), 1.0)
    assert session.counts["used"] == result["/geometry/time"].size
    late = session.filter.estimates()["error"][-40:, :2]
    assert np.sqrt(np.mean(late**2)) < 5.0
    # a logger's lines: comments, times before the sentences, a fix without a height
    logged = [f"12:00:{k % 60:02d}.5 {line}" for k, line in enumerate(nmea.read_text().strip().split("\n"))]
    body = logged[9].split("$")[1].split("*")[0].split(",")
    body[9] = ""
    check = 0
    for character in ",".join(body):
        check ^= ord(character)
    logged[9] = f"rx1 ${','.join(body)}*{check:02X} end"
    wrapped = Session(c, "receiver", 1)
    wrapped.pump(lines_of("# logged\n" + "\n".join(logged) + "\n"), 1.0)
    assert body[0].endswith("GGA")
    assert wrapped.counts["no_height"] == 1
    assert wrapped.counts["used"] == session.counts["used"] - 1
    assert not wrapped.counts["corrupt"] + wrapped.counts["late"]
    # a line is lost in the air, one is garbled, one comes twice, one comes late
    broken = nmea.read_text().split("\n")
    broken[30] = broken[30].replace("3", "4", 1)
    del broken[60:63]
    broken[90:90] = broken[75:78]
    session = Session(c, "receiver", 1)
    session.pump(lines_of("\n".join(broken)), 1.0)
    assert session.counts["corrupt"] == 1
    assert session.counts["lost"] >= 1
    assert session.counts["late"] >= 1
    assert session.counts["used"] >= result["/geometry/time"].size - 4


def imu_rows(c: landing.Case, seed: int | None = None) -> list[str]:
    """Samples of the flight as rows: true ones, or those of the first run of a seed."""
    world = c.shared
    step = np.diff(world.imu_time)[:, None]
    dtheta, dv = world.dtheta, world.dv
    if seed is not None:
        dtheta, dv, _ = imu.simulate(generator(seed, 0, "imu"), dtheta, dv, step[0, 0], c.flight.gyro, c.flight.accel)
    rows = zip(world.imu_time[1:], dtheta / step, dv / step, strict=True)
    return [",".join(f"{x:.12g}" for x in (t, *w, *f)) for t, w, f in rows]


def test_an_imu_in_the_loop() -> None:
    """Perfect samples from outside, with a perfect start: the filter follows its fixes' noise; then a bad line."""
    perfect = ("imu.preset=perfect", "initial_errors={attitude_deg: 0.1, position_m: 1.0, velocity_m_s: 0.1}")
    c = case(*SHORT, *perfect)
    rows = imu_rows(c)
    session = Session(c, "imu", 1)
    session.pump(lines_of("t_s,gx,gy,gz,ax,ay,az\n" + "\n".join(rows) + "\n"), 1.0)
    assert session.counts["used"] == len(rows)
    error = session.filter.estimates()["error"]
    assert error.shape[0] == c.shared.signals.time.size
    assert np.sqrt(np.mean(error[-20:, :3] ** 2)) < 1.0
    broken = [*rows[:100], "nonsense", *rows[103:200], rows[150], rows[200][:20], *rows[201:]]
    session = Session(c, "imu", 1)
    session.pump(lines_of("\n".join(broken)), 1.0)
    assert session.counts["corrupt"] == 2
    assert session.counts["lost"] == 4
    assert session.counts["late"] == 1
    assert np.sqrt(np.mean(session.filter.estimates()["error"][-20:, :3] ** 2)) < 2.0


def navsim(*arguments: str, cwd: Path, text: str | None = None) -> subprocess.CompletedProcess[str]:
    command = [installed(), *arguments]
    return subprocess.run(command, cwd=cwd, input=text, capture_output=True, text=True, check=False, timeout=120)


def test_standard_input_and_files(flown: Any, tmp_path: Path) -> None:
    _, result, table, nmea = flown
    done = navsim(*SCENARIO, "--receiver", "-", "-o", "a.h5", "--json", cwd=tmp_path, text=table.read_text())
    assert done.returncode == 0, done.stderr
    counted = json.loads(done.stdout)["stream"]
    assert counted["used"] == result["/geometry/time"].size
    done = navsim(*SCENARIO, "--receiver", str(nmea), "-o", "b.h5", "--figures", "drawn", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "messages used" in done.stdout
    assert "verdict: flown" in done.stdout
    assert "12:00:00.000Z by the source's clock, by UTC and the scenario's epoch" in done.stderr
    as_declared(read(tmp_path / "b.h5"))
    shown = navsim("show", "b.h5", cwd=tmp_path)
    assert shown.stdout.splitlines() == done.stdout.splitlines()[:-2]
    assert list((tmp_path / "drawn").glob("b_*.png"))
    assert not list(tmp_path.glob("a_*.png"))
    before = (tmp_path / "b.h5").read_bytes()
    (tmp_path / "nothing.nmea").touch()
    failed = navsim(*SCENARIO, "--receiver", "nothing.nmea", "-o", "b.h5", cwd=tmp_path)
    assert failed.returncode == 3
    assert "b_failed.h5" in failed.stderr
    assert (tmp_path / "b.h5").read_bytes() == before, "what is no result does not take the place of one"
    (tmp_path / "b_failed.h5").write_text("somebody's notes")
    refused = navsim(*SCENARIO, "--receiver", "nothing.nmea", "-o", "b.h5", cwd=tmp_path)
    assert refused.returncode == 2
    assert "b_failed.h5" in refused.stderr
    assert (tmp_path / "b_failed.h5").read_text() == "somebody's notes"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_serial_device(tmp_path: Path) -> None:
    """A pseudo terminal stands for the device."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    with open_source(f"serial://{os.ttyname(slave)}?baud=115200") as lines:
        os.write(master, b"$GPGGA,1\r\n$GPGGA,2\r\npart")
        assert [lines.take(3.0), lines.take(3.0)] == ["$GPGGA,1", "$GPGGA,2"]
        assert lines.take(0.3) is None
        os.write(master, b"ial\n")
        assert lines.take(3.0) == "partial"
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    "source", ["udp://0.0.0.0", "gopher://x:1", "no/such/file", "serial:///dev/none", "tcp://localhost:1"]
)
def test_sources_that_cannot_be_opened(source: str) -> None:
    with pytest.raises(StreamError, match="cannot be opened"), open_source(source):
        pass


def test_a_silent_source_ends_the_run(flown: Any, tmp_path: Path) -> None:
    port = free_port()
    done = navsim(*SCENARIO, "--receiver", f"udp://127.0.0.1:{port}", "--silence", "1", "-o", "a.h5", cwd=tmp_path)
    assert done.returncode == 3
    assert "nothing came for 1 s" in done.stderr
    assert "no message could be used" in done.stderr


def test_real_time_holds_lines_back(flown: Any) -> None:
    c, _, table, _ = flown
    session = Session(c, "receiver", 1, realtime=True)
    first = "\n".join(table.read_text().splitlines()[:5]) + "\n"
    begin = time.monotonic()
    session.pump(lines_of(first), 1.0)
    assert session.counts["used"] == 4
    assert time.monotonic() - begin > 1.4  # the fourth fix is at 2 s, the first was not held
    # and a source that is slower than time is never waited for


def test_one_source_only(tmp_path: Path) -> None:
    for extra in ((), ("--receiver", "-", "--imu", "-")):
        done = navsim(*SCENARIO, *extra, cwd=tmp_path)
        assert done.returncode == 2
        assert "exactly one" in done.stderr


# --- times


def flew(c: landing.Case, lines: list[str], start: str | None = None, **how: bool) -> tuple[Session, Any, list[str]]:
    """A session over lines, its result, and the warnings."""
    session = Session(c, "receiver", 1, start=None if start is None else start_time(start), **how)
    source = lines_of("\n".join(lines) + "\n")
    session.pump(source, 1.0)
    result = session.result()
    return session, result, [found.text for found in flying.findings(session, result, source)]


def later(rows: list[str], seconds: float) -> list[str]:
    """Rows of fixes by a clock that is ahead."""
    cells = [row.split(",", 1) for row in rows]
    return [f"{float(t) + seconds:.4f},{rest}" for t, rest in cells]


def of_another_place(rows: list[str], north: float = 9.0, east: float = -20.0) -> list[str]:
    """The same rows, degrees away."""
    cells = [row.split(",") for row in rows]
    return [",".join([t, f"{float(lat) + north}", f"{float(lon) + east}", *rest]) for t, lat, lon, *rest in cells]


def aside(rows: list[str], east: float = 0.0, up: float = 0.0) -> list[str]:
    """Rows of fixes moved by metres; the flight is one to the north."""
    cells = [row.split(",") for row in rows]
    degrees = [east / (111_320.0 * np.cos(np.radians(float(lat)))) for _, lat, *_ in cells]
    return [
        ",".join([t, lat, f"{float(lon) + more:.9f}", f"{float(h) + up}", *rest])
        for (t, lat, lon, h, *rest), more in zip(cells, degrees, strict=True)
    ]


OFF = r"the fixes lie on average {} m {} the flight, \d+\.\d sigmas of one fix \(\d\.\d m\) and {} of the mean of 120"


@pytest.mark.parametrize(
    ("east", "up", "said"),
    in_brief(
        [
            (0.0, 0.0, None),
            (2.0, -2.0, None),
            (-4.0, 8.0, None),
            (55.0, 0.0, OFF.format(r"5\d\.\d", "(right|left) of", r"\d{3}") + ".* another runway"),
            (-55.0, 0.0, OFF.format(r"5\d\.\d", "(right|left) of", r"\d{3}")),
            (0.0, -40.0, OFF.format(r"[34]\d\.\d", "below", r"\d{2,3}") + ".* heights above the geoid .* -107 to 86 m"),
            (0.0, 40.0, OFF.format(r"[34]\d\.\d", "above", r"\d{2,3}")),
        ],
        0,
        2,
        4,
    ),
)
def test_a_receiver_beside_the_flight_is_told(
    flown: Any, east: float, up: float, said: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Across and in height too, in metres; one whose errors last, of metres, is healthy."""
    monkeypatch.setitem(sys.modules, "egm96", None)  # as where the extra is not installed
    c, _, table, _ = flown
    header, *rows = table.read_text().splitlines()
    moved = aside(rows, east, up)
    _, result, warned = flew(c, [header, *moved])
    wrong = "; ".join(flying.failures(result))
    assert (re.search(said, wrong) is not None) if said else (wrong, warned) == ("", [])


@pytest.mark.parametrize(
    ("east", "said"), in_brief([(0.0, ""), (40.0, r"[34]\d\.\d m east of the"), (-40.0, "m west of")], 0, 1)
)
def test_a_receiver_beside_a_flight_that_turns_is_told(circled: Any, east: float, said: str) -> None:
    """It is now on one side of the course, now on the other, so that the mean across does not show it."""
    c, _, table, _ = circled
    header, *rows = table.read_text().splitlines()
    _, result, _ = flew(c, [header, *aside(rows, east)])
    wrong = "; ".join(flying.failures(result))
    assert abs(result["/off_flight/across"]) < 3.0 * result["/off_flight/across_sigma"]
    assert re.search(said, wrong) if said else not wrong


def test_a_mean_of_four_sigmas_is_doubted(flown: Any) -> None:
    """A result, with a warning."""
    c, _, table, _ = flown
    header, *rows = table.read_text().splitlines()
    _, result, _ = flew(c, [header, *rows])
    metres = 4.0 * float(result["/off_flight/across_sigma"])
    _, result, (warned,) = flew(c, [header, *aside(rows, metres)])
    assert not flying.failures(result)
    assert re.search(OFF.format(r"\d+\.\d", "(right|left) of", r"\d\d"), warned)


@pytest.mark.parametrize(
    ("geoid", "up", "said"),
    [
        (40.0, -40.0, r"the geoid is 40\.0 m above the ellipsoid here, so these heights likely are above the geoid"),
        (-35.0, -35.0, r"the geoid is -35\.0 m .* likely have the geoid's undulation twice"),
        (14.6, -40.0, r"It is not the geoid, which is 14\.6 m above the ellipsoid here"),
    ],
)
@pytest.mark.parametrize("known", in_brief(["installed", "given"], 1))
def test_the_geoid_is_named_with_its_metres(
    flown: Any, geoid: float, up: float, said: str, known: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the package where it is installed, by the scenario where it says so."""
    c, _, table, _ = flown
    monkeypatch.setitem(sys.modules, "egm96", types.SimpleNamespace(undulation=lambda lat, lon: geoid))
    if known == "given":
        monkeypatch.setitem(sys.modules, "egm96", None)
        runway = c.scenario.runway.model_copy(update={"geoid_undulation_m": geoid})
        c = dataclasses.replace(c, scenario=c.scenario.model_copy(update={"runway": runway}))
    header, *rows = table.read_text().splitlines()
    _, result, _ = flew(c, [header, *aside(rows, 0.0, up)])
    assert result["/off_flight/undulation"] == geoid
    assert re.search(said, "; ".join(flying.failures(result)))


def test_a_receiver_with_slow_errors_of_metres_is_healthy(flown: Any, tmp_path: Path) -> None:
    """2 m, over minutes, on each axis, as of orbits and atmosphere; the command ends with 0, and with 3 for one that is
    55 m beside the flight."""
    _, _, table, _ = flown
    header, *rows = table.read_text().splitlines()
    slow = [2.0 * np.sqrt(2.0) * np.sin(2.0 * np.pi * k / 300.0 + 1.0) for k in range(len(rows))]
    drifting = [aside([row], by, -by)[0] for row, by in zip(rows, slow, strict=True)]
    for name, lines, code in (("slow", drifting, 0), ("beside", aside(rows, 55.0), 3)):
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *lines]))
        done = navsim(*SCENARIO, "--receiver", f"{name}.csv", "-o", f"{name}.h5", cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert ("on average" in done.stderr) == (code == 3)


@pytest.mark.parametrize("separator", in_brief([";", "\t", "|", " "], 0, 3))
@pytest.mark.parametrize("headed", [True, False])
def test_other_separators_are_read(flown: Any, separator: str, headed: bool) -> None:
    """As in files: by the header, or by the first row; semicolons with decimal commas, quotes, units in brackets."""
    c, _, table, _ = flown
    header, *rows = [line.replace(",", separator) for line in table.read_text().splitlines()]
    if separator == ";":
        rows = [row.replace(".", ",") for row in rows]
        header = ";".join(f'"{name}"' for name in header.split(";")).replace("lat_deg", "lat (deg)")
    session, result, warned = flew(c, [*([f"\ufeff{header}"] if headed else []), *rows])
    assert session.counts["used"] == len(rows)
    assert not session.counts["corrupt"]
    assert not warned
    assert not flying.failures(result)


@pytest.mark.parametrize("kind", ["csv", "nmea"])
def test_a_lost_first_line_shifts_nothing(flown: Any, kind: str) -> None:
    c, result, table, nmea = flown
    lines = table.read_text().splitlines()[2:] if kind == "csv" else nmea.read_text().splitlines()[3:]
    session, ours, warned = flew(c, lines)
    assert session.clock.base == ("flight time" if kind == "csv" else "utc")
    np.testing.assert_allclose(ours["/innovations/time"], result["/geometry/time"][1:], atol=1e-6)
    assert not warned
    assert not flying.failures(ours)


def test_a_count_from_anywhere_begins_with_the_first_line(flown: Any) -> None:
    """Where only the first line tells the time, its loss shows along the track, and is said with the cure."""
    c, result, table, _ = flown
    rows = later(table.read_text().splitlines()[1:], 5000.0)
    session, whole, warned = flew(c, rows)
    assert session.clock.base == "first line"
    assert not warned
    np.testing.assert_allclose(whole["/innovations/time"], result["/geometry/time"], atol=1e-6)
    session, shifted, warned = flew(c, rows[1:])
    assert shifted["/clock/shift"] == pytest.approx(0.5, abs=0.05)
    assert len(warned) == 1
    assert "ahead of the flight" in warned[0]
    assert "1.0 periods: lines lost before the first" in warned[0]
    option = warned[0].split("--start-time ")[1].split()[0]
    session, cured, warned = flew(c, rows[1:], option)
    assert not warned
    np.testing.assert_allclose(cured["/innovations/time"], result["/geometry/time"][1:], atol=1e-3)
    session, _, warned = flew(c, table.read_text().splitlines()[2:], "first")
    assert session.clock.base == "first line"
    assert warned


def test_the_shift_is_as_sure_as_it_says() -> None:
    """The spread over receivers' noise is the sigma that one stream gives, at ten fixes a second and at one."""
    for rate in ("receiver.rate_hz=10", "receiver.rate_hz=1"):
        c = case("duration_s=60", rate)
        session = Session(c, "receiver", 1)
        time = c.shared.signals.time
        velocity = c.trajectory.motion(time).velocity_ned
        fixes = [receiver_fixes(c.shared, *measured(c.shared, seed, 0))[0] for seed in range(30)]
        shift, sigma = np.array([flying._shift(time, session._off(time, llh), velocity) for llh in fixes]).T
        assert abs(shift.mean()) < 4.0 * shift.std() / np.sqrt(shift.size)
        assert 0.6 < np.sqrt(np.mean(sigma**2)) / shift.std() < 1.6


def test_a_source_that_begins_before_the_flight_is_waited_for(flown: Any) -> None:
    c, result, table, _ = flown
    rows = table.read_text().splitlines()[1:]
    epoch = c.scenario.epoch.timestamp()
    lead = [f"{-2.0 + 0.5 * k:.4f},{rows[0].split(',', 1)[1]}" for k in range(4)]
    session, ours, _ = flew(c, later(lead + rows, epoch))
    assert session.clock.base == "utc"
    assert session.counts["before"] == 4
    np.testing.assert_allclose(ours["/innovations/time"], result["/geometry/time"], atol=1e-6)


def test_nmea_joined_in_mid_epoch(flown: Any) -> None:
    """Fixes come before the first date: they count by the time of day, and go on by the date."""
    c, result, _, nmea = flown
    lines = nmea.read_text().splitlines()
    for joined in (
        [line for k, line in enumerate(lines) if k > 12 or "RMC" not in line],
        [line for line in lines if "RMC" not in line],
        lines[1:],  # in the middle of the first epoch
        [lines[0][30:], *lines[1:]],  # in the middle of its first line
    ):
        session, ours, warned = flew(c, joined)
        lost = int("GGA" not in joined[0])
        assert session.counts["used"] == result["/geometry/time"].size - lost
        np.testing.assert_allclose(ours["/innovations/time"], result["/geometry/time"][lost:], atol=1e-6)
        assert session.clock.base == ("utc" if any("RMC" in line for line in joined) else "time of day")
        assert not warned


def test_a_receiver_whose_weeks_rolled_over(flown: Any) -> None:
    c, result, _, nmea = flown
    old = (c.scenario.epoch - datetime.timedelta(weeks=1024)).strftime(",%d%m%y,")
    now = c.scenario.epoch.strftime(",%d%m%y,")
    lines = [sentence(line[1:-3].replace(now, old)).strip() for line in nmea.read_text().splitlines()]
    said: list[str] = []
    session = Session(c, "receiver", 1, tell=said.append)
    session.pump(lines_of("\n".join(lines)), 1.0)
    assert session.counts["used"] == result["/geometry/time"].size
    assert any("rolled over" in line for line in said)


def test_a_garbled_first_line_settles_no_clock(flown: Any) -> None:
    """A line joined in its first number is a row like any other, of another time."""
    c, result, table, _ = flown
    rows = later(table.read_text().splitlines()[1:], 5000.0)
    session, ours, _ = flew(c, [rows[0][2:], *rows[1:]], "5000")
    assert session.counts["late"] == 1
    np.testing.assert_allclose(ours["/innovations/time"], result["/geometry/time"][1:], atol=1e-6)
    session, ours, _ = flew(c, [rows[0][2:], *rows[1:]])
    assert session.counts["used"] == result["/geometry/time"].size - 1


def test_a_stream_past_the_end_of_the_flight_ends_the_run(flown: Any) -> None:
    """Without the last fix of the flight, and with a sender that goes on for ever."""
    c, _, table, _ = flown
    rows = table.read_text().splitlines()[1:-1]
    session = Session(c, "receiver", 1)
    source = Lines()
    source.put(("\n".join([*rows, *later(rows, 60.0)]) + "\n").encode())
    assert session.pump(source, 60.0) == "the scenario's time is over"
    assert not flying.failures(session.result())


# --- what is no landing


def test_another_country_is_no_result(flown: Any) -> None:
    c, _, table, _ = flown
    _, result, warned = flew(c, of_another_place(table.read_text().splitlines()[1:]))
    assert not any("along the track" in line for line in warned)
    said = flying.failures(result)
    assert any("from where the flight is at their times" in line for line in said)
    assert any("the gate rejected" in line for line in said)
    assert str(result.attributes["verdict"]).startswith("no result: half of the fixes lie more than")


def test_another_time_of_the_flight_is_no_result(flown: Any) -> None:
    """Ten seconds are named as such, and with them taken off it is one."""
    c, _, table, _ = flown
    rows = table.read_text().splitlines()[1:]
    _, result, warned = flew(c, rows, "-10")
    assert any("another time of it" in line for line in flying.failures(result))
    (said,) = [line for line in warned if line.startswith("along the track")]
    assert "s behind the flight" in said
    option = said.split("--start-time ")[1].split()[0]
    assert abs(float(option)) <= 0.5
    _, result, _ = flew(c, rows, option)
    assert not flying.failures(result)


def test_two_senders_at_once_are_no_result(flown: Any) -> None:
    """Of one time; of two times; and as sentences of one epoch."""
    c, _, table, nmea = flown
    rows = table.read_text().splitlines()[1:]
    other = of_another_place(rows, 0.2, 0.0)
    for second in (other, later(other, 0.2), later(other, -7.3)):
        _, result, _ = flew(c, [line for pair in zip(rows, second, strict=True) for line in pair])
        assert flying.failures(result), second[0]
    sentences = nmea.read_text().splitlines()
    mixed = []
    for line in sentences:
        mixed.append(line)
        if "GGA" in line:
            body = line[1:-3].split(",")
            body[2] = f"{float(body[2]) + 10.0:012.7f}"
            mixed.append(sentence(",".join(body)).strip())
    session, result, _ = flew(c, mixed)
    assert session.counts["contradicting"] == len(sentences) // 3
    assert any("two senders at once" in line for line in flying.failures(result))


def test_what_was_left_out_is_said(flown: Any) -> None:
    c, _, table, _ = flown
    session = Session(c, "receiver", 1)
    source = lines_of(table.read_text())
    source.dropped = 7
    source.strangers = {"udp://127.0.0.1:4001": 3, "others": 2}
    session.pump(source, 1.0)
    result = session.result()
    assert result["/stream/strangers"] == 5
    assert [found.text for found in flying.findings(session, result, source)] == [
        "datagrams of other senders than the first were left out: udp://127.0.0.1:4001 (3), others (2)",
        "7 lines left out because they came faster than they were taken",
    ]


def test_a_few_good_lines_among_many_are_no_result(flown: Any) -> None:
    """As through a serial line of the wrong rate."""
    c, _, table, _ = flown
    rows = table.read_text().splitlines()[1:]
    _, result, warned = flew(c, [row if k % 15 in (0, 1) else row[::-1] + "?" for k, row in enumerate(rows)])
    assert not flying.failures(result)  # one line of seven: poor, and of this landing
    assert any("lines are corrupt" in line for line in warned)
    _, result, _ = flew(c, [row if k % 30 in (0, 1) else row[::-1] + "?" for k, row in enumerate(rows)])
    assert any("only 8 could be used" in line for line in flying.failures(result))


def without(line: str, kind: str, place: int) -> str:
    """A sentence of this kind with a field emptied, another as it is."""
    if kind not in line:
        return line
    body = line.strip()[1:-3].split(",")
    body[place] = ""
    return sentence(",".join(body)).strip()


def test_sentences_without_a_time_are_no_result(flown: Any) -> None:
    """A receiver that never learns the time: none of its fixes can be used, and that is what is said."""
    c, _, _, nmea = flown
    lines = [without(without(line, "GGA", 1), "RMC", 1) for line in nmea.read_text().splitlines()]
    session, result, _ = flew(c, lines)
    untimed = sum("VTG" not in line for line in lines)
    assert session.counts["untimed"] == untimed
    assert flying.failures(result) == [f"no message could be used: {untimed} NMEA sentences without a time of day"]
    timed = nmea.read_text().splitlines()[:12]
    _, result, _ = flew(c, [*timed, *lines])
    assert any("messages and corrupt lines only 4 could be used" in line for line in flying.failures(result))


def test_lines_without_a_fix_are_not_called_none(flown: Any) -> None:
    c, _, _, _ = flown
    assert flying.failures(flew(c, [])[1]) == ["no message could be used: none came"]
    satellites = sentence("GPGSV,1,1,01,05,40,083,46").strip()
    assert flying.failures(flew(c, [satellites] * 3)[1]) == [
        "no message could be used: 3 valid sentences of kinds without a fix"
    ]
    course = sentence("GPVTG,84.4,T,,M,22.4,N,41.5,K,A").strip()
    assert flying.failures(flew(c, [course] * 3)[1]) == ["no message could be used: 3 lines received"]


def test_heights_over_the_geoid_are_warned_of(flown: Any) -> None:
    c, expected, _, nmea = flown
    session, _, warned = flew(c, [without(line, "GGA", 11) for line in nmea.read_text().splitlines()])
    fixes = expected["/geometry/time"].size
    assert session.counts["used"] == session.counts["no_separation"] == fixes
    assert warned == [
        f"{fixes} fixes without a geoid separation; navsim takes their heights as heights above the ellipsoid"
    ]


def of_quality(line: str, quality: int, mode: str) -> str:
    """A sentence of another kind of fix, and no longer a height over the ellipsoid by mistake."""
    body = line.strip()[1:-3].split(",")
    if body[0].endswith("GGA"):
        body[6] = str(quality)
    else:
        body[-1] = mode
    return sentence(",".join(body)).strip()


@pytest.mark.parametrize(
    ("quality", "mode", "kind"), in_brief([(6, "E", "estimated"), (7, "M", "manual"), (8, "S", "simulated")], 1)
)
def test_what_is_no_fix_of_the_receiver_is_left_out(flown: Any, quality: int, mode: str, kind: str) -> None:
    c, _, _, nmea = flown
    lines = nmea.read_text().splitlines()
    mixed = [*lines[:120], *(of_quality(line, quality, mode) for line in lines[120:180]), *lines[180:]]
    session, result, warned = flew(c, mixed)
    whole, _, _ = flew(c, lines)
    assert session.counts[kind] == int(result[f"/stream/{kind}"]) == 20
    assert session.counts["used"] == whole.counts["used"] - 20
    assert any(words.startswith("20 NMEA epochs of ") and f"quality {quality}" in words for words in warned)
    _, result, _ = flew(c, [of_quality(line, quality, mode) for line in lines])
    assert f"no message could be used: {len(lines) // 3} NMEA epochs of" in flying.failures(result)[0]
    asked, _, warned = flew(c, mixed, simulated=True)
    assert asked.counts["used"] == whole.counts["used"] - (0 if kind == "simulated" else 20)
    assert (kind == "simulated") == (not warned)


def test_sentences_without_checksums_are_read_when_lenient(flown: Any) -> None:
    c, _, _, nmea = flown
    lines = nmea.read_text().splitlines()
    bare = [line.split("*")[0] for line in lines]
    session, result, _ = flew(c, bare)
    assert session.counts["no_checksum"] == len(lines)
    assert not session.counts["corrupt"]
    assert "NMEA sentences without a checksum" in flying.failures(result)[0]
    _, _, warned = flew(c, [*lines[:300], *bare[300:]])
    assert any(words.endswith("--lenient reads them") for words in warned)
    whole, expected, _ = flew(c, lines)
    session, result, warned = flew(c, bare, lenient=True)
    assert session.counts["used"] == whole.counts["used"]
    assert not warned
    np.testing.assert_array_equal(result["/filter/error"], expected["/filter/error"])


def test_every_line_twice_is_a_result(flown: Any) -> None:
    c, expected, table, _ = flown
    rows = table.read_text().splitlines()[1:]
    session, result, warned = flew(c, [row for row in rows for _ in range(2)])
    assert session.counts["doubled"] == len(rows) - 1  # with the last of the flight it is over
    assert session.counts["used"] == expected["/geometry/time"].size
    assert not flying.failures(result)
    assert not warned


def test_samples_of_another_flight_are_no_result() -> None:
    c = case(*SHORT)
    rng = np.random.default_rng(1)
    rows = [f"{0.01 * k},{','.join(f'{x:.4f}' for x in rng.normal(0.0, 20.0, 6))}" for k in range(1, 3001)]
    session = Session(c, "imu", 1)
    session.pump(lines_of("\n".join(rows)), 1.0)
    assert flying.failures(session.result())


def test_the_gate_lets_go_as_in_a_landing(flown: Any) -> None:
    """After `max_rejected` fixes in a row one is taken: also where each fix is a call of its own."""
    c, _, table, _ = flown
    rows = table.read_text().splitlines()[1:]
    _, result, _ = flew(c, [*rows[:40], *of_another_place(rows[40:], 0.02, 0.0)])
    status = result["/innovations/status"]
    assert list(status[40:52]) == [2] * 10 + [1] + [status[51]]


# --- latency


@pytest.mark.parametrize("latency", ["receiver.latency_s=0.13", "receiver.latency_s=0.13, filter.latency_s=0.05"])
def test_the_receivers_latency_is_flown(latency: str, tmp_path: Path) -> None:
    """With latency too the chain cut at the receiver is the chain, also where the filter believes another one."""
    c = case(*SHORT, "duration_s=30", *latency.split(", "))
    simulated = landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    export(simulated, tmp_path / "r.h5", ["csv"])
    _, result, _ = flew(c, (tmp_path / "r_gnss.csv").read_text().splitlines())
    np.testing.assert_allclose(result["/filter/time"], simulated["/filter/time"][1:], atol=1e-6)
    np.testing.assert_allclose(result["/filter/error"][:, :9], simulated["/filter/error"][0, 1:, :9], atol=3e-3)
    np.testing.assert_allclose(result["/innovations/time"], result["/filter/time"] - 0.13, atol=1e-6)


def test_an_imu_in_the_loop_of_a_late_receiver() -> None:
    c = case(*SHORT, "duration_s=20", "receiver.latency_s=0.13")
    simulated = landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    session = Session(c, "imu", 1)
    session.pump(lines_of("\n".join(imu_rows(c, 1))), 1.0)
    result = session.result()
    np.testing.assert_allclose(result["/filter/time"], simulated["/filter/time"][1:], atol=1e-6)
    np.testing.assert_allclose(result["/filter/error"][:, :9], simulated["/filter/error"][0, 1:, :9], atol=3e-3)


# --- how a run ends


def started(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    command = [installed(), *SCENARIO, "--receiver", "-", "--silence", "100", *arguments]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    # the tests may themselves run where interrupts are ignored, as in the background of a script
    return subprocess.Popen(command, cwd=cwd, text=True, preexec_fn=_listening, **pipes)


def _listening() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_quiet_says_nothing_but_warnings(flown: Any, tmp_path: Path) -> None:
    done = navsim(*SCENARIO, "--receiver", str(flown[2]), "-o", "a.h5", "-q", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout == done.stderr == ""


def test_standard_input_may_stay_open(flown: Any, tmp_path: Path) -> None:
    _, _, table, _ = flown
    with started("-o", "a.h5", cwd=tmp_path) as process:
        assert process.stdin is not None
        process.stdin.write(table.read_text())
        process.stdin.flush()
        assert process.wait(60.0) == 0
        assert "the scenario's time is over" in process.stderr.read()


@pytest.mark.parametrize("number", in_brief([signal.SIGINT, signal.SIGTERM], 1))
def test_signals_keep_what_came(flown: Any, number: signal.Signals, tmp_path: Path) -> None:
    _, _, table, _ = flown
    with started("-o", "a.h5", cwd=tmp_path) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write("\n".join(table.read_text().splitlines()[:31]) + "\n")
        process.stdin.flush()
        for line in process.stderr:  # the clock is settled: lines are being taken
            if line.startswith("time 0 of the flight"):
                break
        process.send_signal(number)
        assert process.wait(60.0) == 128 + number
        assert "the data so far are kept" in process.stderr.read()
    kept = read(tmp_path / "a.h5")
    assert kept.attributes["verdict"] == "flown"
    assert kept["/innovations/time"].size > 0


def test_a_terminal_that_hangs_up(flown: Any, tmp_path: Path) -> None:
    """The result is written though every word, and the progress bar, would fail; kernels may be compiled first."""
    _, _, table, _ = flown
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "navsim", *SCENARIO, "--receiver", "-", "--silence", "100", "-o", "a.h5"]
    pipes = {"stdin": subprocess.PIPE, "stdout": theirs, "stderr": theirs}

    def heard() -> None:  # also where the tests themselves run under nohup
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    with subprocess.Popen(command, cwd=tmp_path, start_new_session=True, preexec_fn=heard, **pipes) as process:
        assert process.stdin is not None
        os.close(theirs)
        process.stdin.write("\n".join(table.read_text().splitlines()[:31]).encode() + b"\n")
        process.stdin.flush()
        said = b""
        while b"time 0 of the flight" not in said:
            said += os.read(ours, 1000)
        os.close(ours)
        process.send_signal(signal.SIGHUP)
        assert process.wait(300.0) == 128 + signal.SIGHUP
    assert read(tmp_path / "a.h5").attributes["verdict"] == "flown"


def test_ignored_signals_stay_ignored(flown: Any) -> None:
    """Under nohup a hangup is no reason to end; what was set before is set again after."""
    session = Session(flown[0], "receiver", 1)
    before = {number: signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGTERM)}
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with _ended_by_signals(session) as came:
            signal.raise_signal(signal.SIGHUP)
            assert session.stopped is None
            signal.raise_signal(signal.SIGTERM)
            assert came == [signal.SIGTERM]
            assert session.stopped == "terminated; the data so far are kept"
            assert signal.getsignal(signal.SIGTERM) is before[signal.SIGTERM]  # a second one ends the program
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before[signal.SIGHUP])


def test_no_result_is_exit_3_and_kept(flown: Any, tmp_path: Path) -> None:
    _, _, table, _ = flown
    (tmp_path / "other.csv").write_text("\n".join(of_another_place(table.read_text().splitlines()[1:])))
    done = navsim(*SCENARIO, "--receiver", "other.csv", "-o", "a.h5", cwd=tmp_path)
    assert done.returncode == 3
    assert "error: half of the fixes lie more than" in done.stderr
    assert "kept in a.h5" in done.stderr
    assert (tmp_path / "a.h5").exists()


def test_a_start_time_that_is_none(tmp_path: Path) -> None:
    done = navsim(*SCENARIO, "--receiver", "-", "--start-time", "noon", cwd=tmp_path)
    assert done.returncode == 2
    assert "--start-time is 'noon'; allowed are an instant" in done.stderr
