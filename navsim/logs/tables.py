"""Tables of a log's contents, and the commented files with which `navsim replay` flies them."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.formats.conventions import GNSS_COLUMNS, IMU_COLUMNS
from navsim.gnss.timescales import utc_text
from navsim.logs.contents import (
    ANTENNA_HEADING,
    MAGNETIC_HEADING,
    MEANINGS,
    FixRecord,
    ImuRecord,
    LogContents,
    RangeRecord,
)
from navsim.results.atomic_write import replacing
from navsim.results.findings import several
from navsim.statistics.rounding import digits

LOG, RANGES = "log.yaml", "ranges.yaml"
_WIDTH = 110
_CLOCKS = {
    "own": "times are seconds of the recording device's clock",
    "week": "times are GPS seconds since the beginning of a week",
}
_ABSENT = (
    "no {}, so there is no log.yaml: a replay needs samples and fixes. {} a log.yaml that names a table of them beside "
    "{}"
)
_NOTHING = "neither inertial samples nor fixes{}, so there is no log.yaml: log them, or choose another file"
_AS_TRACK = "; without samples, `approach: {{profile: track, file: {}}}` of a scenario flies the positions"


@dataclass(frozen=True)
class Account:
    """What was written and why: lines for the terminal, which the files repeat as comments."""

    taken: list[str]
    left_out: list[str]
    decided: list[str]
    missing: list[str]

    def lines(self) -> list[str]:
        """All lines under their headings."""
        out = []
        for heading, lines in (("taken", self.taken), ("left out", self.left_out), ("decided", self.decided)):
            out += [heading, *(f"  {line}" for line in lines or ["nothing"])]
        return out


@dataclass(frozen=True)
class LogFiles:
    """Files of a log by name, not yet written: tables (header, rows) and texts."""

    tables: dict[str, tuple[list[str], np.ndarray]]
    texts: dict[str, str]
    account: Account

    @property
    def names(self) -> list[str]:
        """Names of all files."""
        return [*self.tables, *self.texts]

    def write(self, folder: Path) -> None:
        """Write all files into a folder. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, (columns, rows) in self.tables.items():
            with replacing(folder / name, durable=False) as temporary:
                formats = ["%.9f", *(_digits(column) for column in rows.T[1:])]
                np.savetxt(temporary, rows, formats, ",", header=",".join(columns), comments="")
        for name, text in self.texts.items():
            with replacing(folder / name, durable=False) as temporary:
                temporary.write_text(text, encoding="utf-8")


def _digits(column: np.ndarray) -> str:
    """Format with all digits of single precision, where a column has no more, else 12."""
    with np.errstate(over="ignore"):
        is_single = np.array_equal(column, column.astype(np.float32).astype(float), equal_nan=True)
    return "%.9g" if is_single else "%.12g"


def log_files(contents: LogContents, source: str, imu: int = 0, receiver: int = 0) -> LogFiles:
    """Files of a log's contents. source: name of the log; imu, receiver: those that log.yaml names."""
    tables: dict[str, tuple[list[str], np.ndarray]] = {}
    taken = []
    imus = _file_names("imu", len(contents.imus))
    for name, sensor in zip(imus, contents.imus, strict=True):
        tables[name] = [*IMU_COLUMNS], np.column_stack([sensor.time, sensor.rate, sensor.force])
        taken.append(f"{name}: {sensor.name}, {several(sensor.time.size, 'sample')} of {_span(sensor.time)}, "
                     f"{digits(sensor.rate_hz, 4)} Hz")  # fmt: skip
    fixes = _file_names("gnss", len(contents.receivers))
    for name, one in zip(fixes, contents.receivers, strict=True):
        tables[name] = _fix_table(one)
        further = ", ".join(dict.fromkeys(MEANINGS.get(column, "correlations") for column in one.further))
        taken.append(f"{name}: {one.name}, {several(one.time.size, 'fix')} of {_span(one.time)}"
                     + (f", with {further}" if further else ""))  # fmt: skip
    for name, columns in contents.tables.items():
        tables[f"{name}.csv"] = [*columns], np.column_stack(list(columns.values()))
        taken.append(f"{name}.csv: {several(columns['t_s'].size, 'row')}, {', '.join(list(columns)[1:])}")
    texts = dict(contents.texts)
    taken += [f"{name}: observations for gnss.file with gnss.navigation, instead of the fixes" for name in texts]
    decided = [*dict.fromkeys(contents.decided)]
    if not any("times are" in line for line in decided):
        decided.append(_CLOCKS[contents.clock])
    if contents.start is not None and contents.epoch is None:
        decided.append("no epoch: the dates of the log are impossible")
    missing = []
    why = f" ({'; '.join(contents.left_out)})" if contents.left_out else ""
    joined = "Import the file that has them together with this one, or write" if contents.clock == "week" else "Write"
    if not imus:
        absent = _ABSENT.format(f"inertial samples{why}", joined, *fixes[:1]) if fixes else _NOTHING.format(why)
        missing.append(absent + (_AS_TRACK.format(fixes[0]) if fixes else ""))
    elif not fixes:
        missing.append(_ABSENT.format(f"fixes{why}", joined, imus[0]))
    if contents.ranges is not None:
        tables["ranges.csv"], rows = _range_table(contents.ranges)
        taken.append(f"ranges.csv: {several(rows, 'range')} to {several(len(contents.ranges.positions), 'beacon')}; "
                     f"navsim replay {RANGES}")  # fmt: skip
        missing = []
    account = Account(taken, contents.left_out, decided, missing)

    def head() -> list[str]:
        return [f"# From {source}, {contents.format}, by `navsim import`.", *_comments(account)]

    if imus and fixes:
        sensor, chosen = contents.imus[imu], contents.receivers[receiver]
        if len(imus) > 1:
            decided.append(f"log.yaml names {sensor.name}; --imu N chooses another of {len(imus)}")
        if len(fixes) > 1:
            decided.append(f"log.yaml names {chosen.name}; --receiver N chooses another of {len(fixes)}")
        decided.append("sensor class: consumer, since no log tells it; write imu.sensor_class if you know better")
        arm_line, latency_line = _lever_line(sensor, chosen), _latency_line(chosen)
        decided += [line.strip().removeprefix("# ") for line in (arm_line, latency_line)]
        epoch = [] if contents.epoch is None else [f"epoch: {utc_text(contents.epoch)}  # UTC of t_s = 0"]
        texts[LOG] = "\n".join([
            *head(), "kind: replay", "version: 1", f"title: {json.dumps(source, ensure_ascii=False)}", *epoch, "imu:",
            f"  file: {imus[imu]}", f"  samples: {sensor.samples}", *(f"  {line}" for line in contents.imu_keys),
            "gnss:", f"  file: {fixes[receiver]}", arm_line, latency_line,
            *_heading_lines(contents),
            *(["reference:  # the autopilot's attitude, for comparison", "  file: attitude.csv"]
              if "attitude" in contents.tables else []),
        ]) + "\n"  # fmt: skip
    if contents.ranges is not None:
        texts[RANGES] = _ranges_text(head(), source, contents.ranges)
    return LogFiles(tables, texts, account)


