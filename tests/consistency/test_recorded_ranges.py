"""Recorded flights with RINEX observations beside the IMU: a simulated flight written and read again, and a real
station that stands still."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from navsim.filter.records import NOT_USED, REJECTED, USED
from navsim.formats.export import export
from navsim.formats.recorded_data import Ranges, Samples
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.geodesy.earth import RATE, SPEED_OF_LIGHT, ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.constellations.systems import SYSTEMS
from navsim.landing import study as landing
from navsim.replays import study as replay
from navsim.replays.recorded_ranges import _steadied
from navsim.replays.single_point import PositioningOptions, solve
from navsim.results import findings
from navsim.results.result import Result, write
from navsim.runner.executor import threads
from navsim.scenario.load import read, read_replay
from navsim.scenario_files.presets import SENSOR_CLASSES
from navsim.scenario_files.source import InputError
from navsim.simulation.run_inputs import draw_inputs
from navsim.statistics import chi_square
from navsim.trajectory.kinematics import Motion
from tests.helpers import case

SENSORS = SENSOR_CLASSES["industrial"]
FLIGHT = (
    "duration_s=70", f"imu={{rate_hz: 50, gyro: {SENSORS['gyro']}, accelerometer: {SENSORS['accelerometer']}}}",
    "receiver={rate_hz: 2, lever_arm_m: [0.4, 0, -0.3]}", "sky.source=nominal", "sky.broadcast=true",
    "signals.range_sigma_m=0.5", "signals.range_rate_sigma_m_s=0.05",
    "signals.troposphere={truth_scale: 1, correction: none}", "sky.mask_deg=5",
)  # fmt: skip
SEED = 5


@dataclass(frozen=True)
class Written:
    """A flight in files of a folder, what it truly was."""

    folder: Path
    truth: Motion


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("flight")
    ready = case(*FLIGHT, name="s_turn")
    flown = landing.result(ready, landing.fly_all(ready, SEED, 0, 1, threads(1), keep="all"), SEED, keep="all")
    export(flown, folder / "flight.h5", ["rinex"])
    inputs, world = draw_inputs(ready.flight, SEED, [0]), ready.shared
    rates = np.concatenate([inputs.dtheta[..., 0], inputs.dv[..., 0]], axis=1) / np.diff(world.imu_time)[:, None]
    table = np.column_stack([world.imu_time[1:], rates])
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(folder / "imu.csv", table, delimiter=",", header=header, comments="", fmt="%.12g")
    (folder / "log.yaml").write_text(
        f"kind: replay\nversion: 1\nepoch: {ready.scenario.epoch:%Y-%m-%dT%H:%M:%SZ}\n"
        "imu: {file: imu.csv, sensor_class: industrial, samples: averaged}\n"
        "gnss: {file: flight.obs, navigation: flight.nav, lever_arm_m: [0.4, 0, -0.3], mask_deg: 5,\n"
        "       range_sigma_m: 0.5, range_rate_sigma_m_s: 0.05}\n"
        "tuning: none\nfilter: {coupling: tight}\n"
    )
    return Written(folder, world.truth)


def replayed(log: Path, *assignments: str) -> Result:
    return replay.compute(replay.prepare(*read_replay(log, assignments)))


def off(result: Result, truth: Motion) -> np.ndarray:
    """Errors of position (t, 3), NED, m, at the outputs."""
    time = result["/filter/time"]
    true = np.stack([np.interp(time, truth.time, truth.llh[:, i]) for i in range(3)], axis=1)
    gap = ecef_from_llh(true) - ecef_from_llh(result["/filter/position_llh"])
    return np.einsum("tij,tj->ti", ned_matrix(true), gap)


def test_a_flight_is_flown_by_its_ranges(written: Written) -> None:
    """Errors are what σ says, and no larger than the loose filter's; innovations have their sizes."""
    tight = replayed(written.folder / "log.yaml")
    loose = replayed(written.folder / "log.yaml", "filter.coupling=loose", "gnss.velocity_sigma_m_s=[0.05, 0.08]")
    late = slice(100, None)
    size = [np.sqrt(np.mean(np.sum(off(one, written.truth)[late] ** 2, axis=1))) for one in (tight, loose)]
    sigma = np.sqrt(np.mean(np.sum(tight["/filter/sigma"][late, :3] ** 2, axis=1)))
    assert 0.3 < size[0] / sigma < 2.0
    assert size[0] < 1.05 * size[1]
    assert list(tight["/filter/state"])[15:] == ["clock_bias_glonass", "clock_bias_gps", "clock_drift"]
    assert tight["/summary/nis"][0] == pytest.approx(1.0, abs=0.15)
    used = tight["/innovations/range_status"] == USED
    np.testing.assert_array_equal(tight["/innovations/degrees"], 2 * used.sum(axis=1))
    np.testing.assert_array_equal(np.isfinite(tight["/innovations/range"]), used)
    assert np.nanstd(tight["/innovations/range"][50:]) < 1.5
    # the fixes are told, and not used; their sizes are those of the geometry
    assert np.isfinite(tight["/innovations/position_ned"]).all()
    for name in ("position", "velocity"):
        ratio = tight[f"/innovations/{name}_ned"][50:] / tight[f"/innovations/{name}_ned_sigma"][50:]
        assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.5, name


