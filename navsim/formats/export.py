"""Export of results to other formats: RINEX, NMEA, CSV, KML, GeoJSON, motion files of signal simulators.

Everything comes from the result file, without a new simulation. Pseudolites, for which RINEX has no letter, go to a CSV
beside the observation file.

Sources: [1] RINEX 3.04. [2] NMEA 0183 version 4.11. [3] OGC KML 2.3. [4] RFC 7946 (GeoJSON). [5] gpssim.c of
gps-sdr-sim (osqzss), `readUserMotion` and `readUserMotionLLH`. [6] Safran's remote API of
Skydel, `example_create_track_aircraft.py`.
"""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats import rinex_write, simulated_log
from navsim.formats.conventions import KNOT
from navsim.formats.export_maps import (
    origin_text,
    ranges_llh,
    ranges_output,
    route_at,
    true_antenna,
    undulation_of,
    write_geojson,
    write_kml,
)  # fmt: skip
from navsim.formats.fas import write_fas
from navsim.formats.simulated_log import FIX_ERROR, RANGE_ERROR
from navsim.geodesy import earth
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass_broadcast, gps
from navsim.gnss.constellations.constellation import Constellation, carriers
from navsim.gnss.constellations.systems import BY_LETTER, GLONASS, System
from navsim.results.heights import height_names
from navsim.results.result import Result, ResultError, part, scenario_of, write_text

LONGEST = 30 * 86400.0
"""Longest flight, s."""
TOE_SPACING = 7200.0
"""Messages of simulated satellites are given reference times at multiples of this, s."""


def export(result: Result, target: Path, formats: list[str], ensemble: Result | None = None) -> list[Path]:
    """Write a result as `target` with the endings of the formats; returns the files.

    - Of a landing: "rinex", "nmea", "csv", "imu", "motion", "fas", "kml", "geojson". Of an ensemble, it writes the run
      of `choose_run`.
    - Of a replay: "csv", "kml", "geojson". Of a sweep or an optimisation: "kml", "geojson".
    - Of recorded ranges: "csv"; if the sources have geodetic positions, also "kml", "geojson".

    ensemble: the whole ensemble, whose errors at heights go into the tables.

    Raises ResultError, and writes nothing, if the result lacks data for one of the formats, or a file cannot be
    written.
    """
    kind = str(result.attributes["kind"])
    if result.attributes.get("method") == "rare":
        raise ResultError("method rare keeps errors at the box, but no flight; export a result of method monte-carlo")
    if kind == "landing":
        writers = {"rinex": _rinex, "nmea": _nmea, "csv": _csv, "imu": _imu, "kml": write_kml, "geojson": write_geojson,
                   "motion": _motion, "fas": write_fas}  # fmt: skip
    elif kind == "replay":
        writers = {"csv": _replay_csv, "kml": write_kml, "geojson": write_geojson}
    elif kind == "ranges":
        writers = {"csv": _ranges_csv, "kml": write_kml, "geojson": write_geojson}
    elif kind in ("optimize", "sweep"):
        writers = {"kml": write_kml, "geojson": write_geojson}
    else:
        raise ResultError(
            "only landings, replays, recorded ranges, sweeps and searches for placements are exported, this is a "
            f"result of kind {kind}"
        )
    for name in formats:
        if name not in writers:
            raise ResultError(f"a result of kind {kind} has nothing for --{name}; there are --{', --'.join(writers)}")
    texts: dict[Path, str] = {}
    refused = {}
    for name in formats:
        try:
            texts |= writers[name](result, target)
        except ResultError as error:
            refused[name] = str(error)
    if refused:
        said = "; ".join(f"--{name}: {message}" for name, message in refused.items())
        others = " and ".join(f"--{name}" for name in formats if name not in refused)
        raise ResultError(f"{said}; nothing is written, but {others} can be, without" if others else said)
    if "csv" in formats and kind == "landing":
        texts |= _gates(ensemble or result, target)
    for path, text in texts.items():
        write_text(path, text)
    return list(texts)


