"""Azimuth of a recorded aircraft: simulated plots of a real approach, real Mode S reports with their gaps and outliers.

The truth is the aircraft's own positions and velocities, smoothed; plots are drawn about it. The filters use received
reports: roll and track rate of BDS 5,0 if they are recent and agree with each other, else the slope of the tracks of
velocity squitters. Source: `docs/theory/azimuth.md`, section 3.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.companions.atc.filter import singer_range
from navsim.companions.azimuth.filter import FIRST, SINGER, azimuth_filter, range_filter
from navsim.companions.circuit import CircuitFlight, G
from navsim.companions.kalman import singer
from navsim.formats.text import read_lines
from navsim.geodesy.earth import ecef_from_llh, ned_matrix
from navsim.statistics.random_streams import generator

KNOT, FOOT, DEG = 0.514444, 0.3048, np.pi / 180.0
POSITION_SIGMA, VELOCITY_SIGMA = 15.0, 0.7
"""1 sigma of recorded positions (m, mostly their time stamps) and velocities (m/s, steps of a knot)."""
FRESH = 5.0
"""Age up to which a BDS 5,0 report is used, s."""
LARGEST_ROLL = 45.0 * DEG
"""Rolls beyond are taken for wrongly decoded."""
AGREEMENT = 0.5 * DEG
"""Roll and reported track rate must give the same track rate to this, rad/s."""
SLOPE_SECONDS = 5.0
"""Interval of velocity squitters whose slope replaces a missing report, and gives the change of speed, s."""


@dataclass(frozen=True)
class ModeSRecording:
    """Received data, time from the first position, s; SI and rad, nan if missing.

    positions (p, 4): time, N, h, E from the radar, m. velocities (v, 3): time, speed, track. reports (r, 5): time,
    roll, track, track rate, speed.
    """

    positions: np.ndarray
    velocities: np.ndarray
    reports: np.ndarray


def _table(path: Path) -> np.ndarray:
    rows = list(csv.reader(line for line in read_lines(path) if line))
    return np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])


def read(folder: Path, stem: str, radar: np.ndarray) -> ModeSRecording:
    """A recording as `modes_afr34zg` has it, the aircraft airborne; radar (3,): rad, rad, m."""
    p, v, b = (_table(folder / f"{stem}_{name}.csv") for name in ("pos", "vel09", "bds50"))
    p = p[(p[:, 4] == 0.0) & np.isfinite(p[:, 3])]
    start = p[0, 0]
    llh = np.column_stack([p[:, 1] * DEG, p[:, 2] * DEG, p[:, 3] * FOOT])
    ned = (ecef_from_llh(llh) - ecef_from_llh(radar)) @ ned_matrix(radar).T
    positions = np.column_stack([p[:, 0] - start, ned[:, 0], -ned[:, 2], ned[:, 1]])
    velocities = np.column_stack([v[:, 0] - start, v[:, 1] * KNOT, v[:, 2] * DEG])
    reports = np.column_stack([b[:, 0] - start, b[:, 1] * DEG, b[:, 2] * DEG, b[:, 3] * DEG, b[:, 4] * KNOT])
    return ModeSRecording(positions, velocities[np.all(np.isfinite(velocities), axis=1)], reports)


def smoothed(recording: ModeSRecording, time: np.ndarray) -> CircuitFlight:
    """The flight at `time`, from positions and velocities by a Kalman smoother for each axis (Singer acceleration)."""
    p, v = recording.positions, recording.velocities
    ends = p[0, 0], p[-1, 0]
    v = v[(v[:, 0] >= ends[0]) & (v[:, 0] <= ends[1])]
    when = np.concatenate([p[:, 0], v[:, 0], time])
    what = np.repeat([0, 1, 2], [len(p), len(v), time.size])
    order = np.argsort(when, kind="stable")
    axes = []
    for position, velocity in ((p[:, 1], v[:, 1] * np.cos(v[:, 2])), (p[:, 3], v[:, 1] * np.sin(v[:, 2]))):
        value = np.concatenate([position, velocity, np.full(time.size, np.nan)])
        axes.append(_smooth(when[order], what[order], value[order]))
    picked = what[order] == 2
    (n, vn, an), (e, ve, ae) = (axis[picked].T for axis in axes)
    height = np.interp(time, p[:, 0], np.convolve(np.pad(p[:, 2], 10, mode="edge"), np.ones(21) / 21, "valid"))
    track = np.unwrap(np.arctan2(ve, vn))
    speed = np.hypot(vn, ve)
    ahead, right = an * np.cos(track) + ae * np.sin(track), ae * np.cos(track) - an * np.sin(track)
    none = np.zeros_like(speed)
    load = np.stack([ahead / G, none + 1.0, right / G], axis=1)
    return CircuitFlight(
        time,
        np.stack([n, height, e], axis=1),
        speed,
        none,
        track,
        np.arctan(right / G),
        ahead,
        none,
        right / speed,
        load,
    )


def _smooth(when: np.ndarray, what: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Position, velocity, acceleration (n, 3) at every event: Kalman filter, then Rauch-Tung-Striebel."""
    count = when.size
    x, p = np.array([value[np.flatnonzero(what == 0)[0]], 0.0, 0.0]), np.diag([1e6, 1e5, 4.0])
    filtered, covariances = np.empty((count, 3)), np.empty((count, 3, 3))
    predicted, spreads, ways = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, 3, 3))
    known: dict[float, tuple[np.ndarray, np.ndarray]] = {}
    before = when[0]
    for i in range(count):
        step = round(float(when[i] - before), 3)
        if step not in known:
            known[step] = singer(step, 0.1, 1.5) if step > 0.0 else (np.eye(3), np.zeros((3, 3)))
        phi, q = known[step]
        x, p = phi @ x, phi @ p @ phi.T + q
        predicted[i], spreads[i], ways[i] = x, p, phi
        if what[i] < 2:
            row = int(what[i])
            variance = (POSITION_SIGMA, VELOCITY_SIGMA)[row] ** 2
            gain = p[:, row] / (p[row, row] + variance)
            x = x + gain * (value[i] - x[row])
            p = p - np.outer(gain, p[row])
        filtered[i], covariances[i] = x, p
        before = when[i]
    out = filtered.copy()
    for i in range(count - 2, -1, -1):
        gain_ = np.linalg.solve(spreads[i + 1] + 1e-12 * np.eye(3), ways[i + 1] @ covariances[i]).T
        out[i] = filtered[i] + gain_ @ (out[i + 1] - predicted[i + 1])
    return out


