"""Two real flights against their references; writes docs/replay-measured.md. Needs ../shared/data; run by
`make validate`, some minutes. What is tuned is stored (`measured.kept`). With --bench all simulated flights are flown
again, some minutes more.
"""

from __future__ import annotations

import gzip
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import measured
import numpy as np
import replay_bench
from measured import row
from scipy.spatial.transform import Rotation

from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.logs.reading import read_logs
from navsim.logs.tables import log_files
from navsim.replays import study
from navsim.results.result import Result
from navsim.scenario.load import read_replay

DATA = measured.ROOT.parent / "shared" / "data"
UAV, CAR = DATA / "fw_thor75", DATA / "comma2k19_ex1"
SOURCES = [
    "",
    "| recording | source | reference |",
    "|---|---|---|",
    '| `fw_thor75` | flight 75 of the UAV "Thor" (Ultra Stick 25e class), UAV Lab of the University of Minnesota, '
    "2012-10-10, from the repository NorthStarUAS/insgnss_tools on GitHub (MIT licence); IMU 50 Hz, fixes 1 Hz | the "
    "onboard INS/GPS filter of 15 states, which uses the same sensors |",
    "| `comma2k19_ex1` | Example_1, segment 40, of commaai/comma2k19 on GitHub (MIT licence; arXiv 1812.05752); IMU "
    "104 Hz, u-blox fixes 10 Hz | pose of the camera by GNSS, inertial sensors and vision: about 1 m, 0.1 to 0.3 m "
    "within a drive. Its lever arm is unknown, so means are not compared |",
]
LOG = """kind: replay
version: 1
imu: {{file: {folder}/imu.csv.gz}}
gnss: {{file: {folder}/gnss.csv}}
start_s: 150
outages:
  - {{start_s: [250, 280, 310, 340, 370, 400, 430, 460, 490], duration_s: [10, 30]}}
"""
CIRCUITS = (230.0, 570.0)
SETTLED = 270.0
"""From then on heading is known again after the launch, s."""
ERROR = ("position_error_time", "position_error_horizontal", "position_error_vertical")
KEYS = (
    ("gnss.velocity_sigma_m_s", "velocity_sigma_horizontal", "velocity_sigma_vertical"),
    ("imu.gyro.arw_deg_sqrt_h", "gyro_noise_density"),
    ("imu.accelerometer.vrw_m_s_sqrt_h", "accelerometer_noise_density"),
    ("gnss.latency_s", "latency"),
    ("gnss.velocity_latency_s", "velocity_latency"),
)


def replayed(log: Path, *settings: str) -> Result:
    return study.compute(study.prepare(*read_replay(log, settings)))


def as_tuned(log: Path, name: str) -> tuple[str, ...]:
    """The settings that give what the tuning of a log finds."""

    def tune() -> dict[str, float]:
        found = replayed(log)
        keys = [key for _, *several in KEYS for key in several] + [key for key in ERROR if f"/tuning/{key}" in found]
        return {key: float(found[f"/tuning/{key}"]) for key in keys}

    found = measured.kept(("tuned", name, log.read_text() if name == "uav" else ""), tune)
    degrees = {"gyro_noise_density": np.degrees(1.0) * 60.0, "accelerometer_noise_density": 60.0}
    values = [[found[key] * degrees.get(key, 1.0) for key in keys] for _, *keys in KEYS]
    written = (value if len(value) > 1 else value[0] for value in values)
    settings = ["tuning=none", *(f"{key}={value}" for (key, *_), value in zip(KEYS, written, strict=True))]
    if ERROR[0] in found:
        time, horizontal, vertical = (found[key] for key in ERROR)
        settings += [f"gnss.errors=[{{correlation_time_s: {time}, position_sigma_m: [{horizontal}, {vertical}]}}]"]
    return tuple(settings)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.nanmean(np.asarray(values) ** 2, axis=0))


def listed(values: np.ndarray, digits: int) -> str:
    return " / ".join(f"{value:.{digits}f}" for value in values)