def choose_run(result: Result, number: int | None) -> tuple[Result, str | None]:
    """Result of one run of an ensemble, by default the first, and its description; None if there is no choice.

    Raises ResultError for a run that the result does not contain.
    """
    runs = result["/run"] if "/run" in result else np.zeros(0, dtype=int)
    if number is not None and number not in runs:
        held = "no runs" if not runs.size else f"run {runs[0]}" if runs.size == 1 else f"runs {runs[0]} to {runs[-1]}"
        raise ResultError(f"--run {number}: the result holds {held}")
    if runs.size < 2:
        return result, None
    i = 0 if number is None else int(np.flatnonzero(runs == number)[0])
    of_one = {
        path: replace(v, data=part(v.data, i, i + 1)) if v.dims[:1] == ("run",) else v
        for path, v in result.variables.items()
    }
    return Result(result.attributes, of_one), f"run {runs[i]} of {runs.size} is written"


def _run_of_ensemble(result: Result) -> int | None:
    """Number of the run that represents an ensemble, None for a single run."""
    return int(result["/run"][0]) if int(result["/summary/count/runs"]) > 1 else None


def start_of(result: Result) -> float:
    """GPS time of time 0, s; the scenario's text has the fractions that older files' `epoch` lacks."""
    utc = datetime.datetime.fromisoformat(scenario_of(result)["epoch"]).timestamp()
    return float(timescales.gps_from_utc(utc))


# --- RINEX


def lacking(result: Result, what: str) -> ResultError:
    """Error: the result contains no single runs."""
    if result.attributes.get("method") == "covariance":
        return ResultError(f"a covariance analysis flies no runs and has no {what}; fly some with --method monte-carlo")
    if (kind := result.attributes.get("kind")) != "landing":
        return ResultError(f"a result of kind {kind} has no {what} of runs to export: only landings have")
    if what == "fixes" and "/summary/count/fixes" in result and not result["/summary/count/fixes"]:
        return ResultError("the result has no fixes of runs: no run has any")
    return ResultError(f"the result has no {what} of runs; run it with --keep all (a single run keeps them anyway)")


