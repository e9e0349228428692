"""Reading of the files of a recorded flight: samples, fixes or ranges, their checks and checksums."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from navsim.formats import conventions
from navsim.formats.recorded_data import Fixes, Headings, Ranges, Samples
from navsim.formats.recording import is_nmea, read_attitude, read_fixes, read_headings, read_imu
from navsim.formats.text import Dropped, FileError
from navsim.geodesy.magnetic import NoMagneticModel, declination
from navsim.gnss.timescales import gps_from_utc
from navsim.ranging import recording
from navsim.ranging.recording import RangeLog
from navsim.ranging.scenario import RECEIVER
from navsim.recording_checks.diagnosis import examine
from navsim.recording_checks.mistakes import Log, Mistake, relative_units
from navsim.replays.aids import antenna_axis
from navsim.replays.recorded_ranges import merge_messages, read_messages, read_ranges
from navsim.replays.scenario import Replay, Sensors
from navsim.replays.single_point import PositioningOptions
from navsim.results import files
from navsim.runner.job import JobError
from navsim.scenario_files.base import DEG
from navsim.scenario_files.source import Document, InputError, Place, Problem

_MOST_PDOP = 30.0
"""Largest PDOP of fixes from ranges that are flown, RTKLIB's: their sigma is that of all fixes."""
MOST_DAMAGED = 0.1
"""Share of rows outside of physical limits up to which they are damage; of more, the unit may be another one."""
USUAL_HEADING_SIGMA, MAGNETIC_ERROR_DEG = 2.0 * DEG, 5.0
"""1 sigma of the noise of a measured heading, rad, and of the lasting error of a magnetic one, deg, if not given."""
LEAST_SAMPLES, LEAST_FIXES = 10, 4
"""Least number of samples and fixes for an alignment."""


class ReplayError(JobError):
    """A recording that can be read, but not flown."""


@dataclass(frozen=True)
class ReadLog:
    """Files of a log: data, scenario with their checksums, remarks."""

    scenario: Replay
    samples: Samples
    fixes: Fixes
    ranges: Ranges | None
    warnings: list[str]
    not_judged: tuple[str, ...]
    reference: tuple[np.ndarray, np.ndarray] | None = None
    """Times (r,), s, and roll, pitch, yaw (r, 3), rad, by another system."""
    headings: Headings | None = None
    beacons: RangeLog | None = None


def read(scenario: Replay, document: Document) -> ReadLog:
    """Read and check. Raises InputError for files that cannot be used or do not seem to match the log."""
    motion, place, fewest = scenario.imu.convention(), scenario.gnss.convention(), scenario.gnss.min_satellites
    tables = [_table(document, scenario, "imu", lambda path, *how: read_imu(path, how[0], motion, how[1]))]
    ranges = None
    if scenario.gnss.navigation is None:
        simulated = scenario.gnss.simulator_fixes

        def fixes_of(path: Path, lenient: bool, limited: bool) -> Any:
            return read_fixes(path, fewest, lenient, place, limited, simulated)

        tables.append(_table(document, scenario, "gnss", fixes_of))
    else:
        of_ranges, ranges = _observed(document, scenario)
        tables.append(of_ranges)
    reference = None
    if scenario.reference is not None:
        time, rpy, dropped = _read(document, scenario, "reference", read_attitude)
        reference = time, rpy
    measured = None
    if scenario.heading is not None:
        section = scenario.heading

        def headings_of(path: Path) -> Any:
            return read_headings(path, scenario.skip_bad_records, section.columns, section.time_unit)

        measured = _read(document, scenario, "heading", headings_of)
    beacons = _beacons(scenario, document)
    scenario = _pinned(scenario, document)
    warnings, not_judged = _checked(scenario, document, *(table.judged for table in tables))
    for table in tables:
        if table.refusal is not None:
            raise table.refusal
        warnings += table.lost.reasons()
    if scenario.reference is not None:
        warnings += dropped.reasons()
    samples, fixes = (table.rows for table in tables)
    headings = None
    if measured is not None:
        headings = _true_headings(scenario, document, fixes, *measured[:3])
        warnings += measured[3].reasons()
    warnings += () if beacons is None else beacons.warnings
    return ReadLog(scenario, samples, fixes, ranges, warnings, tuple(not_judged), reference, headings, beacons)


