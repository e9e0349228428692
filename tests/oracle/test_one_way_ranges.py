"""One-way ranges with free clocks beside an inertial sensor, against dense least squares and simulated truth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from navsim.filter import states
from navsim.formats.recorded_data import Ranges
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.replays import study
from navsim.replays.flight_tables import _with_clock
from navsim.replays.recorded_flight import KnownStart, PartStart
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from navsim.statistics.chi_square import quantile
from navsim.trajectory.recorded import RecordedTrajectory
from tests.conftest import Within
from tests.recordings import drive, record, write_recording

C, EARTH_RATE, EARTH_RADIUS = 299792458.0, 7.292115e-5, 6.378e6
NOISE = {"ocxo": (8e-20, 4e-23), "tcxo": (1e-21, 2e-20)}
"""h0, s, and h_-2, 1/s: Brown & Hwang; Irsigler & Eissfeller."""
NAMES = "abcd"
SITES = np.array([[900.0, 100.0, -15.0], [-200.0, 1200.0, -60.0], [-700.0, -300.0, -5.0], [300.0, -900.0, -90.0]])
"""North, east, down of the sources from the middle of the drive, m."""
START = np.array([0.003, 0.004, 0.002, 0.001, 0.001, 0.001])
"""1 sigma of position and velocity at the start of the small case, m, m/s."""
FIXED = ("gnss.latency_s=0", "checks=off", "gnss.velocity_sigma_m_s=[0.1, 0.1]")


def step_noise(oscillator: str, dt: float) -> np.ndarray:
    """Covariance (2, 2) of offset and rate, m, m/s, that a clock gathers over dt, s."""
    h0, h_minus2 = NOISE[oscillator]
    phase, frequency = 0.5 * C**2 * h0, 2.0 * np.pi**2 * C**2 * h_minus2
    both = 0.5 * frequency * dt**2
    return np.array([[phase * dt + frequency * dt**3 / 3.0, both], [both, frequency * dt]])


def drawn_clock(
    rng: np.random.Generator, oscillator: str, count: int, dt: float, sigma: tuple[float, float]
) -> np.ndarray:
    """Offset and rate (count, 2) of a clock every dt seconds."""
    out = np.empty((count, 2))
    out[0] = sigma * rng.standard_normal(2)
    root = np.linalg.cholesky(step_noise(oscillator, dt))
    for k in range(1, count):
        out[k] = [[1.0, dt], [0.0, 1.0]] @ out[k - 1] + root @ rng.standard_normal(2)
    return out


def sites(trajectory: RecordedTrajectory) -> np.ndarray:
    """ECEF, m."""
    middle = trajectory.motion(np.array([60.0]))
    return np.asarray(middle.position_ecef[0] + SITES @ ned_matrix(middle.llh[0]))


def log_of(folder: Path, trajectory: RecordedTrajectory, rows: list[str], sections: str) -> None:
    """Add ranges, positions of their sources and further sections to the log of a recording."""
    (folder / "r.csv").write_text("\n".join(["t_s,source,range_m", *rows]) + "\n")
    llh = llh_from_ecef(sites(trajectory)).tolist()
    places = "".join(
        f"    - {{name: {name}, lat_deg: {np.degrees(lat):.12f}, lon_deg: {np.degrees(lon):.12f}, height_m: {h:.6f}}}\n"
        for name, (lat, lon, h) in zip(NAMES, llh, strict=True)
    )
    with (folder / "log.yaml").open("a") as log:
        log.write(f"sources:\n  positions:\n{places}{sections}")


class DenseSolution:
    """One large least squares problem: errors of position and velocity at 20 s (ECEF), clocks there and at each second
    after it. The solution is that of the last second."""

    def __init__(self, every: list[str], datum: str, llh: np.ndarray, excess: np.ndarray, unit: np.ndarray) -> None:
        """every: clocks but the datum; excess (m, 4): ranges less distances; unit (m, 4, 3): to the sources, ECEF."""
        q, m = 2 * len(every), len(excess)
        self.size = 6 + q * (m + 1)
        prior = {name: np.square([1e3, 100.0] if name == "receiver" else [0.05, 0.02]) for name in ("receiver", *NAMES)}
        noise = {name: step_noise("tcxo" if name == "receiver" else "ocxo", 1.0) for name in prior}
        share = np.kron(np.ones((len(every),) * 2), np.eye(2))
        first = np.diag(np.concatenate([prior[name] for name in every])) + share * np.tile(prior[datum], len(every))
        step = block_diag(*(noise[name] for name in every)) + np.kron(np.ones((len(every),) * 2), noise[datum])
        on = np.kron(np.eye(len(every)), [[1.0, 1.0], [0.0, 1.0]])
        axes = ned_matrix(llh)
        motion = np.zeros((6, 6))
        motion[:3, 3:] = np.eye(3)
        motion[3:, :3] = 9.8 / EARTH_RADIUS * axes.T @ np.diag([-1.0, -1.0, 2.0]) @ axes
        motion[3:, 3:] = -2.0 * EARTH_RATE * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        self.rows, self.right = [], []
        self._add(np.hstack([block_diag(axes, axes), np.zeros((6, self.size - 6))]), START**2 * np.eye(6), np.zeros(6))
        mean = np.zeros(q)
        mean[:: q if "receiver" in every else 2] = 700.0 if "receiver" in every else -700.0
        self._add(np.eye(q, self.size, 6), first, mean)
        for k in range(m):
            at = 6 + q * (k + 1)
            self._add(np.eye(q, self.size, at) - on @ np.eye(q, self.size, at - q), step, np.zeros(q))
            row = np.zeros((len(NAMES), self.size))
            row[:, :6] = -unit[k] @ expm(motion * (k + 1.0))[:3]
            for i, name in enumerate(NAMES):
                for sign, clock in ((1.0, "receiver"), (-1.0, name)):
                    if clock != datum:
                        row[i, at + 2 * every.index(clock)] = sign
            self._add(row, 0.02**2 * np.eye(len(NAMES)), excess[k])
        a = np.concatenate(self.rows)
        best, covariance = np.linalg.lstsq(a, np.concatenate(self.right))[0], np.linalg.inv(a.T @ a)
        end = expm(motion * m)[:3]
        self.clocks, self.clock_covariance = best[-q:], covariance[-q:, -q:]
        self.position, self.position_covariance = end @ best[:6], end @ covariance[:6, :6] @ end.T

    def _add(self, row: np.ndarray, covariance: np.ndarray, right: np.ndarray) -> None:
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        self.rows.append(root @ row)
        self.right.append(root @ right)


@pytest.mark.validates("Clocks, position and sigmas by one-way ranges beside an inertial sensor",
                       "dense least squares in numpy", estimate="1e-6 m", sigma="1e-5 (relative)")  # fmt: skip
@pytest.mark.parametrize("datum", ["b", "receiver"])
def test_clocks_are_dense_least_squares(datum: str, within: Within, tmp_path: Path) -> None:
    """Seven seconds of a car with sensors that are nearly perfect, whose start is known to millimetres."""
    trajectory, rng = drive(), np.random.default_rng(4)
    write_recording(tmp_path, *record(trajectory, 1, gyro_bias=0.0, accel_bias=0.0, gyro_noise=0.0, accel_noise=0.0,
                                      velocities="none", position_noise=0.0, latency=0.0))  # fmt: skip
    time, start = np.arange(21.0, 28.0), trajectory.motion(np.array([20.0]))
    rpy = np.degrees(start.rpy[0]).tolist()
    lat, lon, height = start.llh[0].tolist()
    known = (
        f"alignment: {{known: {{time_s: 20, lat_deg: {np.degrees(lat):.12f}, lon_deg: {np.degrees(lon):.12f}, "
        f"height_m: {height:.9f}, velocity_m_s: {start.velocity_ned[0].tolist()}, attitude_deg: {rpy}, "
        f"position_sigma_m: {START[:3].tolist()}, velocity_sigma_m_s: {START[3:].tolist()}, "
        "attitude_sigma_deg: [0, 0, 0]}}\nend_s: 27\n"
    )
    base = (
        "gnss.position_sigma_m=[1e6, 1e6]", "imu.gyro={drift_deg_h: 0, markov_deg_h: 0, arw_deg_sqrt_h: 1e-6}",
        "imu.accelerometer={bias_mg: 0, markov_mg: 0, vrw_m_s_sqrt_h: 1e-6}", "filter.gate.probability=0",
        "filter.steady_force=false", "filter.output_rate_hz=1", *FIXED,
    )  # fmt: skip
    log = tmp_path / "log.yaml"
    plain = log.read_text() + known
    log.write_text(plain)
    nominal = study.compute(study.prepare(*read_replay(log, base)))
    at = np.searchsorted(nominal["/filter/time"], time - 1e-6)
    place = ecef_from_llh(nominal["/filter/position_llh"][at])
    away = sites(trajectory)[None] - place[:, None]
    distance = np.linalg.norm(away, axis=2)
    every = [name for name in ("receiver", *NAMES) if name != datum]
    true = {name: drawn_clock(rng, "tcxo", 7, 1.0, (0.05, 0.02)) for name in ("receiver", *NAMES)}
    true["receiver"][:, 0] += 700.0 + 3.0 * np.arange(7.0)
    offset = np.stack([true["receiver"][:, 0] - true[name][:, 0] for name in NAMES], axis=1)
    measured = distance + offset + 0.02 * rng.standard_normal(distance.shape)
    rows = [f"{t},{name},{r!r}" for t, each in zip(time, measured.tolist(), strict=True)
            for name, r in zip(NAMES, each, strict=True)]  # fmt: skip
    log_of(tmp_path, trajectory, rows, (
        f"clocks: {{datum: {datum}, sources: {{oscillator: ocxo}}, receiver: {{oscillator: tcxo}}, "
        "offset_sigma_m: 0.05, rate_sigma_m_s: 0.02}\nranges: {file: r.csv, measurement: one_way, sigma_m: 0.02}\n"
    ))  # fmt: skip
    result = study.compute(study.prepare(*read_replay(log, base)))
    assert result["/clock"].tolist() == every

    expected = DenseSolution(every, datum, start.llh[0], measured - distance, away / distance[..., None])
    clocks = np.stack([result[f"/filter/clock_{name}"][-1] for name in ("offset", "rate")], axis=1).ravel()
    np.testing.assert_allclose(clocks, expected.clocks, rtol=0.0, atol=within["estimate"])
    axes = ned_matrix(nominal["/filter/position_llh"][-1])
    moved = axes @ (ecef_from_llh(result["/filter/position_llh"][-1]) - place[-1])
    np.testing.assert_allclose(moved, axes @ expected.position, rtol=0.0, atol=within["estimate"])
    assert np.abs(moved).max() > 1e-3
    names = result["/filter/state"].tolist()
    own = [names.index("beacons_clock" if name == "receiver" else f"transmitter_clock_{name}") for name in every]
    sigma = result["/filter/sigma"][-1]
    of_clocks = sigma[np.array(own)[:, None] + [0, 1]].ravel()
    np.testing.assert_allclose(of_clocks, np.sqrt(np.diag(expected.clock_covariance)), rtol=within["sigma"])
    of_position = np.sqrt(np.diag(axes @ expected.position_covariance @ axes.T))
    np.testing.assert_allclose(sigma[:3], of_position, rtol=within["sigma"])


def recorded(
    folder: Path, seed: int, clocks: str, rates: dict[str, float] | None = None, first: dict[str, float] | None = None
) -> dict[str, np.ndarray]:
    """A drive with ranges twice a second, in the files of a recording; offset and rate (k, 2) of its clocks then.

    rates: further rates of clocks, m/s; first: times from which on a source is heard, s.
    """
    trajectory, rng = drive(), np.random.default_rng([seed, 1])
    write_recording(folder, *record(trajectory, seed, fix_rate=2.0, position_noise=0.0, latency=0.0))
    names, *rows = (folder / "gnss.csv").read_text().splitlines()
    table = np.array([row.split(",") for row in rows], float)
    table[:, 1:4] += 0.5 * rng.standard_normal((len(table), 3)) / [EARTH_RADIUS * np.pi / 180.0, 78000.0, 1.0]
    np.savetxt(folder / "gnss.csv", table, "%.12g", ",", header=names, comments="")
    time = np.arange(1.0, 118.0, 0.5)
    out = {name: drawn_clock(rng, "ocxo", time.size, 0.5, (50.0, 1.0)) for name in NAMES}
    out["receiver"] = drawn_clock(rng, "tcxo", time.size, 0.5, (1e4, 20.0))
    for name, rate in (rates or {}).items():
        out[name] += np.stack([rate * time, np.full(time.size, rate)], axis=1)
    antenna = trajectory.motion(time).position_ecef
    rows = []
    for i, name in enumerate(NAMES):
        measured = np.linalg.norm(sites(trajectory)[i] - antenna, axis=1) + out["receiver"][:, 0] - out[name][:, 0]
        measured += 0.2 * rng.standard_normal(time.size)
        rows += [f"{t + 1e6:.1f},{name},{r:.5f}" for t, r in zip(time, measured, strict=True)
                 if t >= (first or {}).get(name, 0.0)]  # fmt: skip
    log_of(folder, trajectory, sorted(rows), clocks)
    return out


OWN = (
    "clocks: {datum: c, sources: {oscillator: ocxo}, receiver: {oscillator: tcxo}, offset_sigma_m: 50}\n"
    "ranges: {file: r.csv, measurement: one_way, sigma_m: 0.2, time_offset_s: -1.0e+6}\n"
)


def scaled(
    folder: Path, seed: int, *more: str, rates: dict[str, float] | None = None, first: dict[str, float] | None = None
) -> tuple[np.ndarray, Result]:
    """Errors of position, offsets and rates of clocks in their sigmas (t, k) from 30 s on, and the result; rates,
    first: as of `recorded`."""
    true = recorded(folder, seed, OWN, rates, first)
    settings = ("gnss.position_sigma_m=[0.5, 0.5]", "filter.output_rate_hz=2", *FIXED, *more)
    result = study.compute(study.prepare(*read_replay(folder / "log.yaml", settings)))
    late = (result["/filter/time"] >= 30.0) & (result["/filter/time"] < 117.0)
    time, sigma, names = result["/filter/time"][late], result["/filter/sigma"][late], result["/filter/state"].tolist()
    motion, at = drive().motion(time), np.rint(2.0 * (time - 1.0)).astype(int)
    estimate = ecef_from_llh(result["/filter/position_llh"][late])
    z = [np.einsum("tij,tj->ti", ned_matrix(motion.llh), motion.position_ecef - estimate) / sigma[:, :3]]
    for k, name in enumerate(result["/clock"]):
        own = names.index("beacons_clock" if name == "receiver" else f"transmitter_clock_{name}")
        error = (true[name] - true["c"])[at]
        error -= np.stack([result[f"/filter/clock_{what}"][late, k] for what in ("offset", "rate")], axis=1)
        z.append(error / sigma[:, own : own + 2])
    return np.concatenate(z, axis=1), result


def test_free_clocks_beside_an_inertial_sensor(tmp_path: Path) -> None:
    """Errors are within their sigmas, also while fixes are withheld, where ranges bound the drift."""
    z, result = scaled(tmp_path, 11, "outages=[{start_s: [60], duration_s: [20], withhold: true}]", "end_s=90")
    assert result["/clock"].tolist() == ["receiver", "a", "b", "d"]
    assert np.abs(z).max() < 4.5
    used = result["/summary/aid_used"].sum()
    assert (
        quantile(1e-4, used) < result["/summary/aid_nis"][:, 0] @ result["/summary/aid_used"] < quantile(0.9999, used)
    )
    away = (result["/filter/time"] > 70.0) & (result["/filter/time"] < 80.0)
    assert result["/filter/sigma"][away, :2].max() < 1.0
    np.testing.assert_array_equal(result["/summary/clock_offset"], result["/filter/clock_offset"][-1])
    assert not of(result)


def test_clocks_that_are_farther_apart_than_expected(tmp_path: Path) -> None:
    """The finding names them, and the key; with that value their ranges are used."""
    settings = ("end_s=40", "clocks.offset_sigma_m=1")
    text = next(found.text for found in of(scaled(tmp_path, 11, *settings)[1]) if found.name == "clock_offset")
    assert "the filter rejects ranges of b, d" in text
    write = re.search(r"offset_sigma_m: (\d+)", text)
    assert write is not None
    log = tmp_path / "log.yaml"
    again = study.compute(
        study.prepare(*read_replay(log, (*settings[:1], f"clocks.offset_sigma_m={write[1]}", *FIXED)))
    )
    assert again["/summary/aid_rejected"].sum() == 0


FAST = {"receiver": 600.0}


@pytest.mark.parametrize(
    ("rates", "first", "more"),
    [
        (FAST, {}, ()),
        ({"receiver": -6000.0}, {}, ("clocks.datum=receiver",)),
        (FAST, {"c": 24.0}, ()),
        (FAST, dict.fromkeys(NAMES, 33.0), ("outages=[{start_s: [20], duration_s: [15], withhold: true}]",)),
    ],
    ids=["fast", "20 ppm, reference", "late reference", "first heard without fixes"],
)
def test_a_receiver_clock_that_runs_fast(
    rates: dict[str, float], first: dict[str, float], more: tuple[str, ...], tmp_path: Path
) -> None:
    """No range is rejected, and errors are within their sigmas where the reference is a source."""
    z, result = scaled(tmp_path, 12, "end_s=40", *more, rates=rates, first=first)
    assert result["/summary/aid_rejected"].sum() == 0
    assert result["/summary/aid_used"].min() > 10
    assert not [found for found in of(result) if found.name.startswith("clock")]
    if "clocks.datum=receiver" not in more:
        assert np.abs(z).max() < 4.5


def test_a_rate_that_ranges_do_not_show(tmp_path: Path) -> None:
    """Two ranges of each source, half a second apart: those of a quartz 20 ppm off are used."""
    late = dict.fromkeys(NAMES, 39.4)
    result = scaled(tmp_path, 12, "end_s=40.1", rates={"receiver": 6000.0}, first=late)[1]
    assert result["/summary/aid_used"].tolist() == [2] * 4
    assert np.abs(result["/summary/clock_rate"][0] - 6000.0) < 60.0


def test_fixes_that_are_withheld_do_not_start_the_clocks(tmp_path: Path) -> None:
    """Wrong positions there change nothing."""
    recorded(tmp_path, 12, OWN, first=dict.fromkeys(NAMES, 25.0))
    settings = ("end_s=35", "tuning=none", "outages=[{start_s: [24], duration_s: [6], withhold: true}]", *FIXED)
    names, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    table, clocks = np.array([row.split(",") for row in rows], float), []
    for off in (0.0, 0.01):
        table[(table[:, 0] > 24.5) & (table[:, 0] < 29.5), 1] += off
        np.savetxt(tmp_path / "gnss.csv", table, "%.12g", ",", header=names, comments="")
        clocks.append(
            study.compute(study.prepare(*read_replay(tmp_path / "log.yaml", settings)))["/filter/clock_offset"]
        )
    np.testing.assert_array_equal(clocks[0], clocks[1])


def test_clocks_that_run_apart(tmp_path: Path) -> None:
    """The finding names the key and the value, with which all ranges are used; a late reference is not far by it."""
    rates = {"receiver": 100.0, "a": 10.0, "b": -10.0, "d": 12.0}
    found = of(scaled(tmp_path, 12, "end_s=50", rates=rates, first={"c": 30.0})[1])
    text = next(one.text for one in found if one.name == "clock_rate")
    write = re.search(r"Write `clocks.rate_sigma_m_s: (\d+)`", text)
    assert write is not None
    assert 8 < int(write[1]) < 14
    assert "clock_offset" not in [one.name for one in found]
    again = scaled(tmp_path, 12, "end_s=50", f"clocks.rate_sigma_m_s={write[1]}", rates=rates, first={"c": 30.0})[1]
    assert again["/summary/aid_rejected"].sum() == 0


def test_a_source_with_the_name_of_the_receiver_is_refused(tmp_path: Path) -> None:
    recorded(tmp_path, 11, OWN)
    for name in ("log.yaml", "r.csv"):
        text = (tmp_path / name).read_text().replace("name: d,", "name: receiver,").replace(",d,", ",receiver,")
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="a source is named receiver"):
        study.prepare(*read_replay(tmp_path / "log.yaml", FIXED))


def test_states_that_geometry_cannot_tell_apart_are_named(tmp_path: Path) -> None:
    """A car that has hardly moved, among sources of unknown position: that of the reference looks like its clock."""
    recorded(tmp_path, 11, OWN.replace("offset_sigma_m: 50", "offset_sigma_m: 1000"))
    settings = ("ranges.survey_sigma_m=300", "end_s=24", "gnss.position_sigma_m=[0.5, 0.5]", *FIXED)
    result = study.compute(study.prepare(*read_replay(tmp_path / "log.yaml", settings)))
    text = next(found.text for found in of(result) if found.name == "correlated_states")
    assert "position of c, north and beacons clock" in text
    assert "beacons clock and" not in text  # both are counted against the same clock


@pytest.mark.long
def test_every_clock_is_consistent(tmp_path: Path) -> None:
    """Of 40 drives: RMS of error over sigma of each state."""
    z = np.stack([scaled(tmp_path, 100 + seed)[0] for seed in range(40)])
    size = np.sqrt(np.mean(z**2, axis=(0, 1)))
    assert np.all((size > 0.8) & (size < 1.25)), size


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("datum: c, ", "", "offset of all sources' clocks looks like one of the receiver's"),
        (OWN.splitlines()[0], "", "Name the clock against which the others are counted"),
        ("datum: c", "datum: e", "e has no range"),
        ("one_way", "two_way", "only ranges with `measurement: one_way` have clocks"),
        ("sigma_m: 0.2", "sigma_m: 0.2, bias_sigma_m: 0.1", "clock contains a constant bias"),
        ("sigma_m: 0.2", "sigma_m: 0.2, growth: {sigma_m: 1}", "do not show the distance"),
    ],
)
def test_what_cannot_be_told_apart_is_refused(old: str, new: str, message: str, tmp_path: Path) -> None:
    recorded(tmp_path, 11, OWN.replace(old, new))
    with pytest.raises(InputError, match=message):
        study.prepare(*read_replay(tmp_path / "log.yaml", FIXED))


def test_the_clock_of_satellites_comes_behind_all_sensor_states() -> None:
    """Of a tightly coupled filter that has more states than biases, as headings, wheels and ranges give it."""
    place = ecef_from_llh(np.array([0.8, 0.2, 100.0]))
    away, zero = np.add(place, [[[2e7, 0.0, 0.0]]]), np.zeros((1, 1, 3))
    one = np.ones((1, 1))
    measured = (2e7 * one, (2e7 + 500.0) * one, 3.0 * one, one)
    ranges = Ranges(np.ones(1), ("G01",), np.zeros(1, int), ("gps",), away, zero, *measured)
    known = KnownStart(0.0, np.concatenate([[0.8, 0.2, 100.0], np.zeros(3), [1.0], np.zeros(13)]), np.ones(9))
    nav, covariance = _with_clock(known.navigation, np.eye(18), PartStart.at(known), ranges, (0,))
    assert nav.size == states.NAV_SENSORS + 20 - states.SENSORS
    assert covariance.shape == (20, 20)
    np.testing.assert_allclose(nav[20:23], 0.0)
    np.testing.assert_allclose(nav[23:], [500.0, 3.0], atol=1e-6)
