"""Mirrored trajectories: axes that together are consistent, and are not of this world."""

from __future__ import annotations

from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, LEVEL_AXES, axes_letters, axes_matrix
from navsim.recording_checks.fix_checks import velocity_difference
from navsim.recording_checks.fix_readings import OF_ALL_COLUMNS, is_on_earth, with_all_columns_exchanged
from navsim.recording_checks.mistakes import Log, Mistake


def without_mirrors(found: list[Mistake], log: Log) -> list[Mistake]:
    """Replace axes that together make a mirrored trajectory consistent by the wrong sign that mirrors it.

    A negated longitude mirrors positions, and so do exchanged columns. Left-handed axes of velocities and
    accelerometers, with gyros of the other sense, mirror all else. The two cannot be distinguished, so navsim takes the
    one with fewer departures from the usual axes. If a mistake has as many, navsim names all.

    found: mistakes of the sensors; log: as written and corrected before these.
    """
    remedy = dict(found[0].remedies[0]) if found and found[0].remedies else {}
    axes = remedy.pop("imu.axes", None)
    gyro = remedy.pop("imu.gyro_axes", axes or log.imu.gyro_axes)
    accelerometer = remedy.pop("imu.accelerometer_axes", axes or log.imu.accelerometer_axes)
    if log.sentences or not np.isfinite(log.fixes.velocity[:, :2]).any():
        return found
    written = (log.gnss.position_axes, log.gnss.velocity_axes, gyro, accelerometer)
    mirrored: list[tuple[_Axes, dict[str, Any], int, str]] = [
        (each, {}, _departures(*each), f"{name} seems to have the other sign")
        for axis, name in enumerate(("latitude", "longitude"))
        for each in [_mirrored(axis, written)]
    ]
    mirrored += _exchanged(log, written)
    most = _departures(*written) - (not found)
    mirrored = [each for each in mirrored if each[2] <= most]
    if not mirrored:
        return found
    least = min(departures for *_, departures, _ in mirrored)
    keys = ("gnss.position_axes", "gnss.velocity_axes", "imu.gyro_axes", "imu.accelerometer_axes")
    now = (log.gnss.position_axes, log.gnss.velocity_axes, log.imu.gyro_axes, log.imu.accelerometer_axes)
    chosen = [each for each in mirrored if each[2] == least]
    chosen.sort(key=lambda each: not each[1])  # columns in another order are the more usual mistake
    seems = [text for *_, text in chosen]
    remedies = [
        {key: value for key, value, before in zip(keys, each, now, strict=True) if value != before} | columns | remedy
        for each, columns, *_ in chosen
    ]
    if least == _departures(*written):
        seems.append(found[0].seems)
        remedies.append(dict(found[0].remedies[0]))
    evidence = (
        f"velocity_axes {written[1]} needs gyro_axes {gyro} and accelerometer_axes {accelerometer}: together they "
        "mirror the world"
    )
    return [Mistake(evidence, " or ".join(seems), tuple(remedies), "gnss")]


_Axes = tuple[str, str, str, str]
"""Axes of positions, velocities, gyros and accelerometers."""


def _mirrored(axis: int, written: _Axes) -> _Axes:
    """The same recording with north (axis 0) or east (1) reversed: only the fixes' positions differ. The body is
    mirrored left to right, which keeps forward and down; a mirror reverses the sense of rotations."""
    level = np.eye(3)
    level[axis, axis] = -1.0
    signs = np.array(conventions.POSITION_AXES[written[0]]) * np.diag(level)[:2]
    position = next(name for name, each in conventions.POSITION_AXES.items() if np.array_equal(each, signs))
    return position, *_turned(level, written)


def _turned(level: np.ndarray, written: _Axes) -> tuple[str, str, str]:
    """Axes of velocities, gyros and accelerometers in the world mirrored by `level` (3, 3)."""
    _, velocity, gyro, accelerometer = written
    body = np.diag([1.0, -1.0, 1.0])
    return (
        axes_letters(level @ axes_matrix(velocity, LEVEL_AXES), LEVEL_AXES),
        axes_letters(-body @ axes_matrix(gyro, BODY_AXES), BODY_AXES),
        axes_letters(body @ axes_matrix(accelerometer, BODY_AXES), BODY_AXES),
    )


def _exchanged(log: Log, written: _Axes) -> list[tuple[_Axes, dict[str, Any], int, str]]:
    """The mirror of exchanged columns of latitude and longitude, if the positions then agree with the velocities as
    well as before: axes, columns, departures, statement."""
    cured, remedy = with_all_columns_exchanged(log)
    if (
        not is_on_earth(cured.fixes)
        or not velocity_difference(cured.fixes) <= 1.5 * velocity_difference(log.fixes) + 0.02
    ):
        return []
    axes = written[0], *_turned(np.eye(3)[[1, 0, 2]], written)
    return [(axes, {"gnss.columns": remedy["gnss.columns"]}, 1 + _departures(*axes), OF_ALL_COLUMNS)]


def _departures(position: str, velocity: str, gyro: str, accelerometer: str) -> int:
    """Number of declarations that differ from the usual axes; one mounting of both triads counts once."""
    sensors = int(gyro != "FRD") if gyro == accelerometer else (gyro != "FRD") + (accelerometer != "FRD")
    return (position != "NE") + (velocity != "NED") + sensors
