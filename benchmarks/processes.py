"""Whole processes: against the version before, against their own imports, by workers, by memory."""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from measure import SCENARIO, Job, Line, Plan, alternate, ratios, seconds, timed
from versions import Clock, Version, before, environment, now, spend

FLOWN = ("--figures", "none")
BRIEF = ("--set", "filter.kind=eskf", "--set", "duration_s=12")
"""A short flight for the memory of many runs: what is kept of a run does not grow with its length."""

EVERYTHING = (
    "wind={speed_m_s: 6, from_deg: 70, profile: log, turbulence: {}, "
    "gusts: [{amplitude_m_s: 3, towards: north, start_s: 30, ramp_s: 2}]}",
    "approach.flight_technical_error={lateral: {sigma_m: 3}, vertical: {sigma_m: 1}}",
    "runway={heading_deg: 0, height_m: 0, slope_percent: 0.5, geoid_undulation_m: 40}",
    "imu={preset: adis16470, gyro: {drift_deg_h: 720, misalignment_mrad: 1, g_sensitivity_deg_h_g: 5}, "
    "accelerometer: {bias_mg: 4, misalignment_mrad: 1}}",
    "signals.preset=open-sky", "pseudolites.range_law=cn0", "pseudolites.eirp_dbm=-10",
    "terrain=[{azimuth_deg: [20, 60], elevation_deg: 12, distance_m: 3000}]",
    "radio_altimeter={sigma_floor_m: 0.5, sigma_share: 0.02, highest_m: 100}",
    "barometric_altimeter={sigma_m: 1, lag_s: 0.3, drift_m: 2, drift_time_s: 600, qnh_sigma_hpa: 0.3}",
    "box={error: total, lateral_m: 10, vertical_m: 5}",
    "filter={fix_errors: states, scale_factors: true, misalignments: false, barometric_altimeter: {errors: states}}",
)  # fmt: skip
"""What a landing has when all of the world is on: its air, ways, sensors, ranges, terrain and altimeters, and states
for what a filter can follow of them but for misalignments."""
MISALIGNED = "filter.misalignments=true"


def runs(version: Version, count: int, *arguments: str) -> Job:
    """So many landings, their statistics and file."""
    return version.command("run", version.landing, *FLOWN, "--runs", str(count), *arguments)


def _landings(
    plan: Plan, old: Version, which: str, what: str, arguments: tuple[str, ...], must: float, aim: float | None
) -> Line:
    """Landings by this version against those of another, each with the main scenario of its own."""
    count, versions = plan.size(1000, 50), (old, now())
    alternate(1, *(runs(version, 8, *arguments) for version in versions))
    theirs, ours = alternate(plan.rounds(5), *(runs(version, count, *arguments) for version in versions))
    beside = f"{seconds(which, theirs)}, {seconds('now', ours)}"
    return Line(f"{count} landings, {what}, against the {which} version", ratios(theirs, ours), beside, must, aim)


def against_original(plan: Plan) -> list[Line]:
    """Landings by default against the first version: a default that gets slower step by step shows."""
    old = before(plan.original)
    if old is None:
        return [Line(f"against the first version, {plan.original}", (), "git has no such commit here")]
    return [_landings(plan, old, "first", "by default", (), 1.0, None)]


def against_before(plan: Plan) -> list[Line]:
    """The same work by this version and by the one before."""
    old, new = before(plan.before), now()
    if old is None:
        return [Line(f"against the version before, {plan.before}", (), "git has no such commit here")]
    lines = [
        _landings(plan, old, "previous", "`eskf`", ("--set", "filter.kind=eskf"), 3.5, 6.0),
        _landings(plan, old, "previous", "by default", (), 1.0, 2.0),
    ]
    for rate, must, aim in ((1, 3.0, 6.0), (10, None, None))[: plan.size(2, 1)]:
        settings = (str(SCENARIO), f"receiver.rate_hz={rate}", "filter.kind=tfg")
        clocks = [Clock(version, "analysis_clock.py", *settings) for version in (old, new)]
        theirs, ours = alternate(plan.rounds(9), *clocks)
        for clock in clocks:
            clock.close()
        beside = f"{seconds('before', theirs)}, {seconds('now', ours)}"
        what = f"covariance analysis with budget, {rate} Hz fixes, against the version before"
        lines.append(Line(what, ratios(theirs, ours), beside, must, aim))
    return lines


def world(plan: Plan) -> list[Line]:
    """Landings with all of the world on against as many by default."""
    count, none = plan.size(1000, 16), runs(now(), plan.size(1000, 16))
    lines = []
    for what, settings, must in (
        ("everything on, without states for misalignments", EVERYTHING, 3.0),
        ("everything on, states for misalignments too", (*EVERYTHING, MISALIGNED), None),
    ):
        every = runs(now(), count, *(word for one in settings for word in ("--set", one)))
        alternate(1, every, none)
        ours, theirs = alternate(plan.rounds(3), every, none)
        beside = f"{seconds('it', ours)}, {seconds('default', theirs)}"
        lines.append(Line(f"{count} landings, {what}, against the default", ratios(ours, theirs), beside, must,
                          at_most=True))  # fmt: skip
    return lines


def closed_loop(plan: Plan) -> list[Line]:
    """Landings that the filter's estimate steers against as many that fly the route."""
    count = plan.size(1000, 16)
    jobs = [runs(now(), count, "--set", f"approach.guidance={guidance}") for guidance in ("estimate", "reference")]
    alternate(1, *jobs)
    closed, opened = alternate(plan.rounds(3), *jobs)
    beside = f"{seconds('closed', closed)}, {seconds('open', opened)}"
    what = f"{count} landings steered by their estimates, against as many along the route"
    return [Line(what, ratios(closed, opened), beside, 3.0, at_most=True)]


