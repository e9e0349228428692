"""Where the navigation starts: section `initial_errors`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from navsim.scenario_files.base import NonNegative, Section, Triple


class Vectors(Section):
    """One value for each of north, east, down."""

    attitude_deg: Triple = (0.0, 0.0, 0.0)
    """attitude error, a rotation vector"""
    position_m: Triple = (0.0, 0.0, 0.0)
    """position error"""
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    """velocity error"""


class InitialErrorsSection(Section):
    """Errors (truth - estimate) the navigation starts with: 1 sigma per axis, drawn per run."""

    attitude_deg: Annotated[float, Field(ge=0.0, le=60.0)] = 5.0
    """1 sigma of the tilt about north and about east, and of the heading error about down"""
    position_m: NonNegative = 10.0
    """1 sigma of the position error along each axis"""
    velocity_m_s: NonNegative = 1.0
    """1 sigma of the velocity error along each axis"""
    fixed: Vectors | None = None
    """the errors themselves, instead of drawing them; the filter still starts from the sigmas"""