def _rinex(result: Result, target: Path) -> dict[Path, str]:
    """Observations, messages, and the pseudolites' own table."""
    if "/measurements/pseudorange" not in result:
        raise lacking(result, "measurements")
    time = result["/geometry/time"]
    if not time.size:
        text = "the result has no fixes: its flight is shorter than one fix interval, or than receiver.latency_s"
        raise ResultError(text)
    elements, vectors = _elements(result), _vectors(result)
    constellations: list[Constellation] = [*elements.values(), *([] if vectors is None else [vectors])]
    if not constellations:
        raise ResultError(
            "the result has no navigation messages; RINEX needs a sky of nominal, almanac or navigation satellites"
        )
    approximate = approximate_systems(result)
    scenario = scenario_of(result)
    receiver = scenario["receiver"]
    clock = 1e-6 * receiver["clock_offset_us"] + 1e-9 * receiver["clock_drift_ppb"] * time
    gpst = start_of(result) + time
    # a receiver marks epochs by its own clock
    start, part = divmod(start_of(result), 1.0)
    tag = part + time + clock
    names = [str(name) for name in result["/geometry/source"]]
    ranges, rates = result["/measurements/pseudorange"][0], result["/measurements/range_rate"][0]
    cn0 = result["/measurements/cn0"][0]
    columns, values = [], []
    channels: dict[str, int] = {}
    for constellation in constellations:
        sent = gpst[:, None] - (ranges[:, _places(names, constellation.names)] / earth.SPEED_OF_LIGHT - clock[:, None])
        sent = np.where(np.isfinite(sent), sent, gpst[:, None] - 0.075)
        offset, drift = constellation.clock(sent)
        frequency, told = carriers(constellation), constellation.channels
        for k, name in enumerate(constellation.names):
            if name not in names:
                continue
            i = names.index(name)
            # a receiver with the message removes the effect of the satellite clock
            raw = ranges[:, i] - earth.SPEED_OF_LIGHT * offset[:, k]
            rate = rates[:, i] - earth.SPEED_OF_LIGHT * drift[:, k]
            values.append(np.stack([raw, -rate * frequency[k] / earth.SPEED_OF_LIGHT, cn0[:, i]]))
            columns.append(name)
            if name in told:
                channels[name] = told[name]
    if not columns:
        raise ResultError("no satellite of the result can be written as RINEX")
    order = np.argsort(columns)
    table = np.stack(values, axis=-1)[:, :, order]
    table[:, ~np.isfinite(table[0])] = np.nan
    truth = earth.ecef_from_llh(result["/truth/position_llh"][0])
    epochs = rinex_write.Epochs(
        start=start,
        tag=tag,
        satellites=tuple(columns[i] for i in order),
        values=table,
        position=truth,
        channels=channels,
        interval=float(np.median(np.diff(time))) if time.size > 1 else 1.0,
    )
    stamp = str(result.attributes["created"]).replace("-", "").replace("T", " ").replace(":", "")[:15]
    made = f"{'navsim ' + str(result.attributes['navsim_version']):20s}{'':20s}{stamp} UTC "
    comments = [origin_text(result), "simulated: satellite clocks as in the messages", *_contents(scenario)]
    run = _run_of_ensemble(result)
    if run is not None:
        comments.append(f"run {run} of an ensemble of {int(result['/summary/count/runs'])}")
    if approximate:
        comments.append(f"NOT EXACT: {', '.join(approximate)} flew by an almanac")
    pseudolites = [str(name) for name in result["/pseudolites/name"]]
    heard = np.isfinite(ranges).any(axis=0)
    missing = [
        name for name, h in zip(names, heard, strict=True) if h and name not in columns and name not in pseudolites
    ]
    if missing:
        comments.append(f"received, but not in here for want of messages to write: {', '.join(missing)}")
    title = str(result.attributes.get("title") or target.stem)
    messages = rinex_write.navigation_lines(
        {system: one.records for system, one in elements.items()}, None if vectors is None else vectors.records,
        comments, made, at=start, klobuchar=_klobuchar(scenario),
        gps_offset=1e-9 * scenario["signals"]["gps_offset_ns"],
    )  # fmt: skip
    return {
        target.with_suffix(".obs"): "\n".join(rinex_write.observation_lines(epochs, title, comments, made)) + "\n",
        target.with_suffix(".nav"): "\n".join(messages) + "\n",
        **_pseudolites(result, target, start, tag, names),
    }


def _klobuchar(scenario: Any) -> tuple[list[float], list[float]] | None:
    """Alpha and beta of the ionosphere, if the pseudoranges contain all of it.

    A residual after a correction must not be corrected again by readers of the file.
    """
    ionosphere = scenario["signals"].get("ionosphere")
    if ionosphere is None or ionosphere["corrected"] or "differential" in scenario["pseudolites"]:
        return None
    return ionosphere["alpha"], ionosphere["beta"]


_TAKEN_OFF = {"saastamoinen": "Saastamoinen's model", "mops": "that climatology"}


