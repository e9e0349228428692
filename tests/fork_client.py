"""Has a command run by a fork of a process that has everything loaded, and ends as it does: see `forks`.

As a program, `python -IS tests/fork_client.py SOCKET PROGRAM ARGUMENTS`, it is what a shell finds as `navsim`, or as
`python` for `python -c`: the command has the folder, environment and streams of this process, hears the signals that
end it, and leaves with its exit code. It imports nothing that is not part of Python: it starts within some ten
milliseconds.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

HEARD = (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM)
"""Signals that are handed on."""
LENGTH = 8
"""Bytes that say how long an order is."""


def ask(
    door: str,
    arguments: Sequence[str],
    cwd: str,
    streams: Mapping[int, int],
    environment: Mapping[str, str],
    began: Callable[[int], None] = lambda pid: None,
    **more: Any,
) -> dict[str, Any]:
    """How the command ended. door: the socket of `forks`. streams: what is open at its start, by its own numbers.
    began: called with its process."""
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(door)
        order = {"arguments": list(arguments), "cwd": cwd, "environment": dict(environment), **more}
        text = json.dumps(order | {"streams": list(streams)}).encode()
        first = len(text).to_bytes(LENGTH, "big")
        socket.send_fds(line, [first], list(streams.values()))
        line.sendall(text)
        with line.makefile("r", encoding="utf-8") as answers:
            began(int(answers.readline()))
            return dict(json.loads(answers.readline()))


def received(line: socket.socket) -> dict[str, Any]:
    """An order as `ask` sends it, `streams` being numbers of this process by those of the command."""
    first, descriptors, _, _ = socket.recv_fds(line, LENGTH, 3)
    with line.makefile("rb") as rest:
        order = json.loads(rest.read(int.from_bytes(first, "big")))
    return order | {"streams": dict(zip(order["streams"], descriptors, strict=True))}


def is_open(descriptor: int) -> bool:
    """Whether there is such a stream."""
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def main(door: str, program: str, *arguments: str) -> None:
    """Ends this process as the command ends."""

    def hand_on(pid: int) -> None:
        for number in HEARD:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, lambda heard, _: os.kill(pid, heard))

    streams = {number: number for number in range(3) if is_open(number)}
    code = ask(door, arguments, os.getcwd(), streams, os.environ, hand_on, program=program)["code"]
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main(*sys.argv[1:])