def test_an_outage_of_all_and_of_some(written: Written) -> None:
    """Withheld ranges: the drift is told by the fix at the end; with three satellites alone there is no fix, and the
    tight filter stays near."""
    outage = "outages=[{start_s: [45], duration_s: [15], withhold: true}]"
    whole = replayed(written.folder / "log.yaml", outage)
    inside = (whole["/innovations/time"] >= 45.0) & (whole["/innovations/time"] <= 60.0)
    assert np.all(whole["/innovations/range_status"][inside] == NOT_USED)
    assert np.isfinite(whole["/outages/horizontal_error"]).all()
    recording = replay.prepare(*read_replay(written.folder / "log.yaml", ()))
    assert recording.ranges is not None
    few = recording.ranges.pseudorange.copy()
    between = (recording.ranges.time >= 45.0) & (recording.ranges.time <= 60.0)
    best = np.argsort(np.where(np.isfinite(few[between]).all(axis=0), recording.ranges.slant[between][0], np.inf))
    few[np.ix_(between, best[3:])] = np.nan
    fixes = recording.fixes.take(np.flatnonzero((recording.fixes.time < 45.0) | (recording.fixes.time > 60.0)))
    some = replay.compute(replace(recording, ranges=replace(recording.ranges, pseudorange=few), fixes=fixes))
    at = np.searchsorted(whole["/filter/time"], 60.0 - 1e-6)
    drift = [np.linalg.norm(off(one, written.truth)[at]) for one in (whole, some)]
    assert drift[1] < drift[0]
    assert some["/filter/sigma"][at, :3].max() < 0.7 * whole["/filter/sigma"][at, :3].max()
    assert np.all(some["/innovations/degrees"][(some["/innovations/time"] > 45.5) & inside] == 6)


@pytest.mark.parametrize("kind", [pytest.param("rts", marks=pytest.mark.long), "map", "gaussian-sum"])
def test_other_kinds(written: Written, kind: str) -> None:
    one = replayed(written.folder / "log.yaml", f"filter.kind={kind}", "end_s=40")
    assert np.sqrt(np.mean(off(one, written.truth)[100:] ** 2)) < 1.0


def test_what_a_gate_rejects_is_counted(written: Written) -> None:
    """A satellite that is off by 100 m is told, and the others fly on; ranges without an atmosphere say so."""
    recording = replay.prepare(*read_replay(written.folder / "log.yaml", ("filter.gate={probability: 1.0e-4}",)))
    assert recording.ranges is not None
    wrong = recording.ranges.pseudorange.copy()
    best = int(np.argmin(np.where(np.isfinite(wrong).all(axis=0), recording.ranges.slant[0], np.inf)))
    wrong[60:90, best] += 100.0
    one = replay.compute(replace(recording, ranges=replace(recording.ranges, pseudorange=wrong)))
    rejected = one["/innovations/range_status"] == REJECTED
    assert rejected[:, best].sum() > 20
    assert one["/summary/count/rejected"] == rejected.sum()
    assert "rejected_ranges" in list(one["/findings/finding"])
    bare = replayed(written.folder / "log.yaml", "gnss.atmosphere=false", "end_s=40")
    assert off(bare, written.truth)[100:, 2].mean() - off(one, written.truth)[100:300, 2].mean() > 3.0


# --- holes, missing epochs and outliers of a tightly coupled flight


