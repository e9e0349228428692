"""The landing circuit that both tracking systems fly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from navsim.scenario_files.base import DEG, LONGEST_FLIGHT, ListOf, Pair, Section, Signed, Triple

if TYPE_CHECKING:
    from navsim.companions.circuit import Circuit

Command = Triple
"""Start s, duration s, increment."""


class CircuitSection(Section):
    """A right-hand circuit about the radar, base and final turns; angles start from level flight without roll."""

    north_m: Signed = 4000.0
    """place at the start, north of the radar"""
    east_m: Signed = 7600.0
    """place at the start, east of the radar"""
    height_m: Annotated[float, Field(ge=0.0, le=1e5)] = 450.0
    """height at the start, above the radar"""
    track_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 180.0
    """track at the start, clockwise from north"""
    speed_m_s: Annotated[float, Field(ge=1.0, le=2000.0)] = 100.0
    """speed at the start"""
    roll_deg: ListOf[Command] = (
        (160.0, 6.0, 25.0),
        (189.346, 6.0, -25.0),
        (241.652, 6.0, 25.0),
        (267.907, 6.0, -25.0),
    )
    """raised-cosine ramps of the roll: start s, duration s, increment"""
    speed_change_m_s: ListOf[Command] = (
        (40.0, 40.0, -15.0),
        (195.346, 30.0, -9.0),
        (277.907, 20.0, -6.0),
    )
    """raised-cosine ramps of the speed: start s, duration s, increment"""
    path_angle_deg: ListOf[Command] = ((283.795, 8.0, -3.0),)
    """raised-cosine ramps of the path angle: start s, duration s, increment"""
    duration_s: Annotated[float, Field(gt=10.0, le=LONGEST_FLIGHT)] = 406.0
    """length of the flight"""
    manoeuvre_s: ListOf[Pair] = ((160.0, 195.346), (241.652, 273.907))
    """stretches in which errors are counted as those of the manoeuvre"""
    straight_s: ListOf[Pair] = ((60.0, 160.0),)
    """stretches in which errors are counted as those of straight flight"""

    def scans(self, period: float) -> int:
        """Number of scans of this period, s, within the circuit."""
        return int(self.duration_s / period + 1e-9) + 1

    def circuit(self) -> Circuit:
        """The circuit in SI units."""
        import numpy as np

        from navsim.companions.circuit import Circuit

        def table(rows: tuple[tuple[float, float, float], ...], unit: float) -> np.ndarray:
            return np.array(rows, dtype=float).reshape(-1, 3) * np.array([1.0, 1.0, unit])

        return Circuit(
            self.north_m, self.east_m, self.height_m, self.track_deg * DEG, self.speed_m_s,
            table(self.roll_deg, DEG), table(self.speed_change_m_s, 1.0), table(self.path_angle_deg, DEG),
            self.duration_s,
        )  # fmt: skip
