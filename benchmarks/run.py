"""Speed of navsim and of its rivals, as ratios within one run; writes RESULTS.md beside this file.

Run by `make bench`. Times are medians with their range; absolute figures hold on this machine only, the
ratios travel. Whole commands are timed as processes, kernels in this process after compilation.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SCENARIO = ROOT / "scenarios" / "landing.yaml"
STEPS = 12_000
RIVAL_SECONDS = 12.0
"""Length of flight given to the slowest rival, s; its time per step does not depend on it."""


def timed(job: Callable[[], Any], repeat: int) -> list[float]:
    """Seconds of each of `repeat` calls."""
    out = []
    for _ in range(repeat):
        start = time.perf_counter()
        job()
        out.append(time.perf_counter() - start)
    return out


def shown(seconds: list[float], unit: str, scale: float) -> str:
    """Median and range in a unit."""
    low, mid, high = min(seconds) * scale, statistics.median(seconds) * scale, max(seconds) * scale
    return f"{mid:.3g} {unit} ({low:.3g} to {high:.3g})"


def command(*arguments: str, environment: dict[str, str] | None = None) -> Callable[[], None]:
    """A navsim command line as a job."""

    def job() -> None:
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(
                [sys.executable, "-m", "navsim", *arguments],
                cwd=folder,
                check=True,
                capture_output=True,
                env=environment,
            )

    return job


def whole_processes(rows: list[tuple[str, str, str, bool]]) -> None:
    from navsim.scenario.load import read
    from navsim.study.budget.estimate import SPREAD
    from navsim.study.budget.landing import landing
    from navsim.study.budget.studies import tables
    from navsim.study.executor import threads
    from navsim.study.landing import prepare

    scenario = str(SCENARIO)
    flown = ["run", scenario, "--figures", "none"]
    command(*flown)()
    case, cores = prepare(*read(SCENARIO)), threads().workers
    told = {
        "1000 landings, statistics, file": landing(case.scenario, case.environment, 1000, "errors", cores).time_s,
        "`navsim table2`, 400 runs a row": tables(400, cores).time_s,
    }
    for name, arguments, must, repeat in (
        ("`navsim --help`", ["--help"], 0.3, 9),
        ("`navsim validate`", ["validate", scenario], 0.4, 9),
        ("one landing, with file, without figures", flown, 1.5, 7),
        ("one landing with its figures", ["run", scenario], 4.0, 5),
        ("1000 landings, statistics, file", [*flown, "--runs", "1000"], 12.0, 3),
        ("`navsim table2`, 400 runs a row", ["table2", "-o", "."], 60.0, 1),
    ):
        seconds = timed(command(*arguments), repeat)  # type: ignore[arg-type]
        rows.append((name, shown(seconds, "s", 1.0), f"{must} s", statistics.median(seconds) <= must))
        if name in told:
            factor = told[name] / statistics.median(seconds)
            held = 1.0 / SPREAD <= factor <= SPREAD
            rows.append((f"the estimate of its time: {name}", f"{factor:.2f}×", f"within {SPREAD}×", held))
    one = timed(command(*flown, "--runs", "1000", "--workers", "1"), 3)
    two = timed(command(*flown, "--runs", "1000", "--workers", "2"), 3)
    ratio = statistics.median(one) / statistics.median(two)
    rows.append(("1000 landings, 1 against 2 workers, whole processes", f"{ratio:.2f}×", "", True))
    rows += workers()
    with tempfile.TemporaryDirectory() as cache:
        cold = timed(command("run", scenario, environment={**os.environ, "NUMBA_CACHE_DIR": cache}), 1)
    rows.append(("first run ever, with figures (compiling)", shown(cold, "s", 1.0), "30 s", cold[0] <= 30.0))


def workers() -> list[tuple[str, str, str, bool]]:
    """The engine alone, batches kept on disk as they are finished, as in the process; and what it costs to tell by
    their checksums whose and how whole they are, all read once more."""
    from navsim.scenario.load import read
    from navsim.study.executor import threads
    from navsim.study.landing import fly_all, prepare
    from navsim.study.partial import Store

    case = prepare(*read(SCENARIO))

    def job(count: int, folder: Path) -> Callable[[], object]:
        return lambda: fly_all(case, 1, 0, 1000, threads(count), keep="errors", store=Store(folder, {}, True))

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "partial"
        job(2, folder)()
        one, two = (timed(job(count, folder), 3) for count in (1, 2))
        pieces = sorted(file.stem for file in folder.glob("*.npz"))

        def tell() -> None:
            store = Store(folder, {}, False)
            if any(store.read(name, lambda _: False) is None for name in pieces):
                raise RuntimeError("a batch just written does not count")

        share = statistics.median(timed(tell, 5)) / statistics.median(one)
    ratio = statistics.median(one) / statistics.median(two)
    return [
        ("1000 landings flown and kept, 1 to 2 workers", f"{ratio:.2f}×", "1.8×", ratio >= 1.8),
        (f"checksums of their {len(pieces)} batches, part of the time", f"{share:.2%}", "1 %", share <= 0.01),
    ]


def kernels(rows: list[tuple[str, str, str, bool]]) -> None:
    from dense import dense_filter

    from navsim.core import states, strapdown
    from navsim.core.lanes import WIDTH
    from navsim.estimation.estimate import fly, in_all_lanes
    from navsim.estimation.observations import FIX, Measurements
    from navsim.estimation.records import ESKF, TFG, ImuData, start
    from navsim.scenario.load import read
    from navsim.simulation.landing import exact_start, table_of_fixes
    from navsim.study.landing import prepare

    case = prepare(*read(SCENARIO, ["receiver.rate_hz=1"]))
    world, flight = case.world, case.flight
    dt = world.imu_time[1]
    begin = exact_start(world.at_filter)
    run = case.fly(1, 0)
    e = run.fix_llh.shape[0]
    cov = np.tile(np.diag([16.0, 16.0, 200.0, 0.04, 0.04, 0.04]), (e, 1, 1))
    table = table_of_fixes(case.beliefs, run.fix_llh, run.fix_velocity, cov)
    measurements = Measurements.of({FIX: table}).each(in_all_lanes)
    declared = flight.model.declared
    imu = ImuData(world.imu_time, in_all_lanes(world.dtheta), in_all_lanes(world.dv))

    def navsim_filter(kind: int = ESKF) -> None:
        """As many runs at once as there are lanes."""
        model = flight.model._replace(kind=kind, gate=np.full(7, np.inf), max_rejected=0)
        state = start(in_all_lanes(begin), in_all_lanes(flight.covariance))
        for _ in fly(imu, measurements, flight.events, state, model):
            pass

    ends = np.empty((2, states.NAV_N))

    def navsim_strapdown() -> None:
        strapdown.navigate(begin.copy(), declared, world.dtheta, world.dv, dt, STEPS, ends)

    def dense() -> None:
        dense_filter(begin.copy(), declared, world.dtheta, world.dv, dt, np.eye(15), np.eye(15) * 1e-9, 100)

    def navsim_tfg() -> None:
        navsim_filter(TFG)

    for job in (navsim_filter, navsim_tfg, navsim_strapdown, dense):
        job()
    ours = [seconds / WIDTH for seconds in timed(navsim_filter, 15)]
    group = [seconds / WIDTH for seconds in timed(navsim_tfg, 15)]
    alone = timed(navsim_strapdown, 15)
    thick = timed(dense, 5)
    per = 1e9 / STEPS
    ours_mid, alone_mid = statistics.median(ours), statistics.median(alone)
    ratio = statistics.median(thick) / ours_mid
    rows.append(
        (
            f"filter (`eskf`), covariance every step, 1 Hz fixes, a run of {WIDTH} at once",
            shown(ours, "ns/step", per),
            "",
            True,
        )
    )
    times = statistics.median(group) / ours_mid
    rows.append(("`tfg` against `eskf`", f"{times:.2f}×", "at most 1.4×", times <= 1.4))
    rows.append(("strapdown alone", shown(alone, "ns/step", per), "", True))
    rows.append(("dense 15×15 kernel of the same filter", shown(thick, "ns/step", per), "", True))
    rows.append(("filter against the dense kernel", f"{ratio:.1f}×", "5×", ratio >= 5))
    rivals(rows, world, ours_mid / STEPS, alone_mid / STEPS)


def placements(rows: list[tuple[str, str, str, bool]]) -> None:
    """DOPs of 200 x 200 placements of two pseudolites at 121 epochs, 12 sources: 4.84 million solutions."""
    from navsim.scenario.load import read
    from navsim.simulation.geometry import glide_geometry
    from navsim.study.landing.case import environment
    from navsim.study.placement import RunwayPlane

    scenario, document = read(SCENARIO, ["pseudolites.frame=runway", "pseudolites.count=0", "sky.mask_deg=0"])
    sources, scenario, _ = environment(scenario, document)
    trajectory = scenario.trajectory()
    epochs = np.linspace(0.0, 60.0, 121)
    here = glide_geometry(trajectory, sources, np.array([scenario.epoch.timestamp()]), epochs, np.ones(121, dtype=bool))
    plane = RunwayPlane(scenario.threshold(trajectory.frame), 0.0, 0.0)
    s, l1 = np.meshgrid(np.linspace(50.0, 2000.0, 200), np.linspace(0.0, 5000.0, 200), indexing="ij")
    pairs = np.stack([np.stack([s, l1], axis=-1), np.stack([-s, l1], axis=-1)], axis=-2).reshape(-1, 2, 2)
    sites = plane.ecef(pairs)
    rng = np.random.default_rng(1)
    sky = rng.standard_normal((121, 10, 3))
    sky /= np.linalg.norm(sky, axis=2)[:, :, None]
    here.dops(sites[:1000])
    one = timed(lambda: here.dops(sites), 7)
    both = timed(lambda: here.dops(sites, 2), 7)
    part = sites[:: len(sites) // 400][:400]
    lines = part[:, None] - here.receiver[None, :, None]
    lines /= np.linalg.norm(lines, axis=3)[..., None]
    units = np.concatenate([np.broadcast_to(sky, (len(part), *sky.shape)), lines], axis=2)

    def dense() -> None:
        h = np.concatenate([-units, np.ones((*units.shape[:3], 1))], axis=3)
        q = np.linalg.inv(np.swapaxes(h, 2, 3) @ h)
        np.sqrt(np.trace(q[..., :3, :3], axis1=2, axis2=3))
        np.sqrt(q[..., 2, 2])

    theirs = statistics.median(timed(dense, 5)) / len(part)
    count = len(sites)
    solutions = 1e-6 * 121 * count
    rows.append(("4.84 million DOP solutions, one thread", shown(one, "s", 1.0), "", True))
    rows.append(("the same with numpy (H, H'H, inverse)", f"{theirs * count:.1f} s", "", True))
    rate = solutions / statistics.median(both)
    ratio = theirs * count / statistics.median(both)
    rows.append((f"against numpy, both cores ({rate:.0f} million/s)", f"{ratio:.0f}×", "50×", ratio >= 50))
    ratio = theirs * count / statistics.median(one)
    rows.append(("against numpy, one thread", f"{ratio:.0f}×", "25×", ratio >= 25))


def analysis(rows: list[tuple[str, str, str, bool]]) -> None:
    """Linear covariance analysis against 2000 runs of the same landing."""
    from navsim.scenario.load import read
    from navsim.study.executor import threads
    from navsim.study.landing import covariance_analysis, fly_all, prepare

    case = prepare(*read(SCENARIO, ["receiver.rate_hz=1"]))
    covariance_analysis(case)
    linear = timed(lambda: covariance_analysis(case), 5)
    runs = timed(lambda: fly_all(case, 1, 0, 2000, threads(), keep="none"), 1)
    rows.append(("covariance analysis with budget, 1 Hz fixes", shown(linear, "s", 1.0), "", True))
    rows.append(("2000 runs against it", f"{runs[0] / statistics.median(linear):.0f}×", "", True))


def tracking(rows: list[tuple[str, str, str, bool]]) -> None:
    """The 13-state tracking filter against its six decoupled groups, per scan."""
    from navsim.scenario.tracking.atc import Atc
    from navsim.study.tracking.atc import settings, truth
    from navsim.tracking.atc import ADAPT, FULL, MEASURED, N, track
    from navsim.tracking.circuit import at, fly

    scenario = Atc(kind="atc-tracking", version=1)
    case = settings(scenario, 1.0, False)
    time_ = np.arange(407.0)
    states = truth(at(fly(scenario.circuit.circuit()), time_))
    noise = np.random.default_rng(1).standard_normal((time_.size, MEASURED)) * np.sqrt(case.variance)
    measured = states[:, [0, 3, 5, 7, 9, 11, 4, 6, 8]] + noise
    error, deviation = np.empty((time_.size, N)), np.empty((time_.size, N))

    def job(kind: int) -> Callable[[], None]:
        return lambda: track(
            kind, 1.0, measured, case.variance, False, case.decay, case.rate_variance, 0.3, np.array([5.0, 2.0]),
            states, error, deviation,
        )  # fmt: skip

    seconds = {}
    for kind in (FULL, ADAPT):
        job(kind)()
        seconds[kind] = timed(job(kind), 15)
    full, groups = statistics.median(seconds[FULL]), statistics.median(seconds[ADAPT])
    rows.append(("ATC filter, 13 states", shown(seconds[FULL], "ns/scan", 1e9 / time_.size), "", True))
    rows.append(("its six decoupled groups", shown(seconds[ADAPT], "ns/scan", 1e9 / time_.size), "", True))
    rows.append(("full against decoupled (31 by count)", f"{full / groups:.1f}×", "", True))


def rivals(rows: list[tuple[str, str, str, bool]], world: Any, filter_step: float, strapdown_step: float) -> None:
    """pyins on the same increments, in the same run."""
    try:
        import pandas as pd
        from pyins import filters, inertial_sensor, measurements, strapdown, transform
    except ImportError:
        rows.append(("pyins", "not installed", "", True))
        return
    del transform
    dt = float(world.imu_time[1])
    increments = pd.DataFrame(
        np.concatenate([np.full((STEPS, 1), dt), world.dtheta, world.dv], axis=1),
        index=pd.Index(world.imu_time[1:], name="time"),
        columns=["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"],
    )
    truth = world.truth
    columns = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    values = np.concatenate(
        [np.degrees(truth.llh[:, :2]), truth.llh[:, 2:], truth.velocity_ned, np.degrees(truth.rpy)], axis=1
    )
    trajectory = pd.DataFrame(values, index=pd.Index(world.imu_time, name="time"), columns=columns)

    def free() -> None:
        strapdown.Integrator(trajectory.iloc[0]).integrate(increments)

    free()
    seconds = timed(free, 5)
    theirs = statistics.median(seconds) / STEPS
    rows.append(("pyins strapdown alone", shown(seconds, "µs/step", 1e6 / STEPS), "", True))
    rows.append(
        ("strapdown alone against pyins", f"{theirs / strapdown_step:.1f}×", "5×", theirs / strapdown_step >= 5)
    )

    gyro = inertial_sensor.EstimationModel(bias_sd=1e-3, noise=1e-5)
    accel = inertial_sensor.EstimationModel(bias_sd=1e-2, noise=1e-2)
    n = int(RIVAL_SECONDS / dt)
    part = increments.iloc[:n]
    at = trajectory.iloc[100 : n + 1 : 100]
    sources = [
        measurements.Position(at[["lat", "lon", "alt"]], 4.0),
        measurements.NedVelocity(at[["VN", "VE", "VD"]], 0.2),
    ]
    for label, step, must in (("every step", dt, 5000), ("every 0.1 s, its default", 0.1, 500), ("every 1 s", 1.0, 0)):

        def feedback(step: float = step) -> None:
            filters.run_feedback_filter(
                trajectory.iloc[0], 10.0, 1.0, 5.0, 5.0, part, gyro, accel, measurements=sources, time_step=step
            )

        seconds = timed(feedback, 3)
        theirs = statistics.median(seconds) / n
        ratio = theirs / filter_step
        rows.append((f"pyins filter, covariance {label}", shown(seconds, "µs/step", 1e6 / n), "", True))
        rows.append((f"filter against it ({label})", f"{ratio:.0f}×", f"{must}×" if must else "", ratio >= must))


def main() -> int:
    """Measure, write RESULTS.md, return 1 where a target is missed."""
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    rows: list[tuple[str, str, str, bool]] = []
    whole_processes(rows)
    kernels(rows)
    placements(rows)
    analysis(rows)
    tracking(rows)
    cpu = next(
        (line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.processor(),
    )
    lines = [
        "# Speed, measured",
        "",
        f"{datetime.now(UTC):%Y-%m-%d}, {cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"numpy {np.__version__}. Made by `make bench`.",
        "",
        "Median (range). Reference job: 120 s landing, 100 Hz, 12 000 steps.",
        "",
        "| what | measured | must | |",
        "|---|---|---|---|",
        *(f"| {w} | {m} | {t} | {'' if not t else 'holds' if ok else '**misses**'} |" for w, m, t, ok in rows),
        "",
    ]
    (Path(__file__).resolve().parent / "RESULTS.md").write_text("\n".join(lines))
    print("\n".join(lines))
    return 0 if all(ok for *_, ok in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
