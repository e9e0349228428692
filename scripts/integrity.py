"""Monitors on the approach of landing.yaml: separation of filters, innovations, residual risk, few satellites; writes
docs/integrity-measured.md.

Run by `make validate`, some three minutes on two cores. Finished cases are stored (`measured.kept`).
"""

from __future__ import annotations

import functools
from typing import Any

import measured
import numpy as np
from measured import SEED, command, count, levels, row, share, summary

from navsim.landing.study import covariance_analysis, covariance_result, prepare
from navsim.published_tables import integrity_table
from navsim.scenario.load import read

CONSTELLATION = "p_constellation: 1.0e-8"
MANY = "effective_samples: 25"
LIMITS = "limits: {hal_m: 40, val_m: 60, tta_s: 6}"
SEPARATED = f"integrity={{method: filter, {CONSTELLATION}, {LIMITS}}}"
TIGHT = "filter.coupling=tight"
MONITORS: dict[str, tuple[str, ...]] = {
    "`mhss`": (f"integrity={{method: mhss, {CONSTELLATION}, {LIMITS}}}",),
    "`filter`, loose": (SEPARATED,),
    "`filter`, tight": (SEPARATED, TIGHT),
}
FAULTS: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "R01 is 15 m too long from 20 s on": ("events=[{what: step, sources: [R01], error_m: 15, at_s: 20}]",),
    "R01 runs away by 0.5 m/s from 20 s on": ("events=[{what: ramp, sources: [R01], rate_m_s: 0.5, at_s: 20}]",),
}
NEAR = "pseudolites={count: 2, frame: runway, s_m: 30, l1_m: 500}"
FALSE_ALARMS: dict[str, tuple[str, ...]] = {
    "`signals.ephemeris={}`": ("signals.ephemeris={}",),
    f"`{NEAR.replace('s_m: 30, l1_m: 500', 's_m: 60, l1_m: 700')}`": (
        NEAR.replace("s_m: 30, l1_m: 500", "s_m: 60, l1_m: 700"),
    ),
    "the same, `s_m: 30, l1_m: 500`": (NEAR,),
    "the same, `filter.velocity: false`": (NEAR, "filter.velocity=false"),
    "the same, tight": (NEAR, TIGHT),
    "no source for the first 20 s": ("events=[{what: silence, sources: [all], at_s: 0, until_s: 20}]",),
    "the same, `filter.steady_force: false`": (
        "events=[{what: silence, sources: [all], at_s: 0, until_s: 20}]", "filter.steady_force=false"),
}  # fmt: skip
SPOOFED = "events=[{what: spoof, sources: [glonass], rate_ned_m_s: [0, 0, -2], at_s: 10}]"
WINDOWED = (
    "integrity={method: chi2, limits: {hal_m: 60, val_m: 90, tta_s: 6}, innovations: {window_s: %d, p_fa: 1.0e-5}}"
)
STEP = "events=[{what: step, sources: [R01], error_m: 150, at_s: 40}]"
EXCLUDING = "integrity={method: mhss, exclusion: residual, limits: {hal_m: 120, val_m: 160, tta_s: 2}%s}"
PRIORS: dict[str, tuple[str, ...]] = {
    "`sky.source: nominal` (two systems), default priors": ("sky.source=nominal", EXCLUDING % "", STEP),
    "the same, `p_satellite: 5.0e-6`, `p_constellation: 1.0e-5`": (
        "sky.source=nominal", EXCLUDING % ", p_satellite: 5.0e-6, p_constellation: 1.0e-5", STEP),
    "one system, `p_constellation: 1.0e-9`": (EXCLUDING % ", p_constellation: 1.0e-9", STEP),
}  # fmt: skip
AT = 30
TAILS = {
    f"`mhss`, `{CONSTELLATION}`": f"integrity={{{CONSTELLATION}, tails: {{at_s: [{AT}]}}}}",
    "`chi2`": f"integrity={{method: chi2, tails: {{at_s: [{AT}]}}}}",
}
WIDE = "integrity={method: chi2, limits: {hal_m: 100, val_m: 150, tta_s: 2}}"
FEW = ((5, 0), (5, 1), (5, 2), (6, 0), (7, 0))
"""Satellites and pseudolites of filters that are monitored."""
MOST = 4
"""Subsets of satellites for each: a filter takes a second."""


