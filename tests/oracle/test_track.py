"""Trajectories of tables: the curve against what the table was made of, the sensors against the mechanisation."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.landing import study as landing
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.trajectory.kinematics import Trajectory, Wind, tangent_frame
from navsim.trajectory.recorded import largest, smoothed_path
from tests.conftest import Within
from tests.helpers import case, scenario
from tests.layout import as_declared
from tests.oracle.test_strapdown import mechanised

FLIGHT = Path("/work/shared/data/fw_thor75/gnss.csv")


def table(folder: Path, rows: dict[str, np.ndarray], name: str = "track.csv") -> str:
    """A table of these columns."""
    path = folder / name
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(rows)
        writer.writerows(zip(*(column.tolist() for column in rows.values()), strict=True))
    return str(path)


def circuit(step: float = 1.0, sigma: float = 0.0, seed: int = 1) -> tuple[Any, dict[str, np.ndarray]]:
    """The circuit's motion, and a table of its places and attitudes."""
    moving = scenario(name="circuit").trajectory()
    time = np.arange(60.0, 210.01, step)
    motion = moving.motion(time)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (time.size, 3)) * sigma
    llh = llh_from_ecef(motion.position_ecef + np.einsum("nji,nj->ni", ned_matrix(motion.llh), noise))
    degrees = np.degrees(np.column_stack([llh[:, :2], motion.rpy]))
    names = ("lat_deg", "lon_deg", "roll_deg", "pitch_deg", "yaw_deg")
    return moving, {"t_s": time, "h_m": llh[:, 2], **dict(zip(names, degrees.T, strict=True))}


def flown(file: str, *settings: str) -> Any:
    return case(f"approach.file={file}", *settings, name="track")


@pytest.mark.parametrize("attitudes", [False, True])
@pytest.mark.parametrize("wind", [0.0, 5.0])
def test_it_comes_back(tmp_path: Path, attitudes: bool, wind: float) -> None:
    _, rows = circuit(sigma=0.3)
    if not attitudes:
        rows = {name: rows[name] for name in ("t_s", "lat_deg", "lon_deg", "h_m")}
    elif wind:
        with pytest.raises(InputError, match="with its attitudes has had its wind"):
            flown(table(tmp_path, rows), f"wind.speed_m_s={wind}")
        return
    trajectory = flown(table(tmp_path, rows), f"wind.speed_m_s={wind}").trajectory
    place, attitude = mechanised(trajectory, 100.0, 145.0)
    assert np.linalg.norm(place) < 1e-2
    assert np.linalg.norm(attitude) < 1e-5


def test_a_dense_exact_table_is_flown_as_it_was_made(tmp_path: Path) -> None:
    """Places and attitudes of the circuit, four a second: within its sigma, and the attitudes with it."""
    moving, rows = circuit(step=0.25)
    t = np.linspace(0.5, 144.0, 400)
    exact = moving.motion(t + 62.0)
    for names in (tuple(rows), ("t_s", "lat_deg", "lon_deg", "h_m")):
        found = flown(table(tmp_path, {name: rows[name] for name in names}), "approach.sigma_m=0.003")
        again = found.trajectory.motion(t)
        assert np.abs(again.position_ecef - exact.position_ecef).max() < 0.03
        off = again.velocity_ned - exact.velocity_ned
        assert np.sqrt(np.mean(off**2)) < 0.02
        assert np.abs(off).max() < 0.3  # where the gear takes up the sink rate within a second
        turned = np.degrees(np.abs(again.rpy - exact.rpy)).max()
        assert turned < (0.5 if "roll_deg" in names else 3.0)
        assert found.trajectory.path.rms_residual == pytest.approx(0.003 * math.sqrt(3.0), rel=0.05)


