"""Semi-physical runs: a stream in place of the receiver or of the IMU, whole and broken, over every kind of line."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from navsim.io.export import export
from navsim.io.stream import Lines, StreamError, opened
from navsim.study import landing
from navsim.study.live import Session
from tests.helpers import SCENARIOS, case

SHORT = ("receiver.rate_hz=2", "duration_s=60", "filter.velocity=true")
SCENARIO = ("live", str(SCENARIOS / "landing.yaml"), *(x for a in SHORT for x in ("--set", a)))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    """A landing, its result, and its fixes as lines of CSV and NMEA."""
    folder = tmp_path_factory.mktemp("live")
    c = case(*SHORT)
    result = landing.result(c, landing.fly_all(c, 1, 0, 1, 1, keep="all"), 1, keep="all")
    export(result, folder / "r.h5", ["csv", "nmea"])
    return c, result, folder / "r_gnss.csv", folder / "r.nmea"


def lines_of(text: str) -> Lines:
    lines = Lines()
    lines.put(text.encode())
    lines.close()
    return lines


def test_the_simulators_own_fixes_give_the_simulated_run(flown) -> None:  # type: ignore[no-untyped-def]
    """The chain cut at the receiver and put together again is the chain."""
    c, result, table, _ = flown
    session = Session(c, "receiver", 1)
    session.pump(lines_of(table.read_text()), 1.0)
    ours, theirs = session.filter.estimates(), result["/filter/error"][0, 1:]
    assert session.counts["used"] == theirs.shape[0]
    assert not session.counts["corrupt"] + session.counts["late"] + session.counts["lost"]
    np.testing.assert_allclose(ours["error"][:, :9], theirs[:, :9], atol=2e-3)
    np.testing.assert_allclose(ours["sigma"], result["/filter/sigma"][0, 1:], rtol=1e-2)


def test_nmea_in_place_of_the_receiver(flown) -> None:  # type: ignore[no-untyped-def]
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


def imu_rows(c: landing.Case) -> list[str]:
    world = c.world
    step = np.diff(world.imu_time)[:, None]
    rows = zip(world.imu_time[1:], world.dtheta / step, world.dv / step, strict=True)
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
    assert error.shape[0] == c.world.signals.time.size
    assert np.sqrt(np.mean(error[-20:, :3] ** 2)) < 1.0
    broken = [*rows[:100], "nonsense", *rows[103:200], rows[150], rows[200][:20], *rows[201:]]
    session = Session(c, "imu", 1)
    session.pump(lines_of("\n".join(broken)), 1.0)
    assert session.counts["corrupt"] == 2
    assert session.counts["lost"] == 4
    assert session.counts["late"] == 1
    assert np.sqrt(np.mean(session.filter.estimates()["error"][-20:, :3] ** 2)) < 2.0


def navsim(*arguments: str, cwd: Path, text: str | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "navsim", *arguments]
    return subprocess.run(command, cwd=cwd, input=text, capture_output=True, text=True, check=False, timeout=120)


def test_standard_input_and_files(flown, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, result, table, nmea = flown
    done = navsim(*SCENARIO, "--receiver", "-", "-o", "a.h5", "--json", cwd=tmp_path, text=table.read_text())
    assert done.returncode == 0, done.stderr
    counted = json.loads(done.stdout)["stream"]
    assert counted["used"] == result["/geometry/time"].size
    done = navsim(*SCENARIO, "--receiver", str(nmea), "-o", "b.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "messages used" in done.stdout
    shown = navsim("show", "b.h5", cwd=tmp_path)
    assert shown.stdout.splitlines()[1:] == done.stdout.splitlines()[:-1]
    assert navsim("plot", "b.h5", cwd=tmp_path).returncode == 0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("kind", ["udp", "tcp", "tcp-listen"])
def test_over_the_network(kind: str) -> None:
    """Two hundred lines come through, whole and in order."""
    port = free_port()
    sent = [f"line {k}" for k in range(200)]
    ready = threading.Event()

    def send() -> None:
        if kind == "tcp":
            with socket.create_server(("127.0.0.1", port)) as server:
                ready.set()
                link, _ = server.accept()
                with link:
                    link.sendall(("\n".join(sent) + "\n").encode())
            return
        ready.wait(5.0)
        time.sleep(0.2)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as link:
            link.connect(("127.0.0.1", port))
            for line in sent:
                link.sendall((line + "\r\n").encode())
                time.sleep(0.0005)

    sender = threading.Thread(target=send)
    sender.start()
    if kind == "tcp":
        ready.wait(5.0)
    got = []
    with opened(f"{kind}://127.0.0.1:{port}") as lines:
        ready.set()
        while len(got) < len(sent):
            line = lines.take(3.0)
            if line is None:
                break
            got.append(line)
    sender.join()
    assert got == sent


def test_a_serial_device(tmp_path: Path) -> None:
    """A pseudo terminal stands for the device."""
    import os
    import pty
    import tty

    master, slave = pty.openpty()
    tty.setraw(slave)
    with opened(f"serial://{os.ttyname(slave)}?baud=115200") as lines:
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
    with pytest.raises(StreamError, match="cannot be opened"), opened(source):
        pass


def test_a_silent_source_ends_the_run(flown, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    port = free_port()
    done = navsim(*SCENARIO, "--receiver", f"udp://127.0.0.1:{port}", "--silence", "1", "-o", "a.h5", cwd=tmp_path)
    assert done.returncode == 3
    assert "nothing came for 1 s" in done.stderr
    assert "not one message could be used" in done.stderr


def test_real_time_holds_lines_back(flown) -> None:  # type: ignore[no-untyped-def]
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