def _contents(scenario: Any) -> list[str]:
    """Errors in the pseudoranges besides geometry, clocks and noise."""
    signals, station = scenario["signals"], scenario["pseudolites"].get("differential")
    ionosphere, troposphere, space = (signals.get(name) for name in ("ionosphere", "troposphere", "ephemeris"))
    lines = []
    if ionosphere is None:
        lines.append("no ionosphere")
    else:
        times = f"ionosphere: {ionosphere['truth_scale']:g} times Klobuchar's delay"
        coefficients = (f"{name} {' '.join(f'{x:g}' for x in ionosphere[name])}" for name in ("alpha", "beta"))
        if ionosphere["corrected"]:
            lines += [f"{times} less the model: only a residual is in, correct no more", *coefficients]
        else:
            lines += [times, *coefficients]
    if troposphere is None:
        lines.append("no troposphere")
    else:
        times = f"troposphere: {troposphere['truth_scale']:g} times the climatology of DO-229 with Niell's mapping"
        off = troposphere["correction"]
        less = f" less {_TAKEN_OFF[off]}: only a residual is in, correct no more" if off != "none" else ""
        lines.append(times + less)
    if space is not None:
        orbit = ", ".join(f"{x:g}" for x in space["orbit_sigma_m"])
        lines.append(
            f"errors of the messages: orbits {orbit} m (radial, along, across), clocks {space['clock_sigma_m']:g} m, "
            "1 sigma"
        )
    if station is not None:
        where = " where the link brings them (/corrections/age)" if station.get("link") else ""
        lines.append(
            f"differential corrections, {station['latency_s']:g} s old, are applied{where}: of all these only a "
            "residual is in, correct no more"
        )
    if signals["gps_offset_ns"]:
        lines.append(f"GPS time less GLONASS time: {signals['gps_offset_ns']:g} ns")
    for name, offset in signals.get("system_offsets_ns", {}).items():
        lines.append(f"{name} time less GLONASS time: {offset:g} ns")
    if signals.get("system_offset_sigma_ns"):
        lines.append(f"offsets between systems as drawn, 1 sigma {signals['system_offset_sigma_ns']:g} ns")
    if scenario["receiver"]["smoothing_s"]:
        lines.append(f"code smoothed by the carrier, memory {scenario['receiver']['smoothing_s']:g} s")
    return lines


def approximate_systems(result: Result) -> list[str]:
    """Systems whose satellites did not fly by the messages that are exported."""
    out = []
    for system in BY_LETTER.values():
        path = f"/navigation/{system.name}/message"
        if path in result and not int(result.variables[path].attributes["exact"]):
            out.append(system.name)
    return out


def _elements(result: Result) -> dict[System, gps.KeplerianEphemerides]:
    """The satellites behind the result's messages of elements, with reference times near the flight, by system."""
    out = {}
    for system in BY_LETTER.values():
        if f"/navigation/{system.name}/prn" in result:
            stored = gps.Elements(**{f.name: _stored(result, system, f.name) for f in fields(gps.Elements)})
            out[system] = gps.KeplerianEphemerides(_near(stored, system, result), reach=np.inf, system=system)
    return out


def _vectors(result: Result) -> glonass_broadcast.StateVectorEphemerides | None:
    """The GLONASS satellites behind the result's messages."""
    if f"/navigation/{GLONASS.name}/slot" not in result:
        return None
    names = [f.name for f in fields(glonass_broadcast.StateVectors)]
    stored = glonass_broadcast.StateVectors(**{n: _stored(result, GLONASS, n) for n in names})
    return glonass_broadcast.StateVectorEphemerides(stored, use_unhealthy=True)


def _stored(result: Result, system: System, name: str) -> np.ndarray:
    data = result[f"/navigation/{system.name}/{name}"]
    return data.astype(bool) if name == "healthy" else data


def _near(elements: gps.Elements, system: System, result: Result) -> gps.Elements:
    """Simulated messages during the flight; those of a real navigation file stay unchanged."""
    time = start_of(result) + result["/geometry/time"][[0, -1]]
    if np.all(np.abs(elements.toe[:, None] - time) < max(gps.WINDOWS[system])):
        return elements
    if not time[0] <= time[1] <= time[0] + LONGEST:
        raise ResultError(f"damaged: measurements from {time[0]:g} to {time[1]:g} s")
    toes = np.arange(np.round(time[0] / TOE_SPACING), np.round(time[1] / TOE_SPACING) + 1) * TOE_SPACING
    if np.isin(elements.prn, system.tilted).any():
        raise ResultError("messages of geostationary satellites cannot be referred to the time of the flight")
    parts = [elements.referred_to(np.full(elements.prn.size, toe), system) for toe in toes]
    whole = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(gps.Elements)}
    issue = np.repeat(np.arange(1, toes.size + 1), elements.prn.size).astype(float)
    return gps.Elements(**(whole | {"iode": issue, "iodc": issue, "healthy": np.ones(issue.size, dtype=bool)}))