def uav(*settings: str) -> dict[str, list[float]]:
    """The small aircraft: innovations of its circuits, attitude against the onboard one, drifts, NIS, lost times."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.yaml"
        log.write_text(LOG.format(folder=UAV))
        found = replayed(log, *(settings or as_tuned(log, "uav")))
    with gzip.open(UAV / "onboard_nav.csv.gz", "rt") as file:
        onboard = np.genfromtxt(file, delimiter=",", names=True)
    time = found["/innovations/time"]
    circuits = (time > CIRCUITS[0]) & (time < CIRCUITS[1])
    apart = []
    for axis, (name, first) in enumerate((("roll_deg", 230.0), ("pitch_deg", 230.0), ("yaw_deg", SETTLED))):
        there = (onboard["t_s"] > first) & (onboard["t_s"] < CIRCUITS[1])
        ours = np.degrees(np.unwrap(found["/filter/attitude_rpy"][:, axis]))
        off = np.interp(onboard["t_s"][there], found["/filter/time"], ours) - onboard[name][there]
        off = (off + 180.0) % 360.0 - 180.0
        apart.append(float(rms(off - np.median(off))))
    return {
        "position": rms(found["/innovations/position_ned"][circuits]).tolist(),
        "velocity": rms(found["/innovations/velocity_ned"][circuits]).tolist(),
        "attitude": apart,
        "drift": [*found["/summary/drift_median"].tolist(), *found["/summary/drift_max"].tolist()],
        "nis": found["/summary/nis"][:2].tolist(),
        "nees": found["/summary/drift_nees"].tolist(),
        "latency": [float(found["/tuning/latency"])],
        "lost": [*found["/lost/start"].tolist(), *found["/lost/end"].tolist()],
    }


def uav_from_its_beginning() -> list[float]:
    """Drifts after 10 and 30 s, medians and largest, m, and their NEES, if the log is not cut at 150 s."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.yaml"
        log.write_text(LOG.format(folder=UAV))
        found = replayed(log, "start_s=null")
    return [x for name in ("median", "max", "nees") for x in found[f"/summary/drift_{name}"].tolist()]


def car(*settings: str) -> dict[str, list[float]]:
    """The car: standard deviations against its pose reference after ten seconds, and NIS in motion."""
    with tempfile.TemporaryDirectory() as folder:
        log_files(read_logs([CAR]), CAR.name).write(Path(folder))
        log = Path(folder) / "log.yaml"
        found = replayed(log, *(settings or as_tuned(log, "car")))
    clock, t = np.load(CAR / "global_pose_frame_times.npy"), found["/filter/time"]
    keep = (clock > t[0] + 10.0) & (clock < t[-1])
    names = ("positions", "velocities", "orientations")
    where, speed, turned = (np.load(CAR / f"global_pose_frame_{name}.npy")[keep] for name in names)

    def at(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(clock[keep], t, values[:, i]) for i in range(3)], axis=1)

    axes = ned_matrix(llh_from_ecef(where))
    position = np.einsum("nij,nj->ni", axes, at(ecef_from_llh(found["/filter/position_llh"])) - where).std(axis=0)
    velocity = (at(found["/filter/velocity_ned"]) - np.einsum("nij,nj->ni", axes, speed)).std(axis=0)
    body = axes @ Rotation.from_quat(turned[:, [1, 2, 3, 0]]).as_matrix()
    there = Rotation.from_matrix(body).as_euler("ZYX")[:, ::-1]
    turn = at(np.unwrap(found["/filter/attitude_rpy"], axis=0)) - there
    return {
        "position": position[:2].tolist(),
        "velocity": [float(np.sqrt(np.mean(velocity[:2] ** 2)))],
        "attitude": np.degrees((turn + np.pi) % (2.0 * np.pi) - np.pi).std(axis=0).tolist(),
        "nis": [float(found["/summary/nis"][1])],
    }


def wheels(*settings: str) -> list[list[float]]:
    """The car's drift after 15 s without fixes, median and largest, m, and its NEES; without and with `side_slip`."""
    out = []
    with tempfile.TemporaryDirectory() as folder:
        log_files(read_logs([CAR]), CAR.name).write(Path(folder))
        log = Path(folder) / "log.yaml"
        scenario, document = read_replay(log)
        begin, end = study.prepare(scenario, document).recorded
        outages = f"outages=[{{start_s: {np.arange(begin + 15.0, end - 17.0, 3.0).round(1).tolist()}, duration_s: 15}}]"
        for slip in ((), ("side_slip={}",)):
            found = replayed(log, *(settings or as_tuned(log, "car")), outages, *slip)
            out.append([float(found[f"/summary/drift_{name}"][0]) for name in ("median", "max", "nees")])
    return out


def probe() -> measured.Probe:
    """The car, untuned."""
    return car("tuning=none")


