"""End of a command: signals, a closed pipe and a full disk become a message and an exit code.

The first interrupt (SIGINT), termination (SIGTERM) or hangup (SIGHUP) raises an exception, so that finished work is
kept. A second one ends the process at once; files stay intact, since each is written atomically. While kernels compile,
which cannot be interrupted, the first signal does the same after `PATIENCE`. Exit codes are those of a shell: 128 + the
signal's number.
"""

from __future__ import annotations

import functools
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn, TextIO, TypeVar, cast

from navsim.cli import log

OK, CHECK_FAILED, BAD_INPUT, RUN_FAILED, OTHER_CODE = 0, 1, 2, 3, 4

WORDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "the terminal hung up",
}
"""Signals that end a command, with their messages."""

PATIENCE = 1.0
"""Time in which a command should end before a message, or a forced end, s."""

_GAP_S = 0.2
"""Longest time between the compiling of two kernels, s."""

F = TypeVar("F", bound=Callable[..., Any])


class Ended(KeyboardInterrupt):
    """A signal that ends the command has come."""


_came: list[int] = []
_held: list[ExitStack] = []


def print_message(message: str, logged: bool = True) -> None:
    """Print a message to standard error, and to the log if it is not logged otherwise; standard output is for results
    alone."""
    with suppress(OSError):  # if nobody can be told, work continues
        print(message, file=sys.stderr)
    if logged and log.is_open():
        log.note_message(message)


class LossyStderr:
    """Standard error that ignores write errors: if nobody can read messages, such as after a terminal is closed, work
    continues."""

    def __init__(self) -> None:
        self._stream = sys.stderr

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()


class Output:
    """Standard output that keeps its last failure.

    An error without a file name may come from any other file: a socket, a device, a descriptor.
    """

    failed: OSError | None = None

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return int(self._kept(self._stream.write, text))

    def flush(self) -> None:
        self._kept(self._stream.flush)

    @staticmethod
    def _kept(act: Callable[..., Any], *given: str) -> Any:
        try:
            return act(*given)
        except OSError as error:
            Output.failed = error
            raise


@contextmanager
def _watched() -> Iterator[None]:
    """Context in which standard output keeps its failure; not nested."""
    before = sys.stdout
    if not isinstance(before, Output):
        sys.stdout = cast("TextIO", Output(before))
    try:
        yield
    finally:
        sys.stdout = before


def prepare_streams() -> None:
    """Ensure that standard input, output and error exist and accept every character.

    A file opened while one of them is closed would get its number, and stray messages. A character that the encoding
    lacks becomes a question mark.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # closed by the caller
            os.open(os.devnull, os.O_RDWR)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115, for as long as the process
        elif mode == "w" and isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() not in ("utf-8", "utf8"):
            stream.reconfigure(errors="replace")


def ending(command: F) -> F:
    """Decorator: the command ends as this module describes."""

    @functools.wraps(command)
    def ended(*arguments: Any, **options: Any) -> Any:
        with ends():
            return command(*arguments, **options)

    return ended  # type: ignore[return-value]  # wraps() keeps the signature, and mypy cannot tell


@contextmanager
def ends() -> Iterator[None]:
    """Context in which the end of a command becomes its message and exit code; contexts of `keep` are closed
    afterwards."""
    from navsim.defect import Defect

    try:
        with ExitStack() as held, _listening(), _watched():
            _held.append(held)
            try:
                yield
                sys.stdout.flush()
            finally:
                _held.pop()
                _print_cache_notes()
    except KeyboardInterrupt:
        _leave_for_signal()
    except SystemExit as left:
        if _came and not isinstance(left, _EndedBySignal) and left.code == 128 + signal.SIGINT:
            _leave_for_signal()  # typer caught it before a command had begun, and says nothing
        raise
    except MemoryError:
        print_message("error: not enough memory; --dry-run prints the need")
        sys.exit(RUN_FAILED)
    except Defect as error:
        print_message(f"error: {error}")
        sys.exit(RUN_FAILED)
    except BrokenPipeError:  # the reader went away, as `| head` does
        _silence(sys.stdout)
        sys.exit(OK)
    except OSError as error:
        if error.filename is not None:
            raise
        blamed = "standard output cannot be written: " if error is Output.failed else ""
        _silence(sys.stdout)
        print_message(f"error: {blamed}{error.strerror or error}")
        sys.exit(RUN_FAILED)


def keep(what: AbstractContextManager[None]) -> None:
    """Enter a context that lasts to the end of the command."""
    _held[-1].enter_context(what)


def check() -> None:
    """Raise Ended where a signal came whose first exception was lost, as in a callback from compiled code."""
    if _came:
        raise Ended


@contextmanager
def _listening() -> Iterator[None]:
    """Signals that are ignored, as by nohup or in the background of a script, stay so."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) is _end:
        yield
        return
    _came.clear()
    before = {number: signal.getsignal(number) for number in WORDS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, _end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def deafen() -> None:
    """Let a further signal end the process by default: only the interpreter's own end remains."""
    for number in WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def _end(number: int, _: FrameType | None) -> None:
    _came.append(number)
    if number == signal.SIGHUP:
        hung_up()
    if len(_came) > 1:
        print_message("ended at once", logged=False)  # even if the log blocks
        os._exit(128 + number)
    waiting = threading.Timer(PATIENCE, _still_here, [number])
    waiting.daemon = True
    waiting.start()
    raise Ended


def _still_here(number: int) -> None:
    """Message that a command is still running some time after a signal."""
    if not _held:  # the signal has arrived: the interpreter continues in another thread
        return
    if _compiling_soon():
        print_message(f"{WORDS[number]} while kernels were compiled", logged=False)
        os._exit(128 + number)
    print_message(f"{WORDS[number]}; navsim finishes its current step first. Send it again to stop at once")


def _compiling_soon() -> bool:
    """Whether another thread compiles, now or within `_GAP_S`: between two kernels there is a short pause."""
    end = time.monotonic() + _GAP_S
    while not _compiling():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True


def _compiling() -> bool:
    """Whether another thread compiles."""
    locks = sys.modules.get("numba.core.compiler_lock")
    if locks is None:
        return False
    lock = locks.global_compiler_lock._lock  # its own `is_locked` asks whether this very thread has it
    free = bool(lock.acquire(blocking=False))
    if free:
        lock.release()
    return not free


def hung_up() -> None:
    """Discard all further messages: a closed terminal accepts none, and each would fail."""
    for stream in (sys.stdout, sys.stderr):
        if stream.isatty():
            _silence(stream)


def _silence(stream: Any) -> None:
    with suppress(OSError, ValueError):  # a stream without a descriptor, as under a test, is not changed
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _print_cache_notes() -> None:
    """Print messages of the kernel cache, if it was used."""
    cache = sys.modules.get("navsim.compiler.kernel_cache")
    if cache is not None:
        while cache.notes:
            print_message(f"warning: {cache.notes.pop(0)}")


class _EndedBySignal(SystemExit):
    """End after a signal whose message has been printed."""


def signal_that_came() -> int:
    """The number of the signal that ends the command."""
    return _came[-1] if _came else signal.SIGINT


def _leave_for_signal() -> NoReturn:
    number = signal_that_came()
    print_message(WORDS[number])
    raise _EndedBySignal(128 + number) from None