def python(code: str) -> Job:
    """A Python that does this and nothing else."""
    return lambda: spend([sys.executable, "-c", code], environment())


def start(plan: Plan) -> list[Line]:
    """Short commands against the imports they cannot do without."""
    return _against_imports(
        plan,
        ("`navsim --help`", ("--help",), "pass", None, None),
        ("`navsim validate`", ("validate", now().landing), "import pydantic, yaml", 2.0, 1.5),
    )


def one_landing(plan: Plan) -> list[Line]:
    """A landing once everything is compiled, against its imports."""
    run = ("run", now().landing)
    return _against_imports(
        plan,
        ("one landing, warm, with file", (*run, *FLOWN), "import numpy, numba, h5py", 2.2, 1.6),
        ("one landing with its figures", run, "import numpy, numba, h5py, matplotlib", None, None),
    )


def _against_imports(plan: Plan, *commands: tuple[str, tuple[str, ...], str, float | None, float | None]) -> list[Line]:
    """Commands by name and arguments, each with what a Python does at least, must and aim."""
    version, lines = now(), []
    for what, arguments, least, must, aim in commands:
        jobs = version.command(*arguments), python(least)
        alternate(1, *jobs)
        ours, theirs = alternate(plan.rounds(9), *jobs)
        beside = f"{seconds('it', ours)}, {seconds('imports', theirs)}"
        whole = f'{what}, against `python -c "{least}"`'
        lines.append(Line(whole, ratios(ours, theirs), beside, must, aim, at_most=True))
    return lines


def first_run(plan: Plan) -> list[Line]:
    """A run that has to compile everything against the same run once it has."""
    if plan.quick:
        return [Line("first run ever", (), "not with --quick")]
    lines = []
    for what, arguments, must, aim in (
        ("first run ever, with figures, compiling, against the same warm", (), 5.0, 3.0),
        ("the same without figures", FLOWN, None, None),
    ):
        cold, warm = [], []
        for _ in range(3 if must else 1):
            with tempfile.TemporaryDirectory() as cache:

                def run(arguments: tuple[str, ...] = arguments, cache: str = cache) -> float:
                    return now().spend("run", now().landing, *arguments, NUMBA_CACHE_DIR=cache)

                cold.append(run())
                warm.append(statistics.median(run() for _ in range(3)))
        beside = f"{seconds('cold', cold)}, {seconds('warm', warm)}"
        lines.append(Line(what, ratios(cold, warm), beside, must, aim, at_most=True))
    return lines


def workers(plan: Plan) -> list[Line]:
    """One worker and two, whole processes; then the engine alone, and what it costs to tell finished work by its
    checksums."""
    count = plan.size(4000, 64)
    jobs = [runs(now(), count, "--workers", str(n)) for n in (1, 2)]
    one, two = alternate(plan.rounds(3), *jobs)
    beside = f"{seconds('1', one)}, {seconds('2', two)}"
    return [
        Line(f"1 -> 2 workers, whole process, {count} landings", ratios(one, two), beside, 1.85, 1.95),
        *_engine(plan),
    ]


def _engine(plan: Plan) -> list[Line]:
    """The same without the process around it; batches are kept on disk as they are finished."""
    from navsim.landing.study import fly_all, prepare
    from navsim.runner.checkpoint import CheckpointStore
    from navsim.runner.executor import threads
    from navsim.scenario.load import read

    case, count = prepare(*read(SCENARIO)), plan.size(1000, 64)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "partial"

        def fly(workers: int) -> Callable[[], object]:
            return lambda: fly_all(
                case, 1, 0, count, threads(workers), keep="errors", store=CheckpointStore(folder, {}, True)
            )

        def tell() -> None:
            store = CheckpointStore(folder, {}, False)
            if any(store.find(name) is None for name in pieces):
                raise RuntimeError("a batch just written does not count")

        fly(2)()
        pieces = sorted(file.stem for file in folder.glob("*.npz"))
        one, two, told = alternate(plan.rounds(3), timed(fly(1)), timed(fly(2)), timed(tell))
    return [
        Line(
            f"1 -> 2 workers, {count} landings flown and kept, without the process around",
            ratios(one, two),
            f"{seconds('1', one)}, {seconds('2', two)}",
            1.8,
        ),
        Line(
            f"telling their {len(pieces)} batches by checksums, against flying them",
            ratios(told, one),
            f"{seconds('checksums', told)}",
            0.01,
            at_most=True,
        ),
    ]


def memory(plan: Plan) -> list[Line]:
    """The most memory of very many runs, of which nothing is kept but statistics, against that of a thousand."""
    few, many = plan.size(1000, 256), plan.size(100_000, 1024)

    def fly(count: int) -> float:
        return now().most_memory("run", now().landing, *FLOWN, *BRIEF, "--runs", str(count), "--keep", "none")

    fly(few)  # nothing is left to compile, which takes a hundred megabytes
    small, large = (fly(count) for count in (few, many))
    beside = f"{few}: {small / 1e6:.0f} MB, {many}: {large / 1e6:.0f} MB"
    what = f"memory of {many} runs (`--keep none`, `eskf`, 12 s) against {few}"
    return [Line(what, (large / small,), beside, 1.3, at_most=True)]
