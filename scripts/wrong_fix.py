"""What a wrong fix near the ground does to landings that their estimates steer, by what the filter, the monitor and the
crew do about it; writes docs/wrong-fix-measured.md.

Run by `make validate`, some eight minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import measured

from navsim.landing.result import result
from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import share_interval
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
SEED = 606
"""Of no run that anything was chosen by."""
RUNS = 1000
HEIGHT, SIZE = 30.0, 6.0
"""Height above the runway at which fixes become wrong, m, and by how much they are then too high, m."""
BOX = "box={error: touchdown, lateral_m: 5, along_m: 30}"
ALWAYS = (
    "approach.guidance=estimate", "filter.kind=eskf", "imu.rate_hz=25", "receiver.rate_hz=5", "signals={}",
    "approach.lead_in_s=5", "duration_s=80",
    "initial_errors.attitude_deg=1", "imu.gyro.drift_deg_h=70", BOX,
)  # fmt: skip
UNKNOWN, STUBBORN = "filter.fix_flag=ignore", "filter.gate.max_rejected=1000000"
ALARM = ("integrity={method: chi2, innovations: {}}", "approach.go_around={on_alarm: true, delay_s: 1}")
RADIO = ("radio_altimeter={sigma_floor_m: 0.3, sigma_share: 0.02, rate_hz: 10}",)
CASES: list[tuple[str, str, tuple[str, ...]]] = [
    ("no wrong fix", "believed", ()),
    ("", "believed", ()),
    ("", "ignored", (UNKNOWN,)),
    ("the gate never gives in", "believed", (STUBBORN,)),
    ("radio altimeter", "believed", RADIO),
    ("radio altimeter", "ignored", (UNKNOWN, *RADIO)),
    ("radio altimeter, the gate never gives in", "believed", (STUBBORN, *RADIO)),
    ("go-around on alarm", "believed", ALARM),
    ("go-around on alarm", "ignored", (UNKNOWN, *ALARM)),
    ("no wrong fix, go-around on alarm", "believed", ALARM),
]
"""What is done, what the filter does with the flag, and the settings."""


def prepared(label: str, settings: tuple[str, ...]) -> Case:
    """A landing with fixed ambiguities up to `HEIGHT`, and wrong ones from there on unless the label denies it."""
    plain = read(ROOT / "scenarios" / "landing_smooth.yaml", (*ALWAYS, "receiver.fix_states={}"))
    case = prepare(*plain)
    at, end = round(case.preflight.times_at_heights([HEIGHT])[0], 2), case.scenario.duration_s
    parts = [f"{{state: fixed, at_s: 0, until_s: {end if 'no wrong' in label else at}}}"]
    if "no wrong" not in label:
        parts.append(f"{{state: wrong, at_s: {at}, until_s: {end}, error_ned_m: [0, 0, {-SIZE}]}}")
    states = f"receiver.fix_states={{forced: [{', '.join(parts)}]}}"
    return prepare(*read(ROOT / "scenarios" / "landing_smooth.yaml", (*ALWAYS, states, *settings)))


def row(label: str, flag: str, settings: tuple[str, ...]) -> str:
    """The table's line of a case."""
    case = prepared(label, settings)
    found = result(case, fly_all(case, SEED, 0, RUNS, threads(), keep="none"), SEED, keep="none")
    branch = "/summary/go_around"
    gone = f"{int(found[f'{branch}/count'])}" if f"{branch}/count" in found else "-"
    lost = _number(found[f"{branch}/lost_largest"]) if f"{branch}/count" in found else "-"
    on_ground = f"{int(found[f'{branch}/touched'])}" if f"{branch}/count" in found else "-"
    along = _number(found["/summary/touchdown/along"][0] - case.scenario.runway.aim_point_m)
    outside = int(found["/summary/box/outside"])
    return measured.row(label or "nothing", flag, outside, along, gone, lost, on_ground)


def share(count: int) -> str:
    """So many runs of a row, and the interval of their share."""
    low, high = 100.0 * share_interval(count, RUNS)[1:]
    return f"{count} of {RUNS} are {low:.1f} to {high:.1f} %"


def _number(value: Any) -> str:
    return "-" if value != value else f"{float(value):.1f}"


def probe() -> measured.Probe:
    """Some rows of the table."""
    return {f"{i}": measured.flown(prepared(CASES[i][0], CASES[i][2]), SEED) for i in (1, 5)}


PAGE = measured.Page("wrong-fix-measured.md", "wrong_fix", (SEED,), probe)


def main() -> None:
    """Fly every case and write the table."""
    begun = measured.commit()
    rows = [row(*each) for each in CASES]
    alarms = int(rows[-1].split("|")[5])
    lines = [
        "# A wrong fix near the ground, measured",
        "",
        f"From a height of {HEIGHT:g} m on, wrong ambiguities make fixes {SIZE:g} m too high, flagged as fixed.",
        "",
        "| | |",
        "|---|---|",
        f"| flight | `landing_smooth.yaml`, steered by the estimate, {RUNS} runs a row |",
        "| box | at touchdown, 5 m to each side and 30 m along |",
        "| touchdown | mean distance beyond the aim point |",
        "| alarms | of the innovations, with a pull-up 1 s later |",
        "| hit ground | counts go-arounds |",
        f"| 95 % intervals | {share(0)}; the last row's {share(alarms)}: false alarms |",
        "| the filter ignores the flag | it assumes the RMS error of all states. By default the gate accepts a fix "
        "after ten rejections in a row |",
        "| the gate never gives in | `filter.gate.max_rejected: 1000000` |",
        "",
        "| measure | flag | outside the box | touchdown, m along | go-arounds | most height lost | hit ground |",
        "|---|---|---|---|---|---|---|",
        *rows,
        "",
        "The aim point is 100 m beyond the threshold: -139.1 m is 39 m short of the runway.",
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
