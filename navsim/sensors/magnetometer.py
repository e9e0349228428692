"""Magnetometer of three axes.

    y = R (C' (b + e + f d) + S C' b + h) + noise,  f = exp(-height / H)

- b: field of the Earth, NED; e: error of its model; d: disturbance at the ground
- C: body to NED; R: body to sensor axes
- h: hard iron; S: soft iron (scale factors and misalignments), both in body axes

Small products are left out.

Sources: [1] Groves (2013), section 6.1.1 (hard and soft iron, eqs. 6.3 and 6.4). [2] `docs/theory/magnetometer.md`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.filter.measurement_kinds import MAGNETIC, MagneticTable
from navsim.filter.states import Block
from navsim.sensors.aiding import AidingSensor, SensorError, estimated
from navsim.trajectory.kinematics import Frame, Moving

_STATES = ("hard_iron", "field_model", "scale", "misalignment_next", "misalignment_previous", "disturbance")
"""Names of the filter's states for each error of `MagneticErrors.listed`."""
_AXES = (0, 3, 0, 0, 0, 6)
"""First number of each in `filter.measurement_kinds`."""
_INPUT = (None, None, 0, 1, 2, None)
"""Field that a soft iron error multiplies, as `Block.input_axis`."""


@dataclass(frozen=True)
class MagneticErrors:
    """1 sigma of the time-correlated errors."""

    hard_iron: float
    """Constant offset of each axis, uT."""
    field_model: float
    """Constant error of the field model along north, east and down each, uT."""
    scale: float
    """Scale factor of each axis."""
    misalignment: float
    """Sensitivity of an axis to the field along another one."""
    disturbance: float
    """Field of what lies on the ground, along north, east and down each, at the ground, uT."""
    disturbance_time: float
    """Correlation time of the disturbance, s."""

    def listed(self) -> tuple[SensorError, ...]:
        """The errors, in the order of `_STATES`."""
        return (
            SensorError("hard_iron", self.hard_iron, math.inf),
            SensorError("field_model", self.field_model, math.inf),
            SensorError("soft_iron", self.scale, math.inf),
            SensorError("soft_iron", self.misalignment, math.inf),
            SensorError("soft_iron", self.misalignment, math.inf),
            SensorError("disturbance", self.disturbance, self.disturbance_time),
        )


@dataclass(frozen=True)
class MagneticDesign:
    """Filter model of a `Magnetometer`, whose fields it shares."""

    noise: float
    mounting: np.ndarray
    latency: float
    field: np.ndarray
    fades: float
    errors: MagneticErrors
    """Errors that the filter estimates; those of size 0 have no states."""


@dataclass(frozen=True)
class Magnetometer(AidingSensor):
    """Magnetometer: the magnetic field along three axes of its own."""

    name, kind, unit, components = "magnetometer", MAGNETIC, "uT", 3
    numbers = ("field x", "field y", "field z")

    rate: float
    """Hz."""
    latency: float
    """s."""
    noise: float
    """1 sigma of the white noise of each axis, uT."""
    mounting: np.ndarray
    """(3, 3) from body axes to those of the sensor."""
    field: np.ndarray
    """(3,) field of the Earth at the runway, NED, uT. It holds for the whole flight."""
    ground: float
    """Height of the runway above the ellipsoid, m."""
    fades: float
    """Height in which the disturbance falls to 1 / e, m."""
    true_errors: MagneticErrors
    design: MagneticDesign
    """Filter model."""

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Field (m, 3) of the Earth along the axes of the sensor, uT."""
        return self._ned_to_body(flight, time) @ self.field @ self.mounting.T

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 3) of the white noise, uT."""
        return np.full_like(exact, self.noise)

    def table(self, frame: Frame, measured: np.ndarray) -> MagneticTable:
        """Fields as the filter takes them, along the body axes."""
        its = self.design
        field = np.einsum("ij,mj...->mi...", self.slope, measured)
        return MagneticTable(np.ascontiguousarray(field), its.noise**2, its.field, self.ground, its.fades)

    @property
    def slope(self) -> np.ndarray:
        """Derivatives of the innovation, in body axes, by the field along the axes of the sensor."""
        return self.design.mounting.T

    @property
    def design_latency(self) -> float:
        """Age of a measurement on arrival in the filter model, s."""
        return self.design.latency

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the sensor."""
        its = self.design
        return (
            (self.noise, self.latency, self.fades) == (its.noise, its.latency, its.fades)
            and self.true_errors == its.errors
            and np.array_equal(self.mounting, its.mounting)
            and np.array_equal(self.field, its.field)
        )

    @property
    def errors(self) -> tuple[SensorError, ...]:
        """Time-correlated errors."""
        return self.true_errors.listed()

    def effects(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Derivatives (m, 3, 3) of the numbers by the components of each error."""
        axes = self._ned_to_body(flight, time)
        along = axes @ self.field
        own = np.arange(3)

        def of_soft_iron(through: int) -> np.ndarray:
            out = np.zeros((time.size, 3, 3))
            out[:, own, own] = along[:, (own + through) % 3]
            return out

        height = np.maximum(flight.llh(time)[:, 2] - self.ground, 0.0)
        fade = np.exp(-height / self.fades)[:, None, None]
        hard = np.broadcast_to(np.eye(3), (time.size, 3, 3))
        in_body = (hard, axes, of_soft_iron(0), of_soft_iron(1), of_soft_iron(2), fade * axes)
        return tuple(self.mounting @ effect for effect in in_body)

    @property
    def followed(self) -> tuple[int, ...]:
        """The errors that the filter estimates."""
        return estimated(self.design.errors.listed())

    def states(self, step: float) -> tuple[tuple[Block, float], ...]:
        """States for these errors: uT, and shares of the field."""
        out = []
        for k in self.followed:
            error = self.design.errors.listed()[k]
            drive = -math.expm1(-2.0 * step / error.time) / step * error.sigma**2
            unit = "1" if error.name == "soft_iron" else "uT"
            block = Block(
                f"{self.name}_{_STATES[k]}", unit, MAGNETIC, _INPUT[k], 1.0 / error.time, drive, _AXES[k],
                of_body=error.name.endswith("iron"),
            )  # fmt: skip
            out.append((block, error.sigma))
        return tuple(out)

    def _ned_to_body(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Rotations (m, 3, 3) from NED to body axes."""
        return np.swapaxes(flight.motion(time).c_nb, 1, 2)
