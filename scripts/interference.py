"""How much power of a jammer the approach of landing.yaml survives, and pseudolites as jammers; writes
docs/interference-measured.md.

Run by `make validate`, some two minutes on two cores. Finished cases are stored (`measured.kept`).
"""

from __future__ import annotations

from collections.abc import Mapping

import measured
from measured import SEED, available, command, count, horizontal, levels, row, summary

RUNS = 20
JAMMER = (
    "{name: J1, place: {lat_deg: 56.03, lon_deg: 37.02}, height_m: 10, eirp_dbw: %s, waveform: %s, centre_mhz: 1590, "
    "bandwidth_mhz: 60}"
)
LIMITED = "integrity={method: chi2, limits: {hal_m: 40, val_m: 60, tta_s: 2}}"


def jammed(power: str, waveform: str = "noise", beside: str = "") -> tuple[str, ...]:
    return (LIMITED, f"interference={{jammers: [{JAMMER % (power, waveform)}]{beside}}}")


SKYLINE = ", horizon: [{azimuth_deg: [0, 90], elevation_deg: %d, distance_m: 1000}]"
POWERS: dict[str, tuple[str, ...]] = {
    "none": (LIMITED,),
    **{power: jammed(power) for power in ("-20", "-10", "0", "10")},
    "0, behind a skyline of 2° over the azimuths 0 to 90°, 1 km from the threshold": jammed("0", beside=SKYLINE % 2),
    "0, behind one of 5°": jammed("0", beside=SKYLINE % 5),
    "0, a sweep of the same band in 10 s": jammed("0", "sweep, sweep_s: 10"),
}
APPROACH = (
    "sky.source=nominal-gps",
    "pseudolites={count: 2, frame: runway, s_m: 60, l1_m: 700, clock: gps, cn0_dbhz: 50, cn0_reference_m: 1000}",
    "integrity={method: chi2, limits: {hal_m: 60, val_m: 60, tta_s: 2}}",
)
PSEUDOLITES: dict[str, tuple[str, ...]] = {
    "do not jam": APPROACH,
    **{
        label: (*APPROACH, f"interference={{pseudolites: {keys}}}")
        for label, keys in {
            "always transmit": "{}",
            "always, `lines: false`": "{lines: false}",
            "pulses": "{pulses: {}}",
            "pulses, `blanking: false`": "{pulses: {blanking: false}}",
            "pulses, `correlation: ungated`": "{pulses: {correlation: ungated}}",
        }.items()
    },
}


def rows(cases: Mapping[str, tuple[str, ...]]) -> list[str]:
    out = []
    for label, settings in cases.items():
        made = summary(*settings, runs=RUNS)
        some = made["integrity"]["level_share"] > 0.0
        cells = (count(made["count"]["epochs_without_fix"]), f"{made['integrity']['level_share']:.3g}")
        out.append(row(label, *cells, levels(made) if some else "none", available(made), horizontal(made)))
    return out


def probe() -> measured.Probe:
    """Levels and horizontal RMS with a jammer, and with pseudolites that jam."""
    out = {}
    for label, settings in {"jammer": POWERS["-10"], "pseudolites": PSEUDOLITES["pulses"]}.items():
        made = summary(*settings, runs=measured.PROBE_RUNS)
        out[label] = [made["integrity"]["hpl"][0], made["integrity"]["vpl"][0], made["rms"]["horizontal"][0]]
    return out


PAGE = measured.Page("interference-measured.md", "interference", (SEED,), probe)
HEAD = (
    "epochs without a fix | epochs of the glide with levels | HPL, VPL, mean of these, m | epochs available | "
    "horizontal RMS of the filter, m |"
)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    jamming = PSEUDOLITES["pulses"]
    total = count(summary(*POWERS["none"], runs=RUNS)["count"]["fixes"])
    PAGE.write(
        [
            "# Jammers, measured",
            "",
            f"`landing.yaml`, {RUNS} runs, {total} epochs; 95 % intervals in brackets.",
            "",
            "## Jammers",
            "",
            "The jammer of [the example](interference.md#add-a-jammer), always on, `method: chi2`, limits 40 and 60 m:",
            "",
            f"| EIRP, dBW | {HEAD}",
            "|---|---|---|---|---|---|",
            *rows(POWERS),
            "",
            "## Pseudolites as jammers",
            "",
            "Two pseudolites under a GPS approach, at their nearest 26 dB above the satellites; limits 60 m:",
            "",
            command(*jamming, runs=RUNS),
            "",
            f"| pseudolites | {HEAD}",
            "|---|---|---|---|---|---|",
            *rows(PSEUDOLITES),
        ],
        begun,
    )


if __name__ == "__main__":
    main()
