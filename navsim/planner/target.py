"""The one file that the planner writes, and whether it may."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from navsim.planner.proposal import PlannedScenario
from navsim.results import files
from navsim.results.result import ResultError, write_text
from navsim.scenario.landing import Landing
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import MOST_BYTES, InputError, parse


@dataclass
class Target:
    """The file. written: content written by this page, None for nothing yet."""

    path: Path
    written: str | None = None

    def asks(self) -> bool:
        """Whether the file has content that this page did not write."""
        try:
            return files.content(self.path, MOST_BYTES) != (self.written or "").encode() or self.written is None
        except FileNotFoundError:
            return False
        except OSError:
            return True

    def save(self, proposal: PlannedScenario, consent: bool) -> str:
        """Write the scenario, and return messages about it.

        Raises `Consent`, and writes nothing, if another file would be replaced without consent. Raises ResultError,
        InputError.
        """
        if self.asks() and not consent:
            raise Consent(f"{self.path} is there already. Replace it?")
        found = proposal.text()
        document = parse(found.text, str(self.path), self.path.resolve().parent)
        validated(Landing, document)
        write_text(self.path, found.text)
        self.written = found.text
        proposal.saved = proposal.document.data
        lost = " The changed section lost its comments: it could not be changed line by line." if found.lost else ""
        return f"Saved. Fly it: navsim run {self.path}{lost}"


class Consent(Exception):
    """The user must be asked first."""


__all__ = ["Consent", "InputError", "ResultError", "Target"]
