"""Sixteen usual mistakes of writing on four recordings, the checks of fifty simulated flights in order, and predictions
of the rest of recordings (`navsim replay --bet`); writes docs/replay-checks-measured.md. Needs ../shared/data; run by
`make validate`, some minutes.

Two recordings are real. Two are simulated quadrotors that go through logs of ArduPilot and PX4 and `navsim import`.
"""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import measured
import numpy as np
import replay_bench
from measured import row

import navsim
from navsim.formats.recorded_data import Fixes, Samples
from navsim.formats.recording import read_fixes, read_imu
from navsim.logs.reading import read_logs
from navsim.logs.tables import log_files
from navsim.recording_checks.mistakes import Mistake
from navsim.replays import study
from navsim.replays.reading import ReplayError
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from tests.logs import dataflash_of, ulog_of, write_dataflash, write_ulog
from tests.mistakes import MISTAKES, Made
from tests.recordings import circuit, drive, quadrotor, record, write_recording

DATA = measured.ROOT.parent / "shared" / "data"
SHIPPED = measured.ROOT / "scenarios" / "recorded_flight.yaml"
WING, CAR, ARDUPILOT, PX4 = RECORDINGS = (
    "fixed wing (`fw_thor75`)", "car (`comma2k19_ex1`)", "simulated quadrotor, ArduPilot", "simulated quadrotor, PX4",
)  # fmt: skip
NOT_JUDGED = {
    "FLU for FRD": "", "RFU for FRD": "another horizontal axis forward", "accelerometer's sign": "", "gyro's sign": "",
    "gyro z negated": "the gyro's z axis reversed", "gyro x and y": "the columns x and y of the gyros exchanged",
    "accelerometer in g": "", "gyro in deg/s": "", "radians": "", "latitude and longitude": "",
    "longitude's sign": "sign of the longitude", "height in feet": "unit of the height", "ENU for NED": "",
    "speed in knots": "", "samples' time in ms": "", "GPS time for UTC": "clock offsets",
}  # fmt: skip
"""The sixteen mistakes, of `tests.mistakes`, and the text of the table "Not checked" that covers each."""
GOOD = 50
UNTIL = {WING: 400.0, CAR: 46440.0, "the shipped flight": 65.0, ARDUPILOT: 90.0, PX4: 70.0}
"""End of the first part, s of the recording."""
SCENARIO = "`s_turn`: from run 1, on run 2"


def imported(path: Path, folder: Path) -> Path:
    """The log.yaml that `navsim import` writes."""
    log_files(read_logs([path]), path.stem).write(folder)
    return folder / "log.yaml"


def log_of(name: str, folder: Path) -> Path:
    """The log of a recording."""
    if name == WING:
        log = folder / "log.yaml"
        files = f"imu: {{file: {DATA}/fw_thor75/imu.csv.gz}}\ngnss: {{file: {DATA}/fw_thor75/gnss.csv}}\n"
        log.write_text(f"kind: replay\nversion: 1\n{files}start_s: 150\nend_s: 600\n")
        return log
    if name == CAR:
        return imported(DATA / "comma2k19_ex1", folder)
    draw: dict[str, Any] = {"rate": 100.0, "fix_rate": 5.0, "velocity_noise": 0.05, "position_noise": 0.5}
    if name == ARDUPILOT:
        path = folder / "flight.bin"
        write_dataflash(path, dataflash_of(*record(quadrotor(), 21, **draw), {}))
    else:
        path, trajectory = folder / "flight.ulg", quadrotor(120.0)
        samples, fixes = record(trajectory, 22, gyro_noise=5e-3, accel_noise=0.2, **draw)
        write_ulog(path, ulog_of(samples, fixes, trajectory.motion(samples.time).c_nb), {})
    return imported(path, folder / "log")


def recording(name: str) -> tuple[Samples, Fixes]:
    """Samples and fixes of one of `RECORDINGS`."""
    with tempfile.TemporaryDirectory() as folder:
        scenario, document = read_replay(log_of(name, Path(folder)))
        imu, gnss = (document.resolve((key, "file"), getattr(scenario, key).file) for key in ("imu", "gnss"))
        samples = read_imu(imu, True, scenario.imu.convention())[0]
        fixes = read_fixes(gnss, scenario.gnss.min_satellites, True, scenario.gnss.convention())[0]
    if scenario.begin is not None:
        samples = samples.between(scenario.begin, scenario.end_s or np.inf)
        fixes = fixes.take((fixes.time > samples.time[0]) & (fixes.time < samples.time[-1]))
    return samples, fixes


