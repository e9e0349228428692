"""Warnings about the input, before there is a result: names of findings, and conditions that they violate."""

from __future__ import annotations

FIX, CONSISTENT = "fix", "consistent"
"""Conditions that a finding violates: every epoch has a fix (`--require-fix`), the filter is consistent
(`--require-consistent`)."""
BEACONS, SIGMA_WITH_BEACONS = "beacons", "sigma_with_beacons"
"""Names of findings: ranges to beacons show a position badly; the filter's sigma with them is too small."""
SECOND_ORDER = "second_order"
"""Name of the finding that a filter estimates the second order of ranges although its scenario does not say so."""


class Note(str):
    """A warning about the input, with the name of its finding and the conditions that it violates."""

    name: str
    against: tuple[str, ...]

    def __new__(cls, text: str, name: str = "input", against: tuple[str, ...] = ()) -> Note:
        out = super().__new__(cls, text)
        out.name, out.against = name, against
        return out


def labelled(text: str, name: str = "input") -> str:
    """A warning as printed: with the name by which docs/warnings.md has it, where it has one of its own."""
    name = text.name if isinstance(text, Note) else name
    return text if name == "input" else f"{text} [{name}]"
