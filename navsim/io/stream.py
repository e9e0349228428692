"""Lines that come while they are read: from standard input, UDP, TCP, a serial device, a growing or finished file.

A thread reads and a queue hands over, so that whoever takes lines can wait for a limited time. Serial devices are
opened by the `pyserial` package.
"""

from __future__ import annotations

import queue
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any
from urllib.parse import parse_qs, urlsplit

LONGEST_LINE = 4096
"""Bytes without a line's end after which what has gathered is handed over as a (corrupt) line."""
_WAITING = 100_000
"""Lines that may wait; a sender faster than that for long is slowed down (TCP, files) or loses lines (UDP)."""


class StreamError(Exception):
    """A stream that cannot be opened."""


class Lines:
    """Lines of a source, with a limit to waiting; `ended` once the source has closed."""

    def __init__(self) -> None:
        self._queue: queue.Queue[str | None] = queue.Queue(_WAITING)
        self.ended = False
        self._rest = b""

    def put(self, data: bytes) -> None:
        """Bytes as they came; whole lines are handed over."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        for line in whole:
            self._queue.put(line.decode("ascii", "replace").strip("\r"))
        if len(self._rest) > LONGEST_LINE:
            self._queue.put(self._rest.decode("ascii", "replace"))
            self._rest = b""

    def close(self) -> None:
        """No more will come."""
        if self._rest:
            self._queue.put(self._rest.decode("ascii", "replace"))
        self._queue.put(None)

    def take(self, patience: float) -> str | None:
        """The next line, or None when none comes within `patience` seconds or ever (`ended`)."""
        if self.ended:
            return None
        try:
            line = self._queue.get(timeout=patience)
        except queue.Empty:
            return None
        if line is None:
            self.ended = True
        return line


@contextmanager
def opened(source: str) -> Iterator[Lines]:
    """Lines of a source: `-`, udp://HOST:PORT (listens), tcp://HOST:PORT (connects), tcp-listen://HOST:PORT (waits for
    one sender), serial:///dev/NAME?baud=N, or a file's path. Raises StreamError."""
    lines = Lines()
    parts = urlsplit(source)
    stop = threading.Event()
    try:
        reader, closer = _opener(source, parts, stop)
    except (OSError, ValueError) as error:
        raise StreamError(f"{source}: cannot be opened: {error}") from None

    def run() -> None:
        try:
            while not stop.is_set():
                data = reader()
                if data is None:
                    break
                if data:
                    lines.put(data)
        except (OSError, TypeError, ValueError):
            # the device or the peer went away, or (pyserial: TypeError) was closed while being read: the stream's end
            pass
        finally:
            lines.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield lines
    finally:
        stop.set()
        closer()


def _opener(source: str, parts: Any, stop: threading.Event) -> tuple[Any, Any]:
    """A function that returns the next bytes (b"" for none yet, None at the end), and one that closes."""
    if parts.scheme == "udp":
        datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        datagrams.bind((parts.hostname or "0.0.0.0", _port(parts)))
        datagrams.settimeout(0.2)
        return (lambda: _received(lambda: datagrams.recv(65536), datagram=True)), datagrams.close
    if parts.scheme == "tcp":
        link = socket.create_connection((parts.hostname or "localhost", _port(parts)), timeout=10.0)
        link.settimeout(0.2)
        return (lambda: _received(lambda: link.recv(65536))), link.close
    if parts.scheme == "tcp-listen":
        server = socket.create_server((parts.hostname or "", _port(parts)))
        server.settimeout(0.2)
        return _one_sender(server, stop), server.close
    if parts.scheme == "serial":
        import serial

        baud = int(parse_qs(parts.query).get("baud", ["9600"])[0])
        device = serial.serial_for_url(parts.path, baudrate=baud, timeout=0.2)
        return (lambda: device.read(max(1, device.in_waiting))), device.close
    if parts.scheme and parts.scheme != "file" and len(parts.scheme) > 1:
        raise ValueError("known are -, udp://, tcp://, tcp-listen://, serial:// and files")
    file: IO[bytes] = sys.stdin.buffer if source == "-" else open(parts.path or source, "rb")  # noqa: SIM115
    read = getattr(file, "read1", file.read)
    return (lambda: read(65536) or None), (lambda: None) if source == "-" else file.close


def _port(parts: Any) -> int:
    if parts.port is None:
        raise ValueError("a port is missing, as in udp://0.0.0.0:5000")
    return int(parts.port)


def _received(receive: Any, datagram: bool = False) -> bytes | None:
    try:
        data: bytes = receive()
    except TimeoutError:
        return b""
    if datagram:  # a datagram is whole lines, whether or not it says so
        return data if data.endswith(b"\n") else data + b"\n"
    return data or None


def _one_sender(server: socket.socket, stop: threading.Event) -> Any:
    link: list[socket.socket] = []

    def read() -> bytes | None:
        if not link:
            try:
                link.append(server.accept()[0])
            except TimeoutError:
                return None if stop.is_set() else b""
            link[0].settimeout(0.2)
        return _received(lambda: link[0].recv(65536))

    return read