def _places(names: list[str], wanted: tuple[str, ...]) -> list[int]:
    """Columns of the wanted sources; any column for missing ones, which are skipped later."""
    return [names.index(name) if name in names else 0 for name in wanted]


def _pseudolites(result: Result, target: Path, start: float, tag: np.ndarray, names: list[str]) -> dict[Path, str]:
    """Write pseudolites, for which RINEX has no place: one row an epoch and pseudolite."""
    pseudolites = [str(name) for name in result["/pseudolites/name"]]
    if not pseudolites:
        return {}
    llh = result["/pseudolites/position_llh"]
    ecef = earth.ecef_from_llh(llh)
    rows: list[list[str]] = []
    for e, when in enumerate(tag):
        for g, name in enumerate(pseudolites):
            i = names.index(name)
            values = (result[f"/measurements/{n}"][0, e, i] for n in ("pseudorange", "range_rate", "cn0"))
            rows.append(
                [_exact(start, when), name, *(_cell(x, 4) for x in values), *(f"{x:.4f}" for x in ecef[g]),
                 f"{np.degrees(llh[g, 0]):.9f}", f"{np.degrees(llh[g, 1]):.9f}", f"{llh[g, 2]:.4f}"]
            )  # fmt: skip
    head = ["tag_gps_s", "name", "pseudorange_m", "range_rate_m_s", "cn0_dbhz", "x_m", "y_m", "z_m", "lat_deg",
            "lon_deg", "h_m"]  # fmt: skip
    return {target.with_name(f"{target.stem}_pseudolites.csv"): _table(head, rows)}


def _exact(start: float, since: float) -> str:
    """The sum with seven decimals, more than one double holds."""
    whole, part = divmod(round(float(since), 7), 1.0)
    return f"{start + whole:.0f}" + f"{part:.7f}"[1:]


# --- tables


