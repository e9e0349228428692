"""Result file as a Python object."""

from __future__ import annotations

import difflib
import os
import shutil
import weakref
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navsim.runner.errors import BadInput, RunFailed, as_problems

if TYPE_CHECKING:
    import numpy as np
    import xarray

    from navsim.report.table import Table
    from navsim.results.findings import Finding
    from navsim.results.result import Result

INSTALL = "pip install '.[xarray]' in the folder of navsim"


@dataclass(frozen=True)
class Verdict:
    """Verdict on a requirement."""

    statement: str
    """The requirement in words."""
    verdict: str
    """met, not met, or undecided."""
    value: float
    """Value of the required quantity."""
    low: float
    """Lower end of its 95 % interval."""
    high: float
    """Upper end."""
    limit: float
    """Required limit, in the same unit."""


def load(path: str | os.PathLike[str]) -> xarray.DataTree:
    """Open a result file as an xarray tree; numbers are read when they are used.

    Parameters
    ----------
    path : path
        The result file.

    Returns
    -------
    xarray.DataTree

    Raises
    ------
    BadInput
        The file is not a result.
    ModuleNotFoundError
        xarray or h5netcdf (the extra `xarray`) is not installed.
    """
    file = Path(path).expanduser()
    _read(file)
    try:
        import h5netcdf  # type: ignore[import-untyped]  # noqa: F401  # the engine
        import xarray
    except ModuleNotFoundError as error:
        if error.name not in ("xarray", "h5netcdf", "pandas"):
            raise
        text = f"results are opened as a tree by xarray with h5netcdf, which are not installed here: {INSTALL}"
        raise ModuleNotFoundError(text, name=error.name) from None
    return xarray.open_datatree(file, engine="h5netcdf")


def _read(path: Path) -> Result:
    from navsim.results.result import ResultError, read

    try:
        return read(path)
    except ResultError as error:
        from navsim.runner.opening import scenario_instead

        raise BadInput(as_problems(scenario_instead(path) or error)) from None


class ResultFile:
    """A result file: its variables, findings, verdicts and tables.

    Parameters
    ----------
    path : path
        The result file.

    Attributes
    ----------
    path : Path
        The file.
    files : list of Path
        Texts and figures written with it.
    stopped : str
        Why the work ended early; "" if it is complete.

    Raises
    ------
    BadInput
        The file is not a result.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path).expanduser()
        self.files: list[Path] = []
        self.stopped = ""
        self._result = _read(self.path)
        self._here()

    @classmethod
    def _of(cls, path: Path, files: list[Path], stopped: str, temporary: Path | None) -> ResultFile:
        """The result that was just computed. temporary: folder that is deleted with the object."""
        made = cls(path)
        made.files, made.stopped = files, stopped
        if temporary is not None:
            weakref.finalize(made, shutil.rmtree, temporary, True)
        return made

    def _here(self) -> Any:
        from navsim.report.view import view
        from navsim.results.result import ResultError

        try:
            return view(self._result.attributes["kind"])
        except ResultError as error:
            raise BadInput(as_problems(f"{self.path}: {error}")) from None

    @property
    def kind(self) -> str:
        """Kind of the result: landing, sweep, optimize, replay, ..."""
        return str(self._result.attributes["kind"])

    @property
    def attributes(self) -> dict[str, Any]:
        """Root attributes: seed, versions, resolved scenario."""
        return dict(self._result.attributes)

    @property
    def tree(self) -> xarray.DataTree:
        """The file as an xarray tree, opened anew; see `load`."""
        return load(self.path)

    @cached_property
    def findings(self) -> list[Finding]:
        """Warnings of the study."""
        from navsim.results.findings import of

        return of(self._result)

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """Verdicts on the scenario's requirements; empty without requirements."""
        branch = "/summary/requirements"
        if f"{branch}/verdict" not in self._result:
            return []
        names = ("statement", "verdict", "value", "limit")
        statement, verdict, interval, limit = (self._result[f"{branch}/{name}"] for name in names)
        return [
            Verdict(str(what), str(how), float(value), float(low), float(high), float(most))
            for what, how, (value, low, high), most in zip(statement, verdict, interval, limit, strict=True)
        ]

    def __getitem__(self, path: str) -> np.ndarray[Any, Any]:
        """A variable by its path in the file, such as `summary/rms/horizontal`, read from the file.

        Raises
        ------
        KeyError
            The variable does not exist.
        RunFailed
            The file was damaged meanwhile.
        """
        from navsim.results.former_names import present_path
        from navsim.results.result import ResultError

        whole = present_path("/" + path.strip("/"))
        if whole not in self._result:
            near = difflib.get_close_matches(whole, self._result.variables, n=1)
            raise KeyError(f"{path}{f'; did you mean {near[0][1:]!r}?' if near else ''}")
        try:
            return self._result[whole]
        except ResultError as error:
            raise RunFailed(as_problems(error)) from None

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Summary as plain data with the names of the file, as `navsim show --json` prints it; None for unknown
        values."""
        from navsim.report.view import plain

        return plain(self._result)

    def tables(self) -> list[Table | str]:
        """Tables of `navsim show`, and the text between them."""
        return list(self._here().tables([(self.path.stem, self._result)]))

    def show(self) -> str:
        """The tables as text."""
        from navsim.report.table import text

        return text(self.tables())

    def __repr__(self) -> str:
        return f"<navsim.ResultFile {str(self.path)!r}, kind {self.kind}, {len(self.findings)} finding(s)>"

    def __str__(self) -> str:
        return self.show()

    def _repr_html_(self) -> str:
        from navsim.report.table import html

        warned = [f"warning: {found.text}" for found in self.findings]
        return html([*self.tables(), *warned])
