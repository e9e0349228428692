"""Lines of a source: bounded waiting, whom a socket hears, and that nothing is left waiting at the end."""

from __future__ import annotations

import os
import socket
import threading
import time
from pathlib import Path

import pytest

from navsim.formats import stream
from navsim.formats.stream import Lines, open_source


def port_of(lines: Lines) -> int:
    return int(lines.place.rsplit(":", 1)[1])


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind(("::1", 0))
        return True
    except OSError:
        return False


ADDRESSES = [
    ("127.0.0.1", socket.AF_INET, "127.0.0.1"),
    pytest.param("::1", socket.AF_INET6, "[::1]", marks=pytest.mark.skipif(not has_ipv6(), reason="no IPv6 here")),
]


@pytest.mark.parametrize(("host", "family", "name"), ADDRESSES)
def test_addresses_of_both_kinds(host: str, family: socket.AddressFamily, name: str) -> None:
    with open_source(f"udp://{name}:0") as lines, socket.socket(family, socket.SOCK_DGRAM) as sender:
        assert lines.place == f"udp://{name}:{port_of(lines)}"
        assert not lines.note
        sender.sendto(b"one", (host, port_of(lines)))
        assert lines.take(5.0) == "one"
    with open_source(f"tcp-listen://{name}:0") as lines, socket.create_connection((host, port_of(lines))) as link:
        link.sendall(b"two\n")
        assert lines.take(5.0) == "two"
    with (
        socket.create_server((host, 0), family=family) as server,
        open_source(f"tcp://{name}:{server.getsockname()[1]}") as lines,
    ):
        with server.accept()[0] as link:
            link.sendall(b"three\n")
        assert lines.take(5.0) == "three"
        assert lines.take(5.0) is None
        assert lines.ended


@pytest.mark.skipif(not has_ipv6(), reason="no IPv6 here")
@pytest.mark.parametrize("kind", ["udp", "tcp-listen"])
def test_all_addresses_are_those_of_both_kinds(kind: str) -> None:
    with open_source(f"{kind}://[::]:0") as lines:
        if kind == "udp":
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(b"here", ("127.0.0.1", port_of(lines)))
        else:
            with socket.create_connection(("127.0.0.1", port_of(lines))) as link:
                link.sendall(b"here\n")
        assert lines.take(5.0) == "here"


@pytest.mark.parametrize("kind", ["udp", "tcp-listen"])
def test_without_an_address_only_this_machine_is_heard(kind: str) -> None:
    with open_source(f"{kind}://:0") as lines:
        assert lines.place.startswith(f"{kind}://127.0.0.1:")
        assert lines.note == f"listening to this machine only; {kind}://0.0.0.0:0 accepts others, too"
    with open_source(f"{kind}://0.0.0.0:0") as lines:
        assert lines.place.startswith(f"{kind}://0.0.0.0:")
        assert not lines.note


def test_datagrams_of_the_first_sender_alone() -> None:
    with (
        open_source("udp://127.0.0.1:0") as lines,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second,
    ):
        there = ("127.0.0.1", port_of(lines))
        first.sendto(b"a1", there)
        assert lines.take(5.0) == "a1"
        for _ in range(3):
            second.sendto(b"b", there)
        first.sendto(b"a2\na3\n", there)
        assert [lines.take(5.0), lines.take(5.0)] == ["a2", "a3"]
        assert lines.strangers == {f"udp://127.0.0.1:{second.getsockname()[1]}": 3}


def test_a_second_sender_is_refused() -> None:
    with open_source("tcp-listen://127.0.0.1:0") as lines:
        there = ("127.0.0.1", port_of(lines))
        with socket.create_connection(there) as link:
            link.sendall(b"one\n")
            assert lines.take(5.0) == "one"
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(there, timeout=5.0)


def test_the_queue_of_datagrams_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "MOST_WAITING", 100_000)
    lines = Lines(lossy=True)
    for _ in range(50):
        lines.put(b"x" * 60_000 + b"\n")  # fifty times 60 kB in, cut to the longest line
        lines.put(b"\n" * 100)
    assert lines.size <= 100_000
    assert lines.dropped > 0
    kept = 0
    lines.close()
    while lines.take(0.0) is not None:
        kept += 1
    assert kept + lines.dropped == 50 * 101
    assert lines.size == 0


def test_a_fast_sender_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file ten times as large as what may wait comes through whole, without ever taking more room."""
    monkeypatch.setattr(stream, "MOST_WAITING", 20_000)
    lines = Lines()
    sent = [f"line {k}" for k in range(3000)]

    def put() -> None:
        lines.put(("\n".join(sent) + "\n").encode())
        lines.close()

    thread = threading.Thread(target=put)
    thread.start()
    got, most = [], 0
    while (line := lines.take(5.0)) is not None:
        most = max(most, lines.size)
        got.append(line)
    thread.join()
    assert got == sent
    assert most <= 20_000
    assert lines.dropped == 0


def test_one_line_is_bounded() -> None:
    lines = Lines()
    for _ in range(100):
        lines.put(b"y" * 65_536)
    lines.put(b"\nnext\n")
    first = lines.take(0.0)
    assert first is not None
    assert len(first) == stream.LONGEST_LINE
    assert lines.take(0.0) == "next"


@pytest.mark.parametrize("full", [False, True])
def test_a_pipe_that_stays_open_is_left(full: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a silent writer nor one who has filled the queue keeps the reading thread."""
    monkeypatch.setattr(stream, "MOST_WAITING", 1000)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    threads = threading.active_count()
    with open_source(str(pipe)) as lines:
        assert lines.take(0.05) is None
        assert not lines.ended  # nobody writes yet
        writer = os.open(pipe, os.O_WRONLY)
        os.write(writer, b"one\n" * (500 if full else 1))
        assert lines.take(5.0) == "one"
        begin = time.monotonic()
    assert time.monotonic() - begin < 2.0
    assert threading.active_count() == threads
    os.close(writer)


def test_a_source_that_goes_away_says_why() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        open_source(f"tcp://127.0.0.1:{server.getsockname()[1]}") as lines,
    ):
        link = server.accept()[0]
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        link.close()  # with no time to linger the peer resets the connection
        assert lines.take(5.0) is None
        assert lines.ended
        assert lines.failure is not None
        assert "reset" in lines.failure