def _beacons(scenario: Replay, document: Document) -> RangeLog | None:
    """Ranges of beacons, if there are any. Raises InputError, also for beacons in local axes."""
    if scenario.ranges is None or scenario.sources is None:
        return None
    end = np.inf if scenario.end_s is None else scenario.end_s - scenario.ranges.time_offset_s
    log = recording.read_ranges(scenario.ranges, scenario.sources, (-np.inf, end), document)
    if log.sources.origin is None:
        key = ("sources", "positions" if scenario.sources.positions else "file")
        message = "local axes do not say where on Earth a beacon stands; give lat_deg, lon_deg and height_m"
        raise InputError([Problem(document.place(key), ".".join(key), message)])
    known = (*log.sources.names, RECEIVER)
    if scenario.clocks is not None and scenario.clocks.datum not in known:
        message = (
            f"{scenario.clocks.datum} has no range, so no other clock can be counted against its own; give one of "
        )
        key = ("clocks", "datum")
        raise InputError([Problem(document.place(key), ".".join(key), message + ", ".join(known))])
    return log


def _true_headings(
    scenario: Replay, document: Document, fixes: Fixes, time: np.ndarray, value: np.ndarray, sigma: np.ndarray
) -> Headings:
    """Measured headings, spaced, at their times of validity, from true north. Raises InputError without a
    declination."""
    section = scenario.heading
    assert section is not None
    usual = USUAL_HEADING_SIGMA if section.sigma_deg is None else section.sigma_deg * DEG
    if section.source == "magnetic":
        value = value + DEG * _declination(scenario, document, fixes)
    lasting = section.error_sigma_deg
    if lasting is None:
        lasting = MAGNETIC_ERROR_DEG if section.source == "magnetic" else 0.0
    keep = thin_times(time, section.spacing_s)
    sigma = np.where(np.isnan(sigma), usual, sigma)
    return Headings(
        time[keep] - section.latency_s, value[keep], sigma[keep], antenna_axis(section), lasting * DEG
    )  # fmt: skip


def _declination(scenario: Replay, document: Document, fixes: Fixes) -> float:
    """Declination of the field at the first fix, deg. Raises InputError without a model of it."""
    assert scenario.heading is not None
    if scenario.heading.declination_deg is not None:
        return scenario.heading.declination_deg
    lat, lon, height = fixes.llh[0]
    epoch = scenario.epoch
    try:
        return declination(lat / DEG, lon / DEG, height, epoch.year + (epoch.timetuple().tm_yday - 1) / 365.25)
    except NoMagneticModel as error:
        problem = Problem(document.place(("heading",)), "heading.declination_deg", f"left out, it {error}")
        raise InputError([problem]) from None


def thin_times(times: np.ndarray, spacing: float) -> np.ndarray:
    """Times (m,) at least `spacing` seconds after the last one kept (k,)."""
    kept: list[int] = []
    for index, time in enumerate(times):
        if not kept or time - times[kept[-1]] >= spacing:
            kept.append(index)
    return np.array(kept, dtype=np.int64)


def _checked(scenario: Replay, document: Document, samples: Samples, fixes: Fixes) -> tuple[list[str], list[str]]:
    """Warnings about probable mistakes in how the recording is written, and about unchecked quantities.

    Raises InputError if it cannot be used.
    """
    if scenario.checks == "off":
        return [], ["everything: checks are off"]
    declared = _declared_axes(scenario.imu)
    log = Log(
        samples,
        fixes,
        scenario.imu.convention(),
        scenario.gnss.convention(),
        latency=scenario.gnss.latency_s,
        first=-np.inf if scenario.begin is None else scenario.begin,
        last=np.inf if scenario.end_s is None else scenario.end_s,
        sentences=is_nmea(document.resolve(("gnss", "file"), scenario.gnss.file), scenario.skip_bad_records),
        declared=frozenset(key for key, given in declared.items() if given),
    )
    examined = examine(log)
    found = [_as_declared(mistake, declared) for mistake in examined.mistakes]
    if found and scenario.checks == "refuse":
        refused = [(_blamed(document, mistake), mistake) for mistake in found]
        raise InputError([
            Problem(document.place(key), ".".join(key), f"{mistake} (`checks: warn` replays it nevertheless)")
            for key, mistake in refused
        ])  # fmt: skip
    return [str(mistake) for mistake in found], examined.not_judged