def monitoring() -> list[str]:
    made = {
        (fault, name): summary(*monitor, *events)
        for fault, events in FAULTS.items()
        for name, monitor in MONITORS.items()
    }
    tested = count(made["nothing", "`mhss`"]["integrity"]["tested"])
    lines = [
        "## Monitoring the filter",
        "",
        "Limits 40 and 60 m, 6 s:",
        "",
        command(SEPARATED, *FAULTS["R01 is 15 m too long from 20 s on"]),
        "",
        f"| alarms, of {tested} epochs | {' | '.join(MONITORS)} |",
        "|---|---|---|---|",
    ]
    for fault in FAULTS:
        lines.append(row(fault, *(count(made[fault, name]["integrity"]["alarms"]) for name in MONITORS)))
    lines.append(row("HPL, VPL, mean on the glide, m", *(levels(made["nothing", name]) for name in MONITORS)))
    first = made["nothing", "`filter`, loose"]["integrity"]["hpl"][2]
    many = (tuple(text.replace(CONSTELLATION, f"{CONSTELLATION}, {MANY}") for text in one) for one in MONITORS.values())
    lines.append(row(f"the same, `{MANY}`", *(levels(summary(*settings, runs=1)) for settings in many)))
    told = f"The level of `filter` at the first epoch is {first:.0f} m. For the white noise of single fixes 25 is"
    right = "[right](integrity.md#choose-fault-priors)."
    return [*lines, "", f"{told} {right}"]


def false_alarms() -> list[str]:
    lines = [
        "False alarms in the cases that [integrity](integrity.md#monitor-the-filter) warns of, 20 runs:",
        "",
        "| case | alarms | tested epochs | vertical errors beyond their level |",
        "|---|---|---|---|",
    ]
    for label, settings in FALSE_ALARMS.items():
        found = summary(SEPARATED, *settings, runs=20)["integrity"]
        beyond = round(found["exceeded_vertical"][0] * found["tested"])
        lines.append(row(label, count(found["alarms"]), count(found["tested"]), beyond))
    text = "Fixes with an alarm don't count as beyond their level: 0 shows no bound where most epochs have an alarm."
    return [*lines, "", text]


def innovations() -> list[str]:
    lines = [
        "## Testing the innovations",
        "",
        "All satellites spoofed upwards by 2 m/s from 10 s on, limits 60 and 90 m, 6 s, `p_fa: 1.0e-5`:",
        "",
        command(SPOOFED, WINDOWED % 30),
        "",
        "| coupling | `window_s` | epochs with an alarm by innovations | hazardously misleading information, of runs |",
        "|---|---|---|---|",
    ]
    cases = [("", events, window) for events in ((SPOOFED,),) for window in (1, 10, 30)]
    for before, events, window in [*cases, ("no spoofer, ", (), 10)]:
        for name, settings in (("loose", ()), ("tight", (TIGHT,))):
            found = summary(WINDOWED % window, *events, *settings)["integrity"]
            cells = (share(found["innovation_share"]), share(found["hmi"]))
            lines.append(row(f"{before}{name}", window, *cells))
    return lines


def priors() -> list[str]:
    lines = [
        "## Levels after an exclusion",
        "",
        "R01 is 150 m too long from 40 s on, `exclusion: residual`, 20 runs:",
        "",
        "| | exclusions | epochs before with levels | epochs after an exclusion with levels within 120 and 160 m |",
        "|---|---|---|---|",
    ]
    for label, settings in PRIORS.items():
        found = summary(*settings, runs=20)["integrity"]
        cells = (count(found["exclusions"]), f"{found['level_share']:.3g}", f"{found['exclusions_available'][0]:.3g}")
        lines.append(row(label, *cells))
    return lines


def risks() -> list[str]:
    lines = [
        "## The risk behind a level",
        "",
        f"| {AT} s, vertical | level, m | total risk (`chi2`: the largest of a fault) | allowed | without a fault | "
        "given the worst fault |",
        "|---|---|---|---|---|---|",
    ]
    for label, setting in TAILS.items():
        level, whole, allowed, none, worst = measured.kept(("risk", setting), functools.partial(risk, setting))
        lines.append(row(label, f"{level:.2f}", *(f"{value:.1e}" for value in (whole, allowed, none)), worst))
    return lines


def risk(setting: str) -> list[Any]:
    """Of the vertical level at a time: the level, m, its risk, what is allowed, the risk without a fault, the worst."""
    case = prepare(*read(measured.ROOT / "scenarios" / "landing.yaml", (setting,)))
    made = covariance_result(case, covariance_analysis(case), SEED)
    tails = {name: made[f"/integrity/tails/{name}"] for name in ("axis", "level", "allowed", "total", "risk", "bias")}
    q = list(map(str, tails["axis"])).index("up")
    risks = tails["risk"][0, q, :, 0]
    worst = 1 + int(np.nanargmax(risks[1:]))
    told = f"{made['/integrity/tails/fault'][worst]} by {abs(tails['bias'][0, q, worst]):.1f} m: {risks[worst]:.1e}"
    return [
        float(tails["level"][0, q]),
        float(tails["total"][0, q, 0]),
        float(tails["allowed"][q]),
        float(risks[0]),
        told,
    ]