PAGE = measured.Page("replay-measured.md", "replays", (0,), probe)


def older_bench() -> list[str]:
    """The simulated flights of the page as it is, with the commit of their code."""
    body, _, foot = (measured.ROOT / "docs" / PAGE.name).read_text(encoding="utf-8").partition("\nMade by ")
    section = "".join(body.partition("\n## Simulated flights")[1:]).rstrip().split("\n")
    made = re.search(r"commit `\w+`", foot)
    told = "Simulated flights: code of"
    return section if made is None or section[-1].startswith(told) else [*section, "", f"{told} {made[0]}."]


def main() -> int:
    """Fly both and write the page."""
    if not DATA.is_dir():
        print(f"{DATA} is not there: docs/{PAGE.name} is left as it is", file=sys.stderr)
        return 0
    begun = measured.commit()
    small: Any = measured.kept(("uav",), uav)
    whole: Any = measured.kept(("uav from its beginning",), uav_from_its_beginning)
    motorway: Any = measured.kept(("car",), car)
    slip: Any = measured.kept(("wheels",), wheels)
    drifts = [listed(np.array(small["drift"])[[i, i + 2]], 1) for i in range(2)]
    half = len(small["lost"]) // 2
    lost = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in zip(small["lost"][:half], small["lost"][half:], strict=True))
    lines = [
        "# Recorded flights, measured",
        "",
        "Constants of the tuning were chosen on these two recordings ([method](replay-method.md#tuning)), so they "
        "don't test them. [How wrong σ can be](replay.md#are-the-sigmas-true).",
        "",
        "## A small fixed-wing UAV",
        "",
        "A flight of 2012 (`fw_thor75`, `start_s: 150`, outages at 250, 280, ... 490 s), replayed by navsim and by an "
        "untuned loosely coupled filter of 15 states:",
        "",
        "| | navsim | untuned filter |",
        "|---|---|---|",
        row("innovations of position N / E / D, 230-570 s, m", listed(small["position"], 2), "1.4 / 0.8 / 1.4"),
        row("innovations of velocity N / E / D, m/s", listed(small["velocity"], 2), "0.56 / 0.53 / 0.31"),
        row(f"attitude minus the onboard system's, RMS about the median, yaw from {SETTLED:g} s on",
            f"{listed(small['attitude'], 1)}°", "1.3 / 0.7 / 1.0°"),
        row("drift without fixes, 10 s, median / largest, m", drifts[0], "9.9 / 38"),
        row("drift without fixes, 30 s, median / largest, m", drifts[1], "108 / 264"),
        row("NIS per degree of freedom, all / moving", listed(small["nis"], 2), ""),
        row("drift NEES, 10 s / 30 s", listed(small["nees"], 2), ""),
        "",
        f"- Tuned latency: {small['latency'][0]:.3f} s.",
        "- From the beginning of the log the tuning finds a likelier maximum, with larger drifts: "
        f"{listed(np.array(whole)[[0, 2]], 1)} m after 10 s, {listed(np.array(whole)[[1, 3]], 1)} m after 30 s.",
        "- In the first 20 s after launch the receiver has 0 to 4 satellites, and navsim aligns the lost filter again: "
        f"{lost}.",
        "",
        "## A car",
        "",
        "A drive (`comma2k19_ex1`), imported without vertical velocity. Standard deviation of the difference from the "
        "reference, after 10 s:",
        "",
        "| | navsim | untuned filter |",
        "|---|---|---|",
        row("position N / E, m", listed(motorway["position"], 2), "0.20 / 0.11"),
        row("velocity, horizontal, m/s", listed(motorway["velocity"], 2), "0.04"),
        row("roll / pitch / yaw", f"{listed(motorway['attitude'], 2)}°", "0.13 / 0.19 / 1.0°"),
        row("NIS per degree of freedom, moving", listed(motorway["nis"], 2), ""),
        *(row(f"drift without fixes, 15 s, median / largest, m; NEES{how}", f"{listed(each[:2], 1)}; {each[2]:.2f}", "")
          for how, each in zip(("", ", with `side_slip: {}`"), slip, strict=True)),
    ]  # fmt: skip
    lines += SOURCES
    lines += replay_bench.unclaimed()
    lines += replay_bench.section() if "--bench" in sys.argv else older_bench()
    PAGE.write(lines, begun)
    return 0


if __name__ == "__main__":
    sys.exit(main())
