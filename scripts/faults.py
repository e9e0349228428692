"""Faults, spoofers, exclusions and heavier tails on the approach of landing.yaml: alarms, levels and availability;
writes docs/faults-measured.md.

Run by `make validate`, some two minutes on two cores.
"""

from __future__ import annotations

import measured
from measured import SEED, available, command, count, horizontal, levels, share, summary

CONSTELLATION = "p_constellation: 1.0e-8"
APPROACH = "limits: {hal_m: 40, val_m: 60, tta_s: 2}"
CHI2 = f"integrity={{method: chi2, {APPROACH}}}"
SPOOFED = "events=[{what: spoof, sources: [glonass], rate_ned_m_s: [%s], at_s: 10}]"
FAULTS: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "PL1: ramp of 1 m/s from 10 s": ("events=[{what: ramp, sources: [PL1], rate_m_s: 1, at_s: 10}]",),
    "all satellites spoofed east, 2 m/s from 10 s": (SPOOFED % "0, 2, 0",),
    "all satellites spoofed up, 2 m/s from 10 s": (SPOOFED % "0, 0, -2",),
}
STEP = "events=[{what: step, sources: [R01], error_m: 60, at_s: 40}]"
EXCLUDING = "integrity={method: %s, limits: {hal_m: 120, val_m: 160, tta_s: 2}%s}"
RAREST = "mhss, p_constellation: 1.0e-9"
EXCLUSIONS: dict[str, tuple[str, ...]] = {
    "no step": (EXCLUDING % ("chi2", ""),),
    "no exclusion": (STEP, EXCLUDING % ("chi2", "")),
    "no exclusion, `drop`": (STEP, EXCLUDING % ("chi2", ", on_alarm: drop")),
    "`residual`, `drop`": (STEP, EXCLUDING % ("chi2", ", exclusion: residual, on_alarm: drop")),
    "`rms`, `drop`": (STEP, EXCLUDING % ("chi2", ", exclusion: rms, on_alarm: drop")),
    "`mhss`, `p_constellation: 1.0e-9`, `residual`, `drop`": (
        STEP, EXCLUDING % (RAREST, ", exclusion: residual, on_alarm: drop")),
}  # fmt: skip
WIDE = "limits: {hal_m: 60, val_m: 90, tta_s: 6}"
TAILS: dict[str, str] = {
    f"`{method.split(',')[0]}`{rest}, `{law}`": f"integrity={{method: {method}, {WIDE}, error_model: {law}}}"
    for method, rest in (("chi2", ""), (f"mhss, {CONSTELLATION}", f", `{CONSTELLATION}`"))
    for law in ("gaussian", "heavy_tailed")
}


def faults() -> list[str]:
    made = {label: summary(CHI2, *events) for label, events in FAULTS.items()}
    lines = [
        "## Faults and alarms",
        "",
        "`method: chi2` with its defaults, limits 40 and 60 m, 2 s:",
        "",
        f"| what happens | alarms, of {count(made['nothing']['integrity']['tested'])} fixes | approaches available | "
        "hazardously misleading information, of runs |",
        "|---|---|---|---|",
    ]
    for label, one in made.items():
        found = one["integrity"]
        lines.append(measured.row(label, count(found["alarms"]), share(found["approaches"]), share(found["hmi"])))
    return [
        *lines,
        "",
        "Two pseudolites reveal a horizontal spoofer. Spoofed upwards, the fix climbs by 100 m until touchdown: the "
        "pseudolites hardly measure height.",
    ]


def forms() -> list[str]:
    lines = ["Levels of the same landing, mean over the glide, m:", "", "| | HPL | VPL |", "|---|---|---|"]
    apart = f"integrity={{method: mhss, {CONSTELLATION}, {APPROACH}}}"
    many = f"{CONSTELLATION}, effective_samples: 25"
    watching = {"`chi2`": CHI2, f"`mhss`, `{CONSTELLATION}`": apart,
                f"`mhss`, `{many}`": f"integrity={{method: mhss, {many}, {APPROACH}}}"}  # fmt: skip
    for name, setting in watching.items():
        for added, settings in (("two pseudolites", ()), ("none", ("pseudolites.count=0",))):
            lines.append(measured.row(f"{name}, {added}", levels(summary(setting, *settings, runs=1), between=" | ")))
    stations = (
        "receivers: 4, ground_sigma_m: 0.3, b_m: 0.2",
        "receivers: 2, ground_sigma_m: 1.0, b_m: 5",
    )
    compared = [
        summary(f"integrity={{method: mhss, {CONSTELLATION}, comparison: {{gbas: {{{station}}}}}}}", runs=1)
        for station in stations
    ]
    ground = [levels(one, ("gbas_lpl", "gbas_vpl"), " and ") for one in compared]
    return [
        *lines,
        "",
        "For this white noise 25 is [right](integrity.md#choose-fault-priors).",
        "",
        f"With the formulas of SBAS the same fixes have {levels(compared[0], ('sbas_hpl', 'sbas_vpl'), ' and ')} m, "
        f"with those of GBAS {ground[0]} (`{stations[0]}`) or {ground[1]} (`{stations[1]}`).",
    ]


