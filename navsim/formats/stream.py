"""Stream of lines from standard input, UDP, TCP, a serial device, a file or named pipe.

A thread reads into a bounded queue, so that the consumer can wait with a time-out. Every read waits on the descriptor
for a short time only and without the interpreter lock, so that the thread always ends before the program does. The
`pyserial` package opens serial devices.
"""

from __future__ import annotations

import codecs
import errno
import os
import select
import socket
import stat
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import SplitResult, parse_qs, urlsplit

LONGEST_LINE = 4096
"""Bytes of a line that are kept; a longer one is cut, since no message is that long."""
MOST_WAITING = 16_000_000
"""Bytes of lines that may wait. A sender faster than that for long is slowed down (TCP, files) or loses lines (UDP)."""
_COST = 64
"""Bytes a waiting line takes besides its characters: empty lines too must not fill the memory."""
_POLL = 0.1
"""Longest wait of one read, s: so soon a reading thread sees that it is to end."""
_CHUNK = 65536
LOOPBACK = "127.0.0.1"
"""Default address: other machines are accepted only on request."""
_MOST_NAMES = 16
"""Other senders of datagrams that are remembered by name."""


class StreamError(Exception):
    """A stream that cannot be opened."""


class Lines:
    """Lines of a source, with a limit on waiting; `ended` once the source has closed.

    Attributes
    ----------
    lossy : bool
        Without room, drop lines and count them in `dropped`; otherwise the producer waits.
    place : str
        Name of the source in messages.
    note : str
        Message about it for the user, or empty.
    failure : str or None
        Why the source failed; None if it ended normally.
    strangers : dict
        Datagrams from senders other than the first, by sender (the first ones by name).
    """

    def __init__(self, lossy: bool = False, place: str = "", note: str = "") -> None:
        self.place = place
        self.note = note
        self.ended = False
        self.failure: str | None = None
        self.dropped = 0
        self.strangers: dict[str, int] = {}
        self._lossy = lossy
        self._change = threading.Condition()
        self._waiting: deque[str] = deque()
        self._size = 0
        self._closed = False
        self._stopped = False
        self._rest = bytearray()

    @property
    def size(self) -> int:
        """Waiting bytes, including the overhead of each line."""
        return self._size

    def put(self, data: bytes) -> None:
        """Add bytes as they came; complete lines are passed on."""
        first, *others = data.split(b"\n")
        self._gather(first)
        for part in others:
            self._hand_over()
            self._gather(part)

    def _gather(self, part: bytes) -> None:
        self._rest += part[: LONGEST_LINE - len(self._rest)]

    def _hand_over(self) -> None:
        line = self._rest.removeprefix(codecs.BOM_UTF8).decode("utf-8", "replace").strip("\r")
        self._rest.clear()
        cost = len(line) + _COST
        with self._change:
            if self._lossy and self._size + cost > MOST_WAITING:
                self.dropped += 1
                return
            self._change.wait_for(lambda: self._stopped or self._size + cost <= MOST_WAITING)
            self._waiting.append(line)
            self._size += cost
            self._change.notify_all()

    def close(self) -> None:
        """No more will come."""
        if self._rest:
            self._hand_over()
        with self._change:
            self._closed = True
            self._change.notify_all()

    def stop(self) -> None:
        """End the consumption: a waiting producer stops waiting."""
        with self._change:
            self._stopped = True
            self._change.notify_all()

    def take(self, patience: float) -> str | None:
        """The next line, or None when none comes within `patience` seconds or ever (`ended`)."""
        with self._change:
            self._change.wait_for(lambda: bool(self._waiting) or self._closed, patience)
            if self._waiting:
                line = self._waiting.popleft()
                self._size -= len(line) + _COST
                self._change.notify_all()
                return line
            self.ended = self._closed
            return None


@dataclass
class _Source:
    """Something open: read() returns the next bytes, b"" for none yet, None at the end; close() closes it."""

    read: Callable[[], bytes | None]
    close: Callable[[], None]
    place: str
    lossy: bool = False
    note: str = ""
    strangers: dict[str, int] = field(default_factory=dict)


@contextmanager
def open_source(source: str) -> Iterator[Lines]:
    """Lines of a source.

    `-`, udp://HOST:PORT (listens, keeps to the first sender), tcp://HOST:PORT (connects), tcp-listen://HOST:PORT (waits
    for one sender), serial:///dev/NAME?baud=N, or a file's path. IPv6 addresses are in brackets; without a HOST the
    address is that of the machine itself. Raises StreamError.
    """
    try:
        link = _open(source, urlsplit(source))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise StreamError(f"{source}: cannot be opened: {reason}") from None
    lines = Lines(link.lossy, link.place, link.note)
    lines.strangers = link.strangers
    stop = threading.Event()

    def run() -> None:
        try:
            while not stop.is_set():
                data = link.read()
                if data is None:
                    break
                lines.put(data)
        except OSError as error:  # the device or the peer went away
            lines.failure = str(error)
        finally:
            lines.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield lines
    finally:
        stop.set()
        lines.stop()
        thread.join()
        link.close()