def few() -> list[str]:
    """Levels of fixes by number of sources, and those of filters."""
    table = measured.kept(("few", WIDE), few_by_fixes)
    filters = measured.kept(("few filters", SEPARATED, FEW, MOST), few_by_filters)
    satellites = integrity_table.SATELLITES
    head = [
        f"| pseudolites | {' | '.join(f'{n} satellites' for n in satellites)} |",
        f"|---|{'---|' * len(satellites)}",
    ]
    lines = [
        "## How few satellites",
        "",
        f"    navsim integrity-table --set '{WIDE}'",
        "",
        "HPL / VPL, m, of the median subset of the eight satellites:",
        "",
        *head,
    ]
    for added, cells in zip(integrity_table.PSEUDOLITES, table["levels"], strict=True):
        lines.append(row(added, *(f"{hpl:.0f} / {vpl:.0f}" if np.isfinite(hpl) else "-" for hpl, vpl in cells)))
    lines += ["", "Share of epochs within 100 and 150 m, worst and median subset:", "", *head]
    for added, cells in zip(integrity_table.PSEUDOLITES, table["shares"], strict=True):
        lines.append(row(added, *("-" if np.isnan(low) else f"{low:.2f} / {middle:.2f}" for low, middle in cells)))
    lines += [
        "",
        f"With `method: filter, {CONSTELLATION}`, of at most {MOST} subsets:",
        "",
        "| satellites, pseudolites | HPL / VPL, m | share of epochs within 40 and 60 m, median subset |",
        "|---|---|---|",
    ]
    for (sats, added), (within, hpl, vpl) in zip(FEW, filters, strict=True):
        lines.append(row(f"{sats}, {added}", f"{hpl:.0f} / {vpl:.0f}", f"{within:.2f}"))
    return [
        *lines,
        "",
        "Compare only rows with five satellites: they have the same subsets. In one of these four subsets the second "
        "pseudolite raises the HPL, from 32 to 46 m.",
        "",
        "The paper says that two pseudolites make integrity control possible. A test "
        "[exists](theory/integrity.md#6-required-numbers-of-sources), but with three satellites and two pseudolites "
        "the levels exceed a kilometre.",
    ]


def few_by_fixes() -> dict[str, Any]:
    case = prepare(*read(measured.ROOT / "scenarios" / "landing.yaml", (WIDE,)))
    found, _ = integrity_table.cells(integrity_table.watched(case), SEED, lambda _: None)
    return {"shares": found[..., :2].tolist(), "levels": found[..., 2:].tolist()}


def few_by_filters() -> list[list[float]]:
    case = prepare(*read(measured.ROOT / "scenarios" / "landing.yaml", (SEPARATED,)))
    here, out = integrity_table.watched(case), []
    for sats, added in FEW:
        chosen = integrity_table.subsets(here.satellites, sats, SEED, MOST)
        found = [here.judged(np.concatenate([some, here.pseudolites[:added]])) for some in chosen]
        out.append(np.median(found, axis=0).tolist())
    return out


def probe() -> measured.Probe:
    """Counts and levels of the monitored filter, of the test of innovations, and a residual risk."""
    runs, out = measured.PROBE_RUNS, {}
    for label, settings in {
        "loose": (SEPARATED, *FAULTS["R01 is 15 m too long from 20 s on"]),
        "tight": (SEPARATED, TIGHT, *FAULTS["R01 is 15 m too long from 20 s on"]),
    }.items():
        found = summary(*settings, runs=runs)["integrity"]
        out[label] = [found["alarms"], found["hpl"][0], found["vpl"][0]]
    out["innovations"] = summary(WINDOWED % 10, SPOOFED, runs=runs)["integrity"]["innovation_share"]
    return out


PAGE = measured.Page("integrity-measured.md", "integrity", (SEED,), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Integrity monitors, measured",
        "",
        "`landing.yaml`, 100 runs unless stated otherwise; 95 % intervals in brackets.",
        "",
        measured.NOT_TO_QUOTE,
    ]
    for section in (monitoring, false_alarms, innovations, priors, risks, few):
        lines += ["", *section()]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