def test_sigmas_are_kept_by_axis() -> None:
    """Mean square distance in sigmas: 1 an axis, upwards by its own; and four derivatives without a jump."""
    _, rows = circuit(sigma=0.3)
    llh = np.column_stack([np.radians(rows["lat_deg"]), np.radians(rows["lon_deg"]), rows["h_m"]])
    frame = tangent_frame(llh[-1], 0.0)
    path = smoothed_path(rows["t_s"], llh, (0.3, 0.6), frame, {})
    off = path.jet(rows["t_s"])[:, 0] - (ecef_from_llh(llh) - frame.origin) @ frame.axes
    assert np.mean((off / [0.3, 0.3, 0.6]) ** 2) == pytest.approx(1.0, abs=0.01)
    assert path.rms_residual == pytest.approx(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
    for order in range(5):
        scale = np.abs(path.spline(rows["t_s"], order)).max()
        for knot in path.knots[1:-1]:
            jump = path.spline(knot + 1e-7, order) - path.spline(knot - 1e-7, order)
            assert np.abs(jump).max() < 1e-5 * scale + 1e-6 * scale


def test_results_tell_of_it() -> None:
    ready = case(name="track")
    result = landing.result(ready, landing.fly_all(ready, 1, 0, 1, threads(1)), 1, keep="errors")
    as_declared(result)
    most = largest(ready.trajectory, 145.0)
    assert 9.0 < most.force < 13.0
    assert result["/summary/track/specific_force"] == most.force
    assert result["/summary/track/rate"] == most.rate
    assert result["/summary/track/rms_smoothed"] == pytest.approx(0.3 * math.sqrt(3.0), rel=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"h_m": (70, 900.0)}, "g .* s after the start, 20 are allowed"),
        ({"t_s": (70, 129.0)}, "each time once"),
        ({"lat_deg": (70, 91.0)}, "lat_deg"),
    ],
)
def test_what_no_aircraft_flies(tmp_path: Path, change: dict[str, tuple[int, float]], words: str) -> None:
    _, rows = circuit()
    rows = {name: rows[name].copy() for name in ("t_s", "lat_deg", "lon_deg", "h_m")}
    for name, (row, value) in change.items():
        rows[name][row] = value
    with pytest.raises(InputError, match=words):
        flown(table(tmp_path, rows), "approach.sigma_m=0.1")


def test_too_fast_a_turn(tmp_path: Path) -> None:
    """An attitude that swings by 175 deg to and fro, each within a quarter of a second."""
    _, rows = circuit(step=0.25)
    rows["roll_deg"][200::2] += 175.0
    with pytest.raises(InputError, match=r"turns at \d+ deg/s .* 1000 are allowed"):
        flown(table(tmp_path, rows))


def test_other_tables(tmp_path: Path) -> None:
    _, rows = circuit()
    with pytest.raises(InputError, match="lacks pitch_deg, yaw_deg"):
        flown(table(tmp_path, {name: rows[name] for name in ("t_s", "lat_deg", "lon_deg", "h_m", "roll_deg")}))
    with pytest.raises(InputError, match="the recording ends"):
        flown(table(tmp_path, rows), "duration_s=200")
    few = {name: rows[name][:6] for name in ("t_s", "lat_deg", "lon_deg", "h_m")}
    with pytest.raises(InputError, match="too few for a curve"):
        flown(table(tmp_path, few), "duration_s=2")
    still = {name: rows[name][:60] for name in ("t_s", "lat_deg", "lon_deg", "h_m")}
    still |= {name: np.full(60, rows[name][0]) for name in ("lat_deg", "lon_deg", "h_m")}
    with pytest.raises(InputError, match="attitudes are needed: columns roll_deg, pitch_deg, yaw_deg"):
        flown(table(tmp_path, still), "duration_s=40")


def test_heights_above_the_geoid(tmp_path: Path) -> None:
    _, rows = circuit()
    rows = {name: rows[name] for name in ("t_s", "lat_deg", "lon_deg", "h_m")}
    plain = flown(table(tmp_path, rows)).trajectory.motion(np.array([50.0])).llh[0, 2]
    low = rows | {"h_m": rows["h_m"] - 15.5}
    settings = ("runway.height_above=geoid", "runway.geoid_undulation_m=15.5", "runway.height_m=104.5")
    sea = flown(table(tmp_path, low, "low.csv"), *settings).trajectory.motion(np.array([50.0])).llh[0, 2]
    assert sea == pytest.approx(plain, abs=1e-6)