@pytest.fixture(scope="module")
def recording(written: Written) -> replay.Recording:
    return replay.prepare(*read_replay(written.folder / "log.yaml", ()))


def scaled(result: Result, truth: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Mean square (t,) of the errors of position, velocity and attitude in their sigma, at the outputs that are not
    worthless, from the tenth epoch on; and the times (t,)."""
    time = result["/filter/time"]

    def at(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, truth.time, values[:, i]) for i in range(3)], axis=1)

    turn = at(np.unwrap(truth.rpy, axis=0)) - result["/filter/attitude_rpy"]
    errors = [off(result, truth), at(truth.velocity_ned) - result["/filter/velocity_ned"],
              (turn + np.pi) % (2.0 * np.pi) - np.pi]  # fmt: skip
    square = np.mean((np.concatenate(errors, axis=1) / result["/filter/sigma"][:, :9]) ** 2, axis=1)
    sound = time > result["/innovations/time"][9]
    for begin, end in zip(result["/lost/start"], result["/lost/end"], strict=True):
        sound &= (time < begin) | (time > end)
    return square[sound], time[sound]


def best(ranges: Ranges) -> np.ndarray:
    """Columns of the sources that are always there, the highest first."""
    there = np.flatnonzero(np.isfinite(ranges.pseudorange).all(axis=0))
    return there[np.argsort(ranges.slant[0, there])]


def changed(
    ranges: Ranges, rows: np.ndarray, columns: np.ndarray, away: np.ndarray | float, faster: float = 0.0
) -> Ranges:
    """Some pseudoranges `away` m longer, their rates `faster` m/s."""
    pseudorange, rate = ranges.pseudorange.copy(), ranges.range_rate.copy()
    pseudorange[np.ix_(rows, columns)] += away
    rate[np.ix_(rows, columns)] += faster
    return replace(ranges, pseudorange=pseudorange, range_rate=rate)


@pytest.mark.parametrize(("first", "length"), [(30.0, 1.0), (30.0, 15.0), (25.0, 30.0)])
def test_a_hole_of_the_samples(recording: replay.Recording, written: Written, first: float, length: float) -> None:
    """Short ones are carried across; after longer ones the flight is aligned again, by the fixes, and its clock too."""
    kept = (recording.samples.time <= first) | (recording.samples.time >= first + length)
    samples = Samples(*(values[kept] for values in vars(recording.samples).values()))
    result = replay.compute(replace(recording, samples=samples))
    spans = np.stack([result["/lost/start"], result["/lost/end"]], axis=1)
    np.testing.assert_allclose(spans, [[first, first + length]] if length > 1.0 else np.empty((0, 2)), atol=0.05)
    square, time = scaled(result, written.truth)
    assert time.max() > 69.0
    assert square.mean() < 2.0
    assert square.max() < 5.0
    assert result["/summary/count/rejected"] == 0


def test_missing_epochs(recording: replay.Recording, written: Written) -> None:
    """15 s without any range: told, and the sigmas are those of the errors."""
    ranges = recording.ranges
    assert ranges is not None
    gone = (ranges.time > 30.0) & (ranges.time < 45.0)
    fixes = recording.fixes.take(~np.isin(recording.fixes.time, ranges.time[gone]))
    result = replay.compute(replace(recording, ranges=ranges.take(np.flatnonzero(~gone)), fixes=fixes))
    assert any(found.text.startswith("no fixes for 15.5 s") for found in findings.of(result))
    square, _ = scaled(result, written.truth)
    assert square.mean() < 2.0
    assert square.max() < 5.0


@pytest.mark.parametrize("name", ["a rate", "half of the sources", "all of a second", "the clock", "three sources"])
def test_outliers(name: str, recording: replay.Recording, written: Written) -> None:
    """The gate rejects what cannot be true, one range at a time, also of epochs with too few sources for a fix, which
    no other test has seen; the rest is flown on."""
    ranges, fixes = recording.ranges, recording.fixes
    assert ranges is not None
    some, rows = best(ranges), np.flatnonzero((ranges.time > 30.0) & (ranges.time < 45.0))
    rejected = rows.size
    if name == "a rate":
        ranges = changed(ranges, rows, some[:1], 0.0, 10.0)
    elif name == "half of the sources":
        ranges, rejected = changed(ranges, rows, some[::2], 100.0), rows.size * some[::2].size
    elif name == "all of a second":
        away = np.random.default_rng(1).normal(0.0, 1000.0, (2, some.size))
        # and those of the next epoch, since the clock may have jumped where all ranges are rejected
        ranges, rejected = changed(ranges, rows[:2], some, away), 3 * some.size - 2
    elif name == "the clock":
        ranges = changed(ranges, np.flatnonzero(ranges.time > 30.0), some, 300.0)
        rejected = some.size  # of the first epoch, by which the jump is seen
    else:
        few = ranges.pseudorange.copy()
        few[np.ix_(rows, np.setdiff1d(np.arange(few.shape[1]), some[:3]))] = np.nan
        ranges = changed(replace(ranges, pseudorange=few), rows, some[:1], 100.0)
        fixes = fixes.take(~np.isin(fixes.time, ranges.time[rows]))
    result = replay.compute(replace(recording, ranges=ranges, fixes=fixes))
    assert result["/lost/start"].size == 0
    assert abs(int(result["/summary/count/rejected"]) - rejected) <= 2
    square, _ = scaled(result, written.truth)
    assert square.mean() < 2.0
    assert square.max() < 5.0


@pytest.mark.parametrize(("wrong", "size"), [(1, 5.0), (2, -5.0), (4, 30.0), (7, 30.0)])
def test_wrong_dopplers_are_excluded(wrong: int, size: float, written: Written) -> None:
    """At each second epoch some range rates are off by so many m/s: excluded, and the velocities those of the others;
    where half of them are wrong there is no velocity. Without outliers no velocity changes."""
    constellations = read_nav(written.folder / "flight.nav", systems=SYSTEMS).constellations()
    observations = read_obs(written.folder / "flight.obs")
    options = PositioningOptions(mask=np.radians(5.0))
    good = solve(observations, constellations, options)
    assert not good.verdicts.excluded_rates.any()
    names, due = good.ranges.names, np.zeros(good.residual.shape, bool)
    doppler = observations.values["D1C"].copy()
    for epoch in range(0, doppler.shape[0], 2):
        for k in range(wrong):
            column = (epoch // 2 + 3 * k) % len(names)
            due[epoch, column] = True
            doppler[epoch, observations.satellites.index(names[column])] += (-1.0) ** k * size / 0.19
    found = solve(replace(observations, values={**observations.values, "D1C": doppler}), constellations, options)
    np.testing.assert_array_equal(found.velocity[1::2], good.velocity[1::2])
    np.testing.assert_array_equal(found.llh, good.llh)
    if wrong == 7:
        assert np.isnan(found.velocity[::2]).all()
        assert found.verdicts.report(names) == (
            "70 fixes without a velocity, since their range rates contradict each other",
        )
        return
    np.testing.assert_array_equal(found.verdicts.excluded_rates, due)
    np.testing.assert_array_equal(np.isnan(found.ranges.range_rate), due | np.isnan(good.ranges.range_rate))
    np.testing.assert_allclose(found.velocity, good.velocity, atol=0.3)
    (said,) = found.verdicts.report(names)
    assert said.startswith(f"{70 * wrong} range rates excluded at 70 epochs, since they contradict the others: R01")


def test_a_rate_that_is_wrong_at_every_epoch_is_excluded(written: Written) -> None:
    """It spreads over the residuals of all others, which are no measure of their noise then."""
    constellations = read_nav(written.folder / "flight.nav", systems=SYSTEMS).constellations()
    observations, options = read_obs(written.folder / "flight.obs"), PositioningOptions(mask=np.radians(5.0))
    good = solve(observations, constellations, options)
    doppler = observations.values["D1C"].copy()
    doppler[:, observations.satellites.index(good.ranges.names[3])] += 60.0
    found = solve(replace(observations, values={**observations.values, "D1C": doppler}), constellations, options)
    assert found.verdicts.excluded_rates.all(axis=0).nonzero()[0].tolist() == [3]
    np.testing.assert_allclose(found.velocity, good.velocity, atol=0.3)


def test_rates_of_a_real_station_agree(shared: Path) -> None:
    """Six hours of ESBC: none of its range rates is excluded."""
    folder = shared / "data/esbc_2020177"
    messages = read_nav(folder / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz", systems=SYSTEMS)
    observations = read_obs(folder / "ESBC_2020177_GR_60S.rnx.gz")
    part = slice(0, 360)
    values = {code: table[part] for code, table in observations.values.items()}
    constellations = [c for c in messages.constellations() if c.system.letter in "GR"]
    found = solve(replace(observations, time=observations.time[part], values=values), constellations,
                  PositioningOptions(klobuchar=messages.klobuchar))  # fmt: skip
    assert found.verdicts.report(found.ranges.names) == ()
    assert np.abs(found.velocity).max() < 0.2


def test_noise_of_ranges_is_tuned(written: Written) -> None:
    one = replayed(
        written.folder / "log.yaml", "tuning=likelihood", "gnss.range_sigma_m=null", "gnss.range_rate_sigma_m_s=null",
        "imu.gyro.arw_deg_sqrt_h=0.3", "imu.accelerometer.vrw_m_s_sqrt_h=0.15",
    )  # fmt: skip
    # the landing's noise is the same at all elevations: overhead it is less than that
    assert 0.2 < one["/tuning/range_sigma"] < 0.55
    assert one["/tuning/range_rate_sigma"] == pytest.approx(0.05, rel=0.15)


def test_messages(written: Written, tmp_path: Path) -> None:
    """What is wrong is told at its key."""
    log = written.folder / "log.yaml"
    (tmp_path / "empty.nav").write_text(
        f"{'     3.04           N: GNSS NAV DATA    M: Mixed':60}RINEX VERSION / TYPE\n{'':60}END OF HEADER\n"
    )
    for assignments, match in (
        (("gnss.navigation=nowhere.nav",), r"gnss.navigation\[0\]: nowhere.nav: cannot be read"),
        ((f"gnss.navigation={tmp_path}/empty.nav",), "has no GPS and no GLONASS message"),
        (("gnss.navigation=flight.obs",), "gnss.navigation"),
        (("gnss.file=imu.csv",), "gnss.file"),
        (("epoch=2001-01-01T00:00:00Z",), "no common time"),
        (("gnss.angle_unit=rad",), "RINEX fixes the units"),
        ((f"gnss.navigation_sha256={'0' * 64}",), "gnss.navigation_sha256"),
    ):
        with pytest.raises(InputError, match=match):
            replay.prepare(*read_replay(log, assignments))
    with pytest.raises(InputError, match=r"gnss.range_sigma_m: is for RINEX observations"):
        read_replay(log, ("gnss.navigation=null",))
    plain = tmp_path / "plain.yaml"
    plain.write_text("kind: replay\nversion: 1\nimu: {file: a}\ngnss: {file: b}\nfilter: {coupling: tight}\n")
    with pytest.raises(InputError, match=r"filter.coupling: fixes are all there is"):
        read_replay(plain)


def test_a_receiver_that_puts_its_clock_right_by_milliseconds() -> None:
    """Steps of whole milliseconds are taken out, also across epochs without a fix."""
    step = 1e-3 * SPEED_OF_LIGHT
    clocks = np.array([[100.0, np.nan], [200.0, np.nan], [np.nan, np.nan], [300.0 - step, np.nan], [400.0 - step, 0.0]])
    each = np.arange(5.0)[:, None] * 100.0 + np.array([[0.0, 0.0, 0.0, -step, -step]]).T
    nothing = np.zeros((5, 1, 3))
    ranges = Ranges(np.arange(5.0), ("G01",), np.zeros(1, int), ("gps",), nothing, nothing, each, each, each, each)
    np.testing.assert_allclose(
        _steadied(ranges, clocks).pseudorange[:, 0], [0.0, 100.0, 200.0, 300.0, 400.0], atol=1e-6
    )


def test_a_station_that_stands_still(shared: Path, tmp_path: Path) -> None:
    """20 minutes of ESBC with an industrial IMU at rest: the tight filter is as near to the station as its fixes."""
    folder = shared / "data/esbc_2020177"
    known = json.loads((folder / "truth.json").read_text())
    marker = np.array(known["marker_ITRF2014_at_2020.48_interpolated_m"])
    llh = llh_from_ecef(marker)
    axes = ned_matrix(llh)
    antenna = marker - known["antenna_up_m"] * axes[2]
    time, random = np.arange(12001) / 10.0, np.random.default_rng(0)
    gravity = (
        9.7803253359 * (1 + 0.00193185265241 * np.sin(llh[0]) ** 2) / np.sqrt(1 - 0.00669438 * np.sin(llh[0]) ** 2)
    )
    rate = RATE * np.array([np.cos(llh[0]), 0.0, -np.sin(llh[0])])
    noise = random.standard_normal((time.size, 6)) * np.repeat([np.radians(0.3 / 60), 0.15 / 60], 3) * np.sqrt(10.0)
    table = np.column_stack([time, np.concatenate([rate, [0.0, 0.0, -gravity]]) + noise])
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(tmp_path / "imu.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    (tmp_path / "log.yaml").write_text(
        "kind: replay\nversion: 1\nepoch: 2020-06-25T09:59:42Z\n"
        "imu: {file: imu.csv, sensor_class: industrial}\n"
        f"gnss: {{file: {folder}/ESBC_2020177_GR_60S.rnx.gz,\n"
        f"       navigation: {folder}/ESBC00DNK_R_20201770000_01D_MN.rnx.gz}}\n"
        "alignment: {heading_deg: 0.0, heading_sigma_deg: 1.0}\ntuning: none\n"
        "filter: {coupling: tight, output_rate_hz: 1}\n"
    )
    flown = replayed(tmp_path / "log.yaml")
    fixes = (ecef_from_llh(flown["/receiver/position_llh"]) - antenna) @ axes.T
    last = flown["/filter/time"] > 300.0
    after = np.isin(np.round(flown["/filter/time"], 6), np.round(flown["/innovations/time"], 6)) & last
    errors = (ecef_from_llh(flown["/filter/position_llh"][after]) - antenna) @ axes.T
    assert after.sum() > 10
    assert np.sqrt(np.mean(errors**2)) < 1.1 * np.sqrt(np.nanmean(fixes**2))
    assert (flown["/innovations/range_status"] == USED).sum(axis=1).min() > 9


def test_a_recorded_flight_with_simulated_ranges(shared: Path, tmp_path: Path) -> None:
    """The circuits of fw_thor75, flown again with two satellites and a pseudolite left for 30 s: NEES/6 within the
    99.99 % band, errors well below the loose filter's."""
    folder = shared / "data/fw_thor75"
    (tmp_path / "log.yaml").write_text(
        f"kind: replay\nversion: 1\nimu: {{file: {folder}/imu.csv.gz}}\ngnss: {{file: {folder}/gnss.csv}}\n"
        "start_s: 150\nend_s: 400\ntuning: none\n"
    )
    # of this flight the path alone is used: by untuned noise the gate rejects true fixes for 10 s, and what the filter
    # then starts anew from is no path to fly
    recorded = replayed(tmp_path / "log.yaml", "filter.gate.probability=0")
    write(tmp_path / "flight.h5", recorded)
    (tmp_path / "landing.yaml").write_text(
        "kind: landing\nversion: 1\nepoch: 2012-09-13T12:00:00Z\nduration_s: 85\n"
        "runway: {threshold: {lat_deg: 45.32988, lon_deg: -93.22812}, heading_deg: 0, height_m: 200}\n"
        "approach: {profile: recorded, file: flight.h5, start_s: 300}\nreceiver: {rate_hz: 2}\n"
        "sky: {source: nominal}\npseudolites: {count: 1, s_m: 300, l1_m: 500}\nimu: {preset: paper}\n"
    )
    names = landing.prepare(*read(tmp_path / "landing.yaml")).shared.signals.names
    silent = [name for name in names if name not in ("G03", "G04", "PL1")]
    events = json.dumps([{"what": "silence", "sources": silent, "at_s": 50, "until_s": 80}])
    sizes, runs = [], 64
    for coupling in ("loose", "tight"):
        ready = landing.prepare(*read(tmp_path / "landing.yaml", (f"filter.coupling={coupling}", f"events={events}")))
        flown = list(ready.fly_runs(77, 0, runs, False))
        last = int(np.searchsorted(ready.shared.filter_time, 80.0 - 1e-6)) - 1
        errors = np.concatenate([one.error[:, last, :2] for one in flown])
        sizes.append(float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))))
        nees = np.concatenate([one.nees_position_velocity[:, last] for one in flown]).mean() / 6
        low, high = (chi_square.quantile(p, 6 * runs) / (6 * runs) for p in (5e-5, 1.0 - 5e-5))
        assert low < nees < high
    assert sizes[1] < 0.6 * sizes[0], sizes
