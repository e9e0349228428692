"""Mirrored trajectories: axes that together are consistent, and are not of this world."""

from __future__ import annotations

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, LEVEL_AXES, axes_letters, axes_matrix
from navsim.recording_checks.mistakes import Log, Mistake


def without_mirrors(found: list[Mistake], log: Log) -> list[Mistake]:
    """Replace axes that together make a mirrored trajectory consistent by the wrong sign that mirrors it.

    A negated longitude mirrors positions. Left-handed axes of velocities and accelerometers, with gyros of the other
    sense, mirror all else. The two cannot be distinguished, so navsim takes the one with fewer departures from the
    usual axes.

    found: mistakes of the sensors; log: as written and corrected before these.
    """
    remedy = dict(found[0].remedies[0]) if found and found[0].remedies else {}
    axes = remedy.pop("imu.axes", None)
    gyro = remedy.pop("imu.gyro_axes", axes or log.imu.gyro_axes)
    accelerometer = remedy.pop("imu.accelerometer_axes", axes or log.imu.accelerometer_axes)
    if log.sentences or not np.isfinite(log.fixes.velocity[:, :2]).any():
        return found
    written = (log.gnss.position_axes, log.gnss.velocity_axes, gyro, accelerometer)
    mirrored = [each for axis in (0, 1) if _departures(*(each := _mirrored(axis, written))) < _departures(*written)]
    if not mirrored:
        return found
    least = min(_departures(*each) for each in mirrored)
    keys = ("gnss.position_axes", "gnss.velocity_axes", "imu.gyro_axes", "imu.accelerometer_axes")
    now = (log.gnss.position_axes, log.gnss.velocity_axes, log.imu.gyro_axes, log.imu.accelerometer_axes)
    chosen = [each for each in mirrored if _departures(*each) == least]
    seems = [
        f"{name} seems to have the other sign"
        for name, axis in (("latitude", 0), ("longitude", 1))
        if any(each[0][axis] != written[0][axis] for each in chosen)
    ]
    remedies = tuple(
        {key: value for key, value, before in zip(keys, each, now, strict=True) if value != before} | remedy
        for each in chosen
    )
    evidence = (
        f"velocity_axes {written[1]} needs gyro_axes {gyro} and accelerometer_axes {accelerometer}: together they "
        "mirror the world"
    )
    return [Mistake(evidence, " or ".join(seems), remedies, "gnss")]


_Axes = tuple[str, str, str, str]
"""Axes of positions, velocities, gyros and accelerometers."""


def _mirrored(axis: int, written: _Axes) -> _Axes:
    """The same recording with north (axis 0) or east (1) reversed: only the fixes' positions differ. The body is
    mirrored left to right, which keeps forward and down; a mirror reverses the sense of rotations."""
    position, velocity, gyro, accelerometer = written
    level, body = np.eye(3), np.diag([1.0, -1.0, 1.0])
    level[axis, axis] = -1.0
    signs = np.array(conventions.POSITION_AXES[position]) * np.diag(level)[:2]
    return (
        next(name for name, each in conventions.POSITION_AXES.items() if np.array_equal(each, signs)),
        axes_letters(level @ axes_matrix(velocity, LEVEL_AXES), LEVEL_AXES),
        axes_letters(-body @ axes_matrix(gyro, BODY_AXES), BODY_AXES),
        axes_letters(body @ axes_matrix(accelerometer, BODY_AXES), BODY_AXES),
    )


def _departures(position: str, velocity: str, gyro: str, accelerometer: str) -> int:
    """Number of declarations that differ from the usual axes; one mounting of both triads counts once."""
    sensors = int(gyro != "FRD") if gyro == accelerometer else (gyro != "FRD") + (accelerometer != "FRD")
    return (position != "NE") + (velocity != "NED") + sensors