def _open(source: str, parts: SplitResult) -> _Source:
    if parts.scheme == "udp":
        return _udp(parts)
    if parts.scheme == "tcp":
        link = socket.create_connection((parts.hostname or LOOPBACK, _port(parts)), timeout=10.0)
        link.settimeout(_POLL)
        return _Source(lambda: _received(link), link.close, _named("tcp", link.getpeername()))
    if parts.scheme == "tcp-listen":
        return _one_sender(parts)
    if parts.scheme == "serial":
        import serial

        (baud,) = parse_qs(parts.query).get("baud", ["9600"])
        device = serial.serial_for_url(parts.path, baudrate=int(baud), timeout=_POLL)
        return _Source(lambda: device.read(max(1, device.in_waiting)), device.close, f"{parts.path} at {baud} baud")
    if parts.scheme and parts.scheme != "file" and len(parts.scheme) > 1:
        raise ValueError("write -, udp://, tcp://, tcp-listen://, serial:// or a file")
    if source == "-":
        return _descriptor(0, lambda: None, "standard input")
    path = parts.path if parts.scheme == "file" else source
    # a named pipe opens at once, even without a writer
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    return _descriptor(descriptor, lambda: os.close(descriptor), path)


def _port(parts: SplitResult) -> int:
    if parts.port is None:
        raise ValueError("the port is missing; write it as in udp://0.0.0.0:5000")
    return parts.port


def _named(scheme: str, address: tuple[Any, ...]) -> str:
    host, port = address[:2]
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def _listening(parts: SplitResult, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Any]:
    """Family and address to listen on; of a name with several, the IPv4 one."""
    found = socket.getaddrinfo(parts.hostname or LOOPBACK, _port(parts), type=kind, flags=socket.AI_PASSIVE)
    family, *_, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    return family, address


def _alone(parts: SplitResult) -> str:
    """Note for a source without an address."""
    if parts.hostname:
        return ""
    return f"listening to this machine only; {parts.scheme}://0.0.0.0:{parts.port} accepts others, too"


def _udp(parts: SplitResult) -> _Source:
    """Datagrams of the first sender; each is a complete line even without a line end."""
    family, address = _listening(parts, socket.SOCK_DGRAM)
    datagrams = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6 and address[0] == "::":  # [::] is every address of the machine, IPv4 ones too
            datagrams.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        datagrams.bind(address)
    except OSError:
        datagrams.close()
        raise
    datagrams.settimeout(_POLL)
    strangers: dict[str, int] = {}
    first: list[Any] = []

    def read() -> bytes:
        try:
            data, sender = datagrams.recvfrom(_CHUNK)
        except TimeoutError:
            return b""
        if not first:
            first.append(sender)
        if sender != first[0]:
            name = _named("udp", sender)
            if name not in strangers and len(strangers) >= _MOST_NAMES:
                name = "others"
            strangers[name] = strangers.get(name, 0) + 1
            return b""
        return data if data.endswith(b"\n") else data + b"\n"

    place = _named("udp", datagrams.getsockname())
    return _Source(read, datagrams.close, place, True, _alone(parts), strangers)


def _one_sender(parts: SplitResult) -> _Source:
    family, address = _listening(parts, socket.SOCK_STREAM)
    every = family == socket.AF_INET6 and address[0] == "::" and socket.has_dualstack_ipv6()
    server = socket.create_server(address[:2], family=family, dualstack_ipv6=every)
    server.settimeout(_POLL)
    place = _named("tcp-listen", server.getsockname())
    link: list[socket.socket] = []

    def read() -> bytes | None:
        if not link:
            try:
                link.append(server.accept()[0])
            except TimeoutError:
                return b""
            server.close()  # a second sender is refused instead of being kept waiting
            link[0].settimeout(_POLL)
        return _received(link[0])

    def close() -> None:
        for one in (server, *link):
            one.close()

    return _Source(read, close, place, note=_alone(parts))


def _received(link: socket.socket) -> bytes | None:
    try:
        return link.recv(_CHUNK) or None
    except TimeoutError:
        return b""


def _descriptor(descriptor: int, close: Callable[[], None], place: str) -> _Source:
    """A file, pipe or terminal by its descriptor. A buffered reader would be locked by the waiting thread, and the
    interpreter aborts where it finds that lock held at its end."""
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISDIR(mode):
        close()
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    regular = stat.S_ISREG(mode)

    def read() -> bytes | None:
        if not regular and not select.select([descriptor], [], [], _POLL)[0]:
            return b""
        return os.read(descriptor, _CHUNK) or None

    return _Source(read, close, place)