STATION = (
    "sky.source=nominal", "sky.systems=[gps]", "pseudolites.count=0", "receiver.smoothing_s=30",
    "signals={range_sigma_m: 0.4, range_law: constant, errors: {ground_station: "
    "{receivers: 4, accuracy_designator: C, correlation_time_s: 100}}}",
    "integrity={comparison: {gbas: {approach_service: D}}}",
)  # fmt: skip
FAULTY, RECEIVER = "G14", "events=[{what: step, sources: [%s], error_m: %s, reference_receiver: 2}]"


def station() -> list[str]:
    lines = [
        "## A faulty reference receiver",
        "",
        command(*STATION, RECEIVER % (FAULTY, 10)),
        "",
        f"| error of one receiver of four, {FAULTY}, m | fault-free VPL, m | VPL by B values, m | "
        "vertical errors beyond the latter (K_md: 0.002) |",
        "|---|---|---|---|",
    ]
    for error in (0, 2, 10, 30):
        found = summary(*STATION, *((RECEIVER % (FAULTY, error),) if error else ()))["integrity"]
        mean = [f"{found[name][0]:.2f}" for name in ("gbas_vpl", "gbas_vpl_run")]
        lines.append(measured.row(error, *mean, share(found["gbas_exceeded_vertical"])))
    return lines


def exclusions() -> list[str]:
    made = {label: summary(*settings) for label, settings in EXCLUSIONS.items()}
    tested = count(made["no step"]["integrity"]["tested"])
    lines = [
        "## Exclusion",
        "",
        "A step of 60 m on R01 from 40 s on, limits 120 and 160 m, 2 s:",
        "",
        command(*EXCLUSIONS["`residual`, `drop`"]),
        "",
        f"| | alarms that stay, of {tested} fixes | exclusions: correct, wrong, "
        "needless | epochs available | horizontal RMS of the filter, m |",
        "|---|---|---|---|---|",
    ]
    for label, one in made.items():
        found = one["integrity"]
        kinds = ("correct", "wrong", "needless")
        done = ", ".join(count(found[f"exclusions_{kind}"]) for kind in kinds) if "exclusions" in found else ""
        lines.append(measured.row(label, count(found["alarms"]), done, available(one), horizontal(one)))
    return [
        *lines,
        "",
        "If two sources fail together and the list of faults lacks this pair, the alarm stays. A spoofer who moves all "
        "sources raises none.",
    ]


def tails() -> list[str]:
    made = {label: summary(setting) for label, setting in TAILS.items()}
    tested = count(made["`chi2`, `gaussian`"]["integrity"]["tested"])
    lines = [
        "## Heavier tails",
        "",
        command(TAILS["`chi2`, `heavy_tailed`"]),
        "",
        f"| | alarms, of {tested} fixes | beyond HPL, VPL without an "
        "alarm | epochs available | approaches available | horizontal RMS and σ of the filter, m |",
        "|---|---|---|---|---|---|",
    ]
    for label, one in made.items():
        found = one["integrity"]
        shares = (found[f"exceeded_{axis}"][0] for axis in ("horizontal", "vertical"))
        beyond = ", ".join(f"{round(part * found['tested'])}" for part in shares)
        sigma = f"{one['sigma']['horizontal']:.3f}"
        cells = (count(found["alarms"]), beyond, available(one), share(found["approaches"]))
        lines.append(measured.row(label, *cells, f"{horizontal(one)}, {sigma}"))
    return [
        *lines,
        "",
        "The column *beyond* counts fixes. So few fixes say nothing about an integrity risk.",
    ]


def probe() -> measured.Probe:
    """Some cases of every section: counts, levels, and the filter's horizontal RMS."""
    cases = {
        "spoofed": (CHI2, *FAULTS["all satellites spoofed up, 2 m/s from 10 s"]),
        "excluded": EXCLUSIONS["`residual`, `drop`"],
        "heavy_tailed": (TAILS[f"`mhss`, `{CONSTELLATION}`, `heavy_tailed`"],),
    }
    out = {}
    for label, settings in cases.items():
        one = summary(*settings, runs=measured.PROBE_RUNS)
        found = one["integrity"]
        rms = one["rms"]["horizontal"][0]
        out[label] = [found["alarms"], found["availability"][0], found["hpl"][0], found["vpl"][0], rms]
    return out


PAGE = measured.Page("faults-measured.md", "faults", (SEED,), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Faults and exclusions, measured",
        "",
        "`landing.yaml`, 100 runs; 95 % intervals in brackets.",
        "",
        measured.NOT_TO_QUOTE,
    ]
    for section in (faults, forms, station, exclusions, tails):
        lines += ["", *section()]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