@pytest.mark.validates("Velocities of a smoothed recorded flight",
                       "velocities in the recording of the fixed-wing flight Thor 75", velocity="2.1 m/s rms an axis",
                       position="1e-2 m")  # fmt: skip
def test_a_real_flight(within: Within) -> None:
    """310 s of a small aircraft's fixes, one a second: so far apart that the curve rounds its turns off."""
    if not FLIGHT.exists():
        pytest.skip(f"{FLIGHT} is not there")
    rows = np.genfromtxt(FLIGHT, delimiter=",", skip_header=1)
    rows = rows[(rows[:, 0] > 225.0) & (rows[:, 0] < 535.0)]
    llh = np.column_stack([np.radians(rows[:, 2:4]), rows[:, 4]])
    time, frame = rows[:, 0] - rows[0, 0], tangent_frame(llh[-1], 0.0)
    path = smoothed_path(time, llh, (1.5, 1.5), frame, {})
    assert path.rms_residual == pytest.approx(1.5 * math.sqrt(3.0), rel=0.01)
    velocity = np.einsum("nij,nj->ni", ned_matrix(llh), path.jet(time)[:, 1] @ frame.axes.T)
    off = np.sqrt(np.mean((velocity - rows[:, 5:8]) ** 2, axis=0))
    assert (off < within["velocity"]).all()
    trajectory = Trajectory(path, frame, Wind(np.zeros(3)), 0.05)
    most = largest(trajectory, 300.0)
    assert most.force < 2.0 * 9.80665
    assert np.degrees(most.rate) < 60.0
    place, _ = mechanised(trajectory, 100.0, 300.0)
    assert np.linalg.norm(place) < within["position"]


def test_a_runway_that_is_another_one(tmp_path: Path) -> None:
    """The place and the course of a track at its touchdown are compared with the runway's."""
    moving, rows = circuit()
    file, at = table(tmp_path, rows), f"approach.touchdown_s={moving.path.events['touchdown']}"
    heading = scenario(name="circuit").runway.heading_deg

    def told(*settings: str) -> list[str]:
        return [text for text in flown(file, at, *settings).warnings if "touchdown_s" in text]

    assert not told(f"runway.heading_deg={heading + 15.0}")
    for turned in (30.0, 180.0, 300.0):
        (text,) = told(f"runway.heading_deg={(heading + turned) % 360.0}")
        assert f"flying towards {heading:.0f} deg, runway.heading_deg is {(heading + turned) % 360.0:g}, then" in text
    (text,) = told("runway.threshold={lat_deg: 50.0, lon_deg: 37.01}")
    assert "669 km from the runway's touchdown point (runway.threshold) then" in text


def test_a_touchdown_in_the_air(tmp_path: Path) -> None:
    """What a track calls its touchdown is warned of where it is none; heights that it has not come down to are not
    passed; before the flight there is none."""
    moving, rows = circuit()
    file = table(tmp_path, rows)
    down = moving.path.events["touchdown"]
    early = flown(file, f"approach.touchdown_s={down - 8.0}")
    (warned,) = (text for text in early.warnings if "touchdown_s" in text)
    when = early.trajectory.path.events["touchdown"]
    high = -float(early.trajectory.path.jet(np.array([when]))[0, 0, 2])
    assert f"is {high:.1f} m above" in warned
    passed = early.preflight.times_at_heights([0.0, 0.5 * high, high + 5.0])
    assert passed[0] == when
    assert np.isnan(passed[1])
    assert passed[2] < passed[0]
    assert not [text for text in flown(file, f"approach.touchdown_s={down}").warnings if "touchdown_s" in text]
    with pytest.raises(InputError, match="no later than the flight begins"):
        flown(file, "approach.touchdown_s=50")