def outcome(samples: Samples, fixes: Fixes, *settings: str) -> list[str]:
    """What the checks of a replay say: refused, unaligned or ready, and their text."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            ready = study.prepare(*read_replay(write_recording(Path(folder), samples, fixes), settings))
        except InputError as error:
            return ["refused", " ".join(problem.message for problem in error.problems)]
        except ReplayError as error:
            return ["unaligned", str(error)]
    return ["ready", "; ".join(ready.not_judged)]


def said(made: Made, samples: Samples, fixes: Fixes, key: object) -> str:
    """What the checks say of a mistake: the cell of the table."""
    found, text = measured.kept(("mistake", key, made.name), lambda: outcome(*made.make(samples, fixes)))
    due = str(Mistake("", "", (made.remedy,))).partition("write ")[2]
    covered = NOT_JUDGED[made.name]
    if found == "refused":
        return "named" if due in text else "named as FLU" if "axes: FLU" in text else "refused"
    return "listed as not checked" if covered and covered in text else f"**{found}**"


def good(number: int) -> list[str]:
    """The outcome of a simulated flight in order."""
    flights = replay_bench.FLIGHTS
    if number >= 4 * len(flights):
        return outcome(*record(drive(), 1000 + number, velocities="horizontal"))
    grade, name = flights[number % len(flights)]
    kind, _, slow = name.partition(", ")
    rng = np.random.default_rng(1000 + number)
    trajectory, rough = (quadrotor(), 3.0) if slow else (circuit(), 2.0)
    samples, fixes, _ = replay_bench.record(trajectory, grade, replay_bench.RECEIVERS[kind], rng, rough)
    return outcome(samples, fixes, "alignment.heading_sigma_deg=30")


def bet(log: Path, value: float | Path, output: Path, **keys: Any) -> dict[str, list[Any]]:
    """Scores of a prediction."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", navsim.NavsimWarning)
        made = navsim.replay(log, bet=value, set=keys, output=output)
    names = ("quantity", "bet_values", "bet_independent",
             *(f"bet_{of}_{share}" for share in (50, 95) for of in ("band", "share", "low", "high")))  # fmt: skip
    return {name: made[f"summary/{name}"].tolist() for name in names}


def predicted(name: str) -> dict[str, list[Any]]:
    """Scores of the prediction for a recording."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        if name == SCENARIO:
            logs = [exported(folder / f"run{seed}.h5", seed) for seed in (1, 2)]
            bet(logs[0], 119.0, folder / "first.h5")  # 1 s before the end: almost all of it tunes
            return bet(logs[1], folder / "first_bet.json", folder / "second.h5")
        log = SHIPPED if name == "the shipped flight" else log_of(name, folder)
        return bet(log, UNTIL[name], folder / "result.h5")


def exported(result: Path, seed: int) -> Path:
    """A simulated run of the S-turn as a log."""
    navsim.run(measured.ROOT / "scenarios" / "s_turn.yaml", seed=seed, output=result)
    command = [sys.executable, "-m", "navsim", "export", str(result), "--imu"]
    subprocess.run(command, cwd=result.parent, check=True, stdout=subprocess.DEVNULL)
    return result.with_name(f"{result.stem}_replay.yaml")


def probe() -> measured.Probe:
    """The shipped flight, untuned."""
    with tempfile.TemporaryDirectory() as folder:
        found = bet(SHIPPED, 65.0, Path(folder) / "result.h5", tuning="none",
                    outages=[{"start_s": [30.0], "duration_s": [5.0]}])  # fmt: skip
    return {"band": found["bet_band_95"], "share": found["bet_share_50"], "independent": found["bet_independent"]}


PAGE = measured.Page("replay-checks-measured.md", "replay_checks", (0,), probe)


def prediction_rows() -> list[str]:
    """Rows of the table of predictions; shares whose interval excludes the predicted one are bold."""
    lines = []
    for name in (*UNTIL, SCENARIO):
        found = measured.kept(("bet", name), functools.partial(predicted, name))
        for i, quantity in enumerate(found["quantity"]):
            cells = [quantity, f"{found['bet_values'][i]}", f"{found['bet_independent'][i]:.0f}"]
            for share in (50, 95):
                band, value, low, high = (found[f"bet_{of}_{share}"][i] for of in ("band", "share", "low", "high"))
                text = f"{100 * value:.0f} [{100 * low:.0f}, {100 * high:.0f}]"
                missed = not low <= share / 100.0 <= high
                cells += [f"{band:.3g}", f"**{text}**" if missed else text]
            lines.append(row(name if i == 0 else "", *cells))
    return lines


def main() -> int:
    """Check, predict and write the page."""
    if not DATA.is_dir():
        print(f"{DATA} is not there: docs/{PAGE.name} is left as it is", file=sys.stderr)
        return 0
    begun = measured.commit()
    by_name = {made.name: made for made in MISTAKES}
    given = {name: recording(name) for name in RECORDINGS}
    table = [row(wrong, *(said(by_name[wrong], *given[name], name) for name in RECORDINGS)) for wrong in NOT_JUDGED]
    sound = [measured.kept(("good", i), functools.partial(good, i))[0] for i in range(GOOD)]
    lines = [
        "# Checks and predictions of recordings, measured",
        "",
        "## Sixteen mistakes on four recordings",
        "",
        'Each recording is written wrongly on purpose. "Named" means that navsim refuses it with the line to write. '
        "A hover doesn't show which horizontal axis is forward.",
        "",
        row("mistake", *RECORDINGS),
        "|---|---|---|---|---|",
        *table,
        "",
        f"navsim refuses {sound.count('refused')} of {GOOD} simulated flights without mistakes, and cannot align "
        f"{sound.count('unaligned')}.",
        "",
        "## Predictions",
        "",
        "[`navsim replay --bet`](replay.md#predict-the-rest) on all recordings at hand, the shipped flight up to 65 s. "
        "Shares in % with intervals of 95 %; bold intervals exclude the prediction.",
        "",
        row("recording", "in motion", "values", "independent", "50 % within", "were", "95 % within", "were"),
        "|---" * 8 + "|",
        *prediction_rows(),
    ]
    PAGE.write(lines, begun)
    return 0


if __name__ == "__main__":
    sys.exit(main())