def received_nodes(recording: ModeSRecording, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion known on the ground at each scan, and its source.

    Motion (n, 4): acceleration along and right, speed, track. Source (n,): 0 track rate, 1 roll, 2 slope of velocity
    squitters, 3 none.
    """
    out, source = np.zeros((time.size, 4)), np.full(time.size, 3)
    v, b = recording.velocities, recording.reports
    tracks = np.unwrap(v[:, 2])
    for i, now in enumerate(time):
        last = int(np.searchsorted(v[:, 0], now, side="right"))
        if last < 3:
            continue
        part = slice(int(np.searchsorted(v[:, 0], now - SLOPE_SECONDS)), last)
        speed = v[last - 1, 1]
        turn, ahead = 0.0, 0.0
        if last - part.start >= 4:
            t = v[part, 0] - v[part, 0].mean()
            turn, ahead = float(t @ tracks[part] / (t @ t)), float(t @ v[part, 1] / (t @ t))
            source[i] = 2
        report = int(np.searchsorted(b[:, 0], now, side="right")) - 1
        if report >= 0 and now - b[report, 0] <= FRESH:
            roll, rate = b[report, 1], b[report, 3]
            by_roll = G * np.tan(roll) / speed if abs(roll) <= LARGEST_ROLL else np.nan
            if np.isfinite(rate) and np.isfinite(by_roll) and abs(rate - by_roll) <= AGREEMENT:
                turn, source[i] = rate, 0
            elif np.isnan(rate) and np.isfinite(by_roll) and abs(by_roll - turn) <= 2.0 * AGREEMENT:
                turn, source[i] = by_roll, 1
        track = tracks[last - 1] + turn * (now - v[last - 1, 0])
        out[i] = ahead, speed * turn, speed, track
    return out, source


# --- the comparison

PERIOD = 1.0
AZIMUTH_SIGMA, RANGE_SIGMA = 0.08 * DEG, 30.0
SINGERS = {"S1": 1.074264684, "S2": 2.504689245}
"""1 sigma of Singer's acceleration, m/s2: 0.2 g in his formula, and the turn of a small aircraft."""
RESIDUAL = np.array([0.8, 0.8, 1.5, 2.5])
"""1 sigma of the residual acceleration, m/s2, by its source (`received_nodes`). In a turn, the lag of a slope over
seconds is twice that of a report (quantised track rates are off by 0.04 deg/s for minutes)."""
SIMULATED_RESIDUAL = 0.2


@dataclass(frozen=True)
class Tracks:
    """Errors (run, n) of every filter in azimuth, deg, and ground range, m, at `time` (n,); nis of azimuth."""

    time: np.ndarray
    azimuth: dict[str, np.ndarray]
    range: dict[str, np.ndarray]
    nis: dict[str, np.ndarray]


def radial(node: np.ndarray, azimuth: np.ndarray, ground_range: np.ndarray) -> np.ndarray:
    """Second derivative of the ground range (n,) from nodes (n, 4) and the measured azimuth and range."""
    d = node[:, 3] - azimuth
    across = node[:, 2] * np.sin(d)
    return node[:, 0] * np.cos(d) - node[:, 1] * np.sin(d) + across**2 / ground_range


def track_plots(
    flight: CircuitFlight, driven: dict[str, tuple[np.ndarray, np.ndarray]], seed: int, runs: int
) -> Tracks:
    """Simulated plots of a flight through Singer's filters and through L4 with motion nodes (n, 4) or (run, n, 4).

    Each has a residual acceleration (n,), m/s2.
    """
    n = flight.time.size
    truth, ground_truth = np.unwrap(flight.azimuth), flight.ground_range
    names = [*SINGERS, *driven]
    azimuth = {name: np.empty((runs, n)) for name in names}
    nis = {name: np.empty((runs, n)) for name in names}
    ranges = {name: np.empty((runs, n)) for name in names}
    phi, q = singer(PERIOD, 0.05, 1.0)
    spare, triple, states = np.empty(n), np.empty((n, 3)), np.zeros((n, 3))
    states[:, 0] = ground_truth
    for run in range(runs):
        noise = generator(seed, run, "plots").standard_normal((n, 2))
        measured = truth + AZIMUTH_SIGMA * noise[:, 0]
        slant = flight.range + RANGE_SIGMA * noise[:, 1]
        ground = np.sqrt(np.maximum(slant**2 - flight.position[:, 1] ** 2, 1.0))
        for name in names:
            node, residual = driven.get(name) or next(iter(driven.values()))
            now = node if node.ndim == 2 else node[run]
            before = np.concatenate([now[:1], now[:-1]])
            sigma = np.full(n, SINGERS[name]) if name in SINGERS else residual
            azimuth_filter(
                SINGER if name in SINGERS else FIRST, PERIOD, measured, ground, AZIMUTH_SIGMA**2, phi, q, sigma,
                before, now, truth, azimuth[name][run], spare, nis[name][run],
            )  # fmt: skip
            rate = float(now[0, 2] * np.cos(now[0, 3] - measured[0]))
            if name in SINGERS:
                error = np.empty((n, 3))
                singer_range(
                    ground, RANGE_SIGMA**2, phi, sigma[0] ** 2 * q, np.array([ground[0], rate, 0.0]),
                    np.array([RANGE_SIGMA**2, 25.0, sigma[0] ** 2]), states, error, triple,
                )  # fmt: skip
                ranges[name][run] = error[:, 0]
            else:
                push = radial(now, measured, ground)
                range_filter(
                    PERIOD, ground, RANGE_SIGMA**2, sigma, np.concatenate([push[:1], push[:-1]]), push, rate,
                    ground_truth, ranges[name][run], spare,
                )  # fmt: skip
    return Tracks(flight.time, {k: e / DEG for k, e in azimuth.items()}, ranges, nis)