def _blamed(document: Document, mistake: Mistake) -> tuple[str, ...]:
    """The first key of the log that a remedy would change, else that of the file."""
    keys = [tuple(key.split(".")) for remedy in mistake.remedies for key in remedy]
    return next((key for key in keys if key in document.keys), (mistake.section, "file"))


def _declared_axes(imu: Sensors) -> dict[str, bool]:
    """Keys of the axes of each triad, and whether the log has them."""
    return {f"imu.{name}_axes": getattr(imu, f"{name}_axes") is not None for name in ("gyro", "accelerometer")}


def _as_declared(mistake: Mistake, declared: Mapping[str, bool]) -> Mistake:
    """The mistake with remedies by the keys of the axes that the log has: those of a triad precede those of both."""
    own = [key for key, given in declared.items() if given]
    rest = ["imu.axes"] if len(own) < len(declared) else []

    def written(remedy: Mapping[str, Any]) -> dict[str, Any]:
        out = dict(remedy)
        if own and (axes := out.pop("imu.axes", None)) is not None:
            out |= dict.fromkeys([*rest, *own], axes)
        return out

    return replace(mistake, remedies=tuple(map(written, mistake.remedies)))


@dataclass(frozen=True)
class _Table:
    """Rows of a file."""

    judged: Any
    """Rows for the checks."""
    rows: Any
    """Rows for the filter."""
    lost: Dropped
    """Rows that were left out."""
    refusal: InputError | None = None
    """Why the rows are unusable, unless the checks find a better reason."""


def _table(
    document: Document, scenario: Replay, section: Literal["imu", "gnss"], reader: Callable[[Path, bool, bool], Any]
) -> _Table:
    """Read a file with a reader of (path, lenient, limited). Raises InputError.

    Values outside of physical limits are damage, or a wrong unit. If there are many, the checks include them, so that
    the wrong unit is found.
    """
    rows, lost = _read(document, scenario, section, lambda path: reader(path, scenario.skip_bad_records, False))
    if lost.outside is None:
        return _Table(rows, rows, lost)
    try:
        within, left = _read(document, scenario, section, lambda path: reader(path, True, True))
    except InputError as too_few:
        lost.outside.salvageable = False
        refusal = too_few if scenario.skip_bad_records else _refused(document, scenario, section, lost.outside)
        return _Table(rows, rows, lost, refusal)
    judged = within if within.time.size >= (1.0 - MOST_DAMAGED) * rows.time.size else rows
    if scenario.skip_bad_records:
        return _Table(judged, within, left)
    return _Table(judged, rows, lost, _refused(document, scenario, section, lost.outside))


def _observed(document: Document, scenario: Replay) -> tuple[_Table, Ranges]:
    """The fixes of RINEX observations, and their ranges. Raises InputError."""
    gnss, dropped = scenario.gnss, Dropped(scenario.skip_bad_records)
    several = []
    for i, name in enumerate(gnss.navigation or ()):
        path = document.resolve(("gnss", "navigation"), name)
        place = document.place(("gnss", "navigation"))
        try:
            several.append(read_messages(path, scenario.skip_bad_records, dropped, gnss.wanted()))
        except FileError as error:
            at = Place(str(path), error.line, 1) if error.line else place
            raise InputError([Problem(at, f"gnss.navigation[{i}]", f"{name}: {error.message}")]) from None
        except OSError as error:
            message = f"{name}: cannot be read: {error.strerror or error} ({path})"
            raise InputError([Problem(place, f"gnss.navigation[{i}]", message)]) from None
    shift = gnss.time_offset_s - float(gps_from_utc(scenario.epoch.timestamp()))
    messages = merge_messages(several)
    options = PositioningOptions(mask=gnss.mask_deg * DEG, troposphere=gnss.atmosphere, most_pdop=_MOST_PDOP)
    fixes, ranges = _read(
        document, scenario, "gnss",
        lambda path: read_ranges(path, messages, options, gnss.min_satellites, shift, dropped),
    )  # fmt: skip
    return _Table(fixes, fixes, dropped), ranges