def _file_names(stem: str, count: int) -> list[str]:
    return [f"{stem}.csv"] if count == 1 else [f"{stem}{i}.csv" for i in range(count)]


def _span(time: np.ndarray) -> str:
    return f"{time[-1] - time[0]:.1f} s"


def _fix_table(fixes: FixRecord) -> tuple[list[str], np.ndarray]:
    columns = [*GNSS_COLUMNS, *fixes.further]
    return columns, np.column_stack([fixes.time, fixes.llh, fixes.velocity, *fixes.further.values()])


def _lever_line(imu: ImuRecord, fixes: FixRecord) -> str:
    """Line of the lever arm in log.yaml, a comment where the log does not tell it."""
    if fixes.position_m is None:
        return "  # lever_arm_m: not in the log; measure it from the IMU to the antenna: forward, right, down"
    antenna, origin = fixes.position_m, imu.position_m or (0.0, 0.0, 0.0)
    arm = [round(a - b, 4) + 0.0 for a, b in zip(antenna, origin, strict=True)]
    if not any(arm):
        return "  # lever_arm_m: the log's parameters are all 0, as if nobody had set them: forward, right, down"
    text = ", ".join(f"{x:g}" for x in arm)
    return f"  lever_arm_m: [{text}]  # from the IMU to the antenna, by the log's parameters"


def _latency_line(fixes: FixRecord) -> str:
    if fixes.latency_s is None:
        return f"  # latency_s: tuned{f'; {fixes.remark}' if fixes.remark else ''}"
    return f"  latency_s: {fixes.latency_s:g}  # by the log's parameters; leave it out and navsim tunes it"


def _heading_lines(contents: LogContents) -> list[str]:
    """Section of the headings; a comment where a magnetometer is all that has them."""
    if ANTENNA_HEADING in contents.tables:
        return ["heading:  # by two antennas", f"  file: {ANTENNA_HEADING}.csv", "  source: antennas"]
    if MAGNETIC_HEADING in contents.tables:
        return ["# heading:  # by the magnetometer: of use where the aircraft hovers; motors and steel disturb it",
                f"#   file: {MAGNETIC_HEADING}.csv", "#   source: magnetic"]  # fmt: skip
    return []


def _comments(account: Account) -> list[str]:
    out = []
    for line in account.lines():
        indent = "# " + " " * (len(line) - len(line.lstrip()))
        out += textwrap.wrap(line.strip(), _WIDTH, initial_indent=indent, subsequent_indent=f"{indent}  ",
                             break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return out


def _range_table(ranges: RangeRecord) -> tuple[tuple[list[str], np.ndarray], int]:
    """Table of ranges; beacons have the numbers of the log."""
    number = np.array([float(name) for name in ranges.beacon])
    columns: Mapping[str, np.ndarray] = {
        "t_s": ranges.time, "source": number, "range_m": ranges.range_m, "sigma_m": ranges.sigma_m,
        "signal_dbm": ranges.signal_dbm,
    }  # fmt: skip
    there = {name: column for name, column in columns.items() if not np.isnan(column).all()}
    return ([*there], np.column_stack(list(there.values()))), number.size


def _ranges_text(head: Sequence[str], source: str, ranges: RangeRecord) -> str:
    lines = [*head, "kind: ranges", "version: 1", f"title: {json.dumps(source, ensure_ascii=False)}", "ranges:",
             "  file: ranges.csv", "  measurement: two_way", "sources:", "  positions:"]  # fmt: skip
    for name, place in ranges.positions.items():
        if ranges.is_geodetic:
            text = f"lat_deg: {place[0]:.9f}, lon_deg: {place[1]:.9f}, height_m: {place[2]:.4f}"
        else:
            text = f"position_m: [{', '.join(f'{x:.4f}' for x in place)}]"
        lines.append(f'    - {{name: "{name}", {text}}}')
    return "\n".join(lines) + "\n"
