"""Output files of a job: what may be overwritten, locks, files beside a result."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.runner.errors import BadInput, as_problems
from navsim.runner.reporter import Reporter

if TYPE_CHECKING:
    from navsim.results.result import Result, ResultKind


_COMPILING_MEMORY = 2e9
"""Memory of two processes that compile, bytes: each takes at most 0.7 GB."""


def require_folder(output: Path, option: str = "-o/--output") -> None:
    """Raise BadInput where neither the folder of an output is there nor the one that it would lie in: navsim makes one
    folder, but none for a mistyped path."""
    if not (output.parent.is_dir() or output.parent.parent.is_dir()):
        raise BadInput(as_problems(f"{output.parent}: no such folder; create it first or choose another {option}"))


def make_folder(output: Path) -> None:
    """Make the folder of an output file or folder where it is missing. Raises BadInput, as `require_folder`."""
    require_folder(output)
    try:
        output.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInput(as_problems(f"{output.parent}: cannot be made: {error.strerror or error}")) from None


def check_target(target: Path, sort: ResultKind, force: bool) -> None:
    """Raise BadInput, before any computation, if the path cannot be written or holds a file that must stay.

    A result of a different kind, or of more runs, stays unless `force`; a file that is not a result always stays.
    """
    from navsim.results.result import ResultError, check_writable

    try:
        check_writable(target)
        refuse_other(target, sort, force)
    except ResultError as error:
        raise BadInput(as_problems(error)) from None


def refuse_other(target: Path, sort: ResultKind, force: bool) -> None:
    """Raise ResultError if a result of this kind may not overwrite the existing file."""
    from navsim.results.result import ResultError, read_kind

    if not target.exists():
        return
    try:
        there = read_kind(target)
    except ResultError as error:
        raise ResultError(f"{error}; it is not overwritten, choose another -o/--output") from None
    if there != sort and not force:
        raise ResultError(
            f"{target}: holds another kind of result ({there}) than the new one ({sort}); "
            f"choose another -o/--output, or overwrite it with --force"
        )
    if there.count > sort.count > 0 and not force:
        raise ResultError(
            f"{target}: holds {there.count} runs, which {sort.count} would replace; "
            f"choose another -o/--output, or overwrite it with --force"
        )


@contextmanager
def locked_target(target: Path, kernels: str, speech: Reporter, workers: int) -> Iterator[None]:
    """Context of the computation of a result: it locks the target against other processes and removes leftovers of
    killed ones.

    It also says why the first work with these kernels (`runner.job.Job`) takes longer, and goes on saying so. With
    two workers, two processes compile them. Raises BadInput.
    """
    from navsim.compiler import jit
    from navsim.compiler.announcement import announced
    from navsim.results.atomic_write import Occupied, clean, locked

    with ExitStack() as held:
        try:
            held.enter_context(locked(target))
        except Occupied as error:
            raise BadInput(as_problems(f"{error}; wait for it, or choose another -o/--output")) from None
        except OSError as error:
            reason = error.strerror or error
            speech.warn(f"{target} cannot be locked ({reason}): let no other process write it")
        else:
            clean(target, owned=True)
        if not jit.is_warm(kernels):
            speech.say(jit.compiling())
            held.enter_context(_second_compiler(workers))
        # a study may come to kernels of other kinds later
        held.enter_context(announced(speech.say))
        yield


def _second_compiler(workers: int) -> AbstractContextManager[None]:
    """Context in which a second process compiles too, where the user and the machine have two cores for it."""
    from navsim.compiler import jit
    from navsim.compiler.second_process import second_process
    from navsim.runner.machine import available_memory, usable_cores

    def has_room() -> bool:
        available = available_memory()
        return available is None or available > _COMPILING_MEMORY

    return second_process(has_room) if jit.keeps() and min(workers, usable_cores()) >= 2 else nullcontext()


@dataclass(frozen=True)
class Written:
    """Files beside a result."""

    texts: list[Path]
    figures: list[Path]


def save(result: Result, target: Path, figures: Path | None) -> Written:
    """Write a result, its text files and, if requested, its figures. Raises ResultError.

    Figures of the result that it replaces are removed.
    """
    from navsim.report.figure_files import remove_former
    from navsim.report.view import draw, write_texts
    from navsim.results.result import write

    write(target, result)
    remove_former(target.parent, target.stem)
    texts = write_texts(result, target)
    return Written(texts, [] if figures is None else draw(result, figures, target.stem))


def figure_folder(figures: str | Path | None, target: Path, skipped: bool) -> Path | None:
    """Folder of the figures.

    figures: the option, a folder or the word `none`; a Path is always a folder. skipped: no figures unless a folder is
    given. Raises BadInput as `require_folder`, and for a file.
    """
    if figures == "none" or (figures is None and skipped):
        return None
    folder = target.parent if figures is None else Path(figures)
    if figures is not None:
        require_folder(folder, "--figures")
    if folder.exists() and not folder.is_dir():
        raise BadInput(as_problems(f"--figures {folder}: is a file, not a folder"))
    return folder