def _cell(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def _table(head: list[str], rows: list[list[str]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    if head:
        writer.writerow(head)
    writer.writerows(rows)
    return out.getvalue()


def _csv(result: Result, target: Path) -> dict[Path, str]:
    """Write three tables: the true motion, the fixes, the filter's errors with their sigmas.

    The last two have a column with the run if the result has others. For runs that deviate from the route, the true
    motion is the route, and the fixes have the true position of the antenna beside them.
    """
    run = _run_of_ensemble(result)
    run_head, run_cell = ([], []) if run is None else (["run"], [str(run)])
    truth = [
        [f"{t:.4f}", f"{np.degrees(p[0]):.10f}", f"{np.degrees(p[1]):.10f}", f"{p[2]:.4f}", *(f"{x:.5f}" for x in v),
         *(f"{x:.6f}" for x in np.degrees(a))]
        for t, p, v, a in zip(result["/truth/time"], result["/truth/position_llh"], result["/truth/velocity_ned"],
                              result["/truth/attitude_rpy"], strict=True)
    ]  # fmt: skip
    files = {
        target.with_name(f"{target.stem}_truth.csv"): _table(
            ["t_s", "lat_deg", "lon_deg", "h_m", "vn_m_s", "ve_m_s", "vd_m_s", "roll_deg", "pitch_deg", "yaw_deg"],
            truth,
        )
    }
    if "/receiver/position_llh" in result:
        rows = []
        dops = np.stack([result[f"/geometry/{n}"] for n in ("pdop", "hdop", "vdop")], axis=1)
        own = "/receiver/true_position_llh"
        places = result[own][0] if own in result else np.empty((dops.shape[0], 0))
        own_head = ["true_lat_deg", "true_lon_deg", "true_h_m"] if own in result else []
        for t, p, v, d, place in zip(result["/geometry/time"], result["/receiver/position_llh"][0],
                                     result["/receiver/velocity_ned"][0], dops, places, strict=True):  # fmt: skip
            where = [_cell(np.degrees(x), 10) for x in place[:2]] + [_cell(x, 4) for x in place[2:]]
            rows.append(
                [f"{t:.4f}", _cell(np.degrees(p[0]), 10), _cell(np.degrees(p[1]), 10), _cell(p[2], 4),
                 *(_cell(x, 4) for x in v), *(_cell(x, 4) for x in d), *where, *run_cell]
            )  # fmt: skip
        files[target.with_name(f"{target.stem}_gnss.csv")] = _table(
            [
                "t_s",
                "lat_deg",
                "lon_deg",
                "h_m",
                "vn_m_s",
                "ve_m_s",
                "vd_m_s",
                "pdop",
                "hdop",
                "vdop",
                *own_head,
                *run_head,
            ],
            rows,
        )
    if "/filter/error" in result:
        states = [str(name) for name in result["/filter/state"]]
        error, sigma = result["/filter/error"][0], result["/filter/sigma"][0]
        rows = [
            [f"{t:.4f}", *(f"{x:.9g}" for x in e), *(f"{x:.9g}" for x in s), *run_cell]
            for t, e, s in zip(result["/filter/time"], error, sigma, strict=True)
        ]
        units = state_units(result)
        named = [_with_unit(name, unit) for name, unit in zip(states, units, strict=True)]
        head = ["t_s", *(f"error_{n}" for n in named), *(f"sigma_{n}" for n in named), *run_head]
        files[target.with_name(f"{target.stem}_filter.csv")] = _table(head, rows)
    return files


def _imu(result: Result, target: Path) -> dict[Path, str]:
    """The run as a recorded flight, for `navsim replay`."""
    if any(path not in result for path in simulated_log.NEEDED):
        raise lacking(result, "inertial samples and start of the filter")
    imu, fixes, log = (target.with_name(f"{target.stem}_{part}") for part in ("imu.csv", "fixes.csv", "replay.yaml"))
    title = f"{result.attributes.get('title') or target.stem}, as recorded"
    *parts, text = simulated_log.files(result, imu, fixes, title)
    return {path: _table(head, rows) for path, (head, *rows) in zip((imu, fixes), parts, strict=True)} | {log: text}


MOTION_RATE = 10.0
"""Rows of a motion file per second, as gps-sdr-sim takes them [5]."""
_MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]


def _motion(result: Result, target: Path) -> dict[Path, str]:
    """Write the antenna's motion along the route for signal simulators, ten rows a second.

    `_ecef.csv` and `_llh.csv`: time, s, and ECEF coordinates, m, or latitude and longitude, deg, and height, m [5].
    `_skydel.csv`: UTC, ECEF coordinates, km, and yaw, pitch, roll, deg [6].
    """
    truth = result["/truth/time"]
    time = np.arange(int(np.floor(truth[-1] * MOTION_RATE + 1e-9)) + 1) / MOTION_RATE
    ecef, (_, attitude) = true_antenna(result, time), route_at(result, time)
    llh = earth.llh_from_ecef(ecef)
    start = datetime.datetime.fromisoformat(scenario_of(result)["epoch"]).astimezone(datetime.UTC)
    rows: tuple[list[list[str]], ...] = ([], [], [])
    for t, place, (lat, lon, height), (roll, pitch, yaw) in zip(time, ecef, llh, np.degrees(attitude), strict=True):
        rows[0].append([f"{t:.1f}", *(f"{x:.4f}" for x in place)])
        rows[1].append([f"{t:.1f}", f"{np.degrees(lat):.10f}", f"{np.degrees(lon):.10f}", f"{height:.4f}"])
        now = start + datetime.timedelta(milliseconds=round(1e3 * t))
        day = f"{now.day:02d} {_MONTHS[now.month - 1]} {now.year} {now:%H:%M:%S}.{now.microsecond // 1000:03d}"
        angles = (f"{x:.4f}" for x in (yaw % 360.0, pitch, roll))
        rows[2].append([day, *(f"{1e-3 * x:.7f}" for x in place), *angles])
    head = ["Time (UTCG)", *(f"{axis} (km)" for axis in "xyz"), *(f"{name} (deg)" for name in ("Yaw", "Pitch", "Roll"))]
    heads: tuple[list[str], ...] = ([], [], head)
    files = zip(("ecef", "llh", "skydel"), heads, rows, strict=True)
    return {target.with_name(f"{target.stem}_{name}.csv"): _table(one, table) for name, one, table in files}


def _gates(result: Result, target: Path) -> dict[Path, str]:
    """Write the position error of every run at the evaluated heights: a row a run and height."""
    if "/summary/at/lateral_run" not in result:
        return {}
    kinds = ("", "_fte", "_tse") if "/summary/at/lateral_fte_run" in result else ("",)
    named = [(axis, kind) for kind in kinds for axis in ("lateral", "along", "vertical")]
    axes = np.stack([result[f"/summary/at/{axis}{kind}_run"] for axis, kind in named], axis=-1)
    heights = result["/summary/at/height"]
    rows = [
        [str(run), gate, _cell(height, 4), *(f"{x:.9g}" if np.isfinite(x) else "" for x in axes[r, h])]
        for r, run in enumerate(result["/run"])
        for h, (gate, height) in enumerate(zip(height_names(heights), heights, strict=True))
    ]
    head = ["run", "gate", "height_m", *(f"{kind[1:] or 'error'}_{axis}_m" for axis, kind in named)]
    return {target.with_name(f"{target.stem}_gates.csv"): _table(head, rows)}


def _with_unit(name: str, unit: str) -> str:
    """The name of a column of a state with its unit, as keys of scenarios have them."""
    if name.startswith((FIX_ERROR, RANGE_ERROR)):
        return f"{name}_prior_sigma"
    return name if unit in ("", "1") else f"{name}_{unit.replace('/', '_')}"


def state_units(result: Result) -> list[str]:
    """Units of the filter's states from the file."""
    return [unit.strip() for unit in str(result.variables["/filter/state"].attributes["state_units"]).split(",")]


def _replay_csv(result: Result, target: Path) -> dict[Path, str]:
    """Two tables: the estimated motion with its sigmas, and the innovations."""
    columns = (("position_llh", "lat_rad lon_rad h_m"), ("velocity_ned", "vn_m_s ve_m_s vd_m_s"),
               ("attitude_rpy", "roll_rad pitch_rad yaw_rad"), ("sigma", ""))  # fmt: skip
    names = zip(result["/filter/state"], state_units(result), strict=True)
    states = " ".join(f"sigma_{_with_unit(str(name), unit)}" for name, unit in names)
    head = ["t_s", *(name for _, names in columns for name in (names or states).split())]
    table = np.column_stack([result["/filter/time"], *(result[f"/filter/{name}"] for name, _ in columns)])
    flight = _table(head, [[f"{row[0]:.4f}", *(f"{x:.12g}" for x in row[1:])] for row in table])
    seen = np.column_stack(
        [result[f"/innovations/{name}"] for name in ("time", "position_ned", "velocity_ned", "normalized_squared")]
    )
    rows = [[f"{row[0]:.4f}", *(_cell(x, 5) for x in row[1:])] for row in seen]
    heads = ["t_s", "pn_m", "pe_m", "pd_m", "vn_m_s", "ve_m_s", "vd_m_s", "normalized_squared"]
    return {
        target.with_name(f"{target.stem}_flight.csv"): flight,
        target.with_name(f"{target.stem}_innovations.csv"): _table(heads, rows),
    }


def _ranges_csv(result: Result, target: Path) -> dict[Path, str]:
    """The trajectory from recorded ranges with its sigmas: that of the smoother if the result has one."""
    group = ranges_output(result)
    columns = [result[f"/{group}/{name}"] for name in ("position", "position_sigma", "velocity", "velocity_sigma")]
    forms = ("{}_m", "sigma_{}_m", "v{}_m_s", "sigma_v{}_m_s")
    head = ["t_s", *(form.format(axis) for form in forms for axis in "xyz")]
    table = np.column_stack([result["/time"], *columns])
    rows = [[f"{row[0]:.4f}", *(_cell(x, 9) for x in row[1:])] for row in table]
    if "/sources/origin_llh" not in result:
        return {target.with_name(f"{target.stem}_flight.csv"): _table(head, rows)}
    llh = ranges_llh(result, columns[0])
    llh[:, :2] = np.degrees(llh[:, :2])
    rows = [[*row, *(f"{x:.12g}" for x in place)] for row, place in zip(rows, llh, strict=True)]
    return {target.with_name(f"{target.stem}_flight.csv"): _table([*head, "lat_deg", "lon_deg", "h_m"], rows)}


# --- NMEA


def _nmea(result: Result, target: Path) -> dict[Path, str]:
    """GGA, RMC and VTG of each fix, with as many digits as the format lets [2]. Heights are given over
    the geoid with its separation where the scenario has it, else over the ellipsoid with a separation of zero. A leap
    second is 23:59:60. The talker is that of the satellite system in use, GN if there are several."""
    if "/receiver/position_llh" not in result:
        raise lacking(result, "fixes")
    start, separation = start_of(result), undulation_of(result) or 0.0
    in_use = np.isfinite(result["/geometry/line_of_sight"][:, :, 0])
    used, talker = in_use.sum(axis=1), _talker(result["/geometry/source"][in_use.any(axis=0)])
    lines = []
    for t, p, v, n, hdop in zip(result["/geometry/time"], result["/receiver/position_llh"][0],
                                result["/receiver/velocity_ned"][0], used, result["/geometry/hdop"],
                                strict=True):  # fmt: skip
        date, hour, minute, second = timescales.utc_calendar(start + float(t))
        hundredths = round(1e6 * second) // 10_000
        clock = f"{hour:02d}{minute:02d}{hundredths // 100:02d}.{hundredths % 100:02d}"
        if not np.isfinite(p[0]):
            lines += [
                _sentence(f"{talker}GGA,{clock},,,,,0,00,,,M,,M,,"),
                _sentence(f"{talker}RMC,{clock},V,,,,,,,{date:%d%m%y},,,N"),
            ]
            continue
        where = _angle(np.degrees(p[0]), 2, "NS") + "," + _angle(np.degrees(p[1]), 3, "EW")
        speed, course = float(np.hypot(v[0], v[1])), float(np.degrees(np.arctan2(v[1], v[0])) % 360.0)
        knots = speed / KNOT
        lines += [
            _sentence(
                f"{talker}GGA,{clock},{where},1,{min(int(n), 99):02d},{hdop:.2f},{p[2] - separation:.3f},M,"
                f"{separation:.3f},M,,"
            ),
            _sentence(f"{talker}RMC,{clock},A,{where},{knots:.3f},{course:.2f},{date:%d%m%y},,,A"),
            _sentence(f"{talker}VTG,{course:.2f},T,,M,{knots:.3f},N,{3.6 * speed:.3f},K,A"),
        ]
    return {target.with_suffix(".nmea"): "".join(f"{line}\r\n" for line in lines)}


def _talker(sources: Iterable[object]) -> str:
    """The talker of a receiver that uses these sources [2]."""
    talkers = {system.talker for name in sources for system in BY_LETTER.values() if system.has(str(name))}
    return talkers.pop() if len(talkers) == 1 else "GN"


def _angle(degrees: float, width: int, signs: str) -> str:
    """ddmm.mmmmmmm,N"""
    units = round(abs(degrees) * 60e7)  # of 1e-7 minutes, so that 60 minutes cannot appear
    whole, minutes = divmod(units, 60 * 10**7)
    return f"{whole:0{width}d}{minutes // 10**7:02d}.{minutes % 10**7:07d},{signs[0] if degrees >= 0.0 else signs[1]}"


def _sentence(body: str) -> str:
    check = 0
    for character in body:
        check ^= ord(character)
    return f"${body}*{check:02X}"