def _read(document: Document, scenario: Replay, section: str, reader: Callable[[Path], Any]) -> Any:
    name = getattr(scenario, section).file
    path = document.resolve((section, "file"), name)
    where = document.place((section, "file"))
    key = f"{section}.file"
    try:
        return reader(path)
    except FileError as error:
        raise _refused(document, scenario, section, error) from None
    except OSError as error:
        message = f"{name}: cannot be read: {error.strerror or error} ({path})"
        raise InputError([Problem(where, key, message)]) from None


def _refused(document: Document, scenario: Replay, section: str, error: FileError) -> InputError:
    """A file that cannot be used, at its line."""
    where = document.place((section, "file"))
    path = document.resolve((section, "file"), getattr(scenario, section).file)
    place = Place(str(path), error.line, 1) if error.line else where
    cure = "; `skip_bad_records: true` takes the intact part" if error.salvageable else ""
    if error.outside is not None:
        cure = _other_units(getattr(scenario, section), section, *error.outside) + cure
    return InputError([Problem(place, f"{section}.file", f"{error.message} (named at {where}){cure}")])


def _other_units(written: Any, section: str, column: str, value: float, limits: tuple[float, float]) -> str:
    """Units in which a value outside of physical limits would be within them, and the line to write."""
    known = [(key, units) for names, key, units in _UNITS if column in names]
    if not known:
        return ""
    ((key, units),) = known
    now = getattr(written, key) or getattr(written, "speed_unit", "")
    others = {unit: factor for unit, factor in relative_units(units, now).items() if factor < 1.0}
    fitting = [unit for unit, factor in others.items() if limits[0] <= factor * value <= limits[1]]
    if not fitting:
        return ""
    rest = f" (or {', '.join(fitting[1:])})" if len(fitting) > 1 else ""
    return f"; if the column is not in {now}, write `{section}: {{{key}: {fitting[0]}}}`{rest}"


_UNITS: tuple[tuple[tuple[str, ...], str, dict[str, float]], ...] = (
    (conventions.IMU_COLUMNS[1:4], "gyro_unit", conventions.GYRO_UNITS),
    (conventions.IMU_COLUMNS[4:], "accelerometer_unit", conventions.ACCELEROMETER_UNITS),
    (conventions.GNSS_COLUMNS[1:3], "angle_unit", conventions.ANGLE_UNITS),
    (conventions.GNSS_COLUMNS[3:4], "height_unit", conventions.HEIGHT_UNITS),
    (conventions.GNSS_COLUMNS[4:6], "speed_unit", conventions.SPEED_UNITS),
    (conventions.GNSS_COLUMNS[6:7], "vertical_speed_unit", conventions.VERTICAL_SPEED_UNITS),
)
"""Columns, the key of their unit, and its units."""


def _pinned(scenario: Replay, document: Document) -> Replay:
    """The log with its files' checksums, which must be those given. Raises InputError."""
    update = {}
    for name in ("imu", "gnss", "reference", "heading"):
        section = getattr(scenario, name)
        if section is None:
            continue
        checksum = files.checksum(document.resolve((name, "file"), section.file))
        if section.file_sha256 not in (None, checksum):
            place = document.place((name, "file_sha256"))
            message = f"{section.file} has the checksum {checksum}, not this one"
            raise InputError([Problem(place, f"{name}.file_sha256", message)])
        update[name] = section.model_copy(update={"file_sha256": checksum})
    if scenario.gnss.navigation is not None:
        key = ("gnss", "navigation")
        sums = tuple(files.checksum(document.resolve(key, name)) for name in scenario.gnss.navigation)
        if scenario.gnss.navigation_sha256 not in (None, sums):
            place = document.place(("gnss", "navigation_sha256"))
            message = f"the files have the checksums {', '.join(sums)}, not these"
            raise InputError([Problem(place, "gnss.navigation_sha256", message)])
        update["gnss"] = update["gnss"].model_copy(update={"navigation_sha256": sums})
    return scenario.model_copy(update=update)
