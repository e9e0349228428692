"""The filter with settings, sensors and sources at its limits, and a realistic landing; writes docs/filter-measured.md.

Run by `make validate`, some four minutes on two cores. Finished cases are stored (`measured.kept`).
"""

from __future__ import annotations

from typing import Any

import measured
import numpy as np
from measured import command, row, size

from navsim.filter.states import ACCEL, PHI_D
from navsim.landing.study import Case, covariance_analysis, fly_all, prepare
from navsim.runner.executor import threads
from navsim.scenario.load import read

SEED = 417
"""Of no run that anything was chosen by."""
CORNER = 59.0
"""Just before the paper's corner, s."""
PHONE = (
    "imu={preset: icm-42688-p, gyro: {bias_instability_deg_h: 10}, accelerometer: {bias_instability_mg: 0.05}}",
    "receiver.rate_hz=2",
)
FLICKER = {
    "adis16488": "",
    "hg1700": ", gyro: {drift_deg_h: 1}, accelerometer: {bias_mg: 1}",
    "stim300": ", gyro: {drift_deg_h: 10}",
}
"""Sensors with flicker noise, and what their sheets do not print."""
KINDS = ("gaussian-sum", "tfg", "eskf")
PRECISE = "pseudolites.range_sigma_m=0.2"
TIGHT = "filter.coupling=tight"
STABLE = ("receiver.clock={h0: 1.0e-18, h_minus2: 1.0e-18}", "filter.clock={h0: 0, h_minus2: 0}")
SPOOFED = (
    "sky.source=nominal",
    "events=[{what: spoof, sources: [glonass], clock_m: 300, at_s: 50, until_s: 70}]",
    "integrity={method: chi2, innovations: {window_s: 10, p_fa: 1.0e-5}}",
    TIGHT,
)
ANTENNA = "elevation_deg: [-90, -30, 0, 90], gain_dbi: [-25, -12, -4, 4]"
COMING_AND_GOING: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "`landing_gnss_only.yaml`, R01 silent from 60 s on": (
        "landing_gnss_only", "8, 7", ("events=[{what: silence, sources: [R01], at_s: 60}]",)),
    **{
        f"`s_turn.yaml`, `receiver.antenna.mask_deg: {mask}`": (
            "s_turn", used, (f"receiver.antenna={{{ANTENNA}, mask_deg: {mask}}}",))
        for mask, used in ((0, "7 to 8"), (5, "5 to 8"), (10, "4 to 8"))
    },
}  # fmt: skip
REFLECTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "`landing.yaml`, `height_m: 5`, `multipath: {}`": (
        "landing", ("pseudolites.height_m=5", "pseudolites.multipath={}", "receiver.rate_hz=2")),
    "`odense.yaml`, `signals: {preset: white}`, `multipath: {}`, `fix_errors: inflate`": (
        "odense", ("signals={preset: white}", "pseudolites.multipath={}", "filter.fix_errors=inflate")),
    "`odense.yaml`, `multipath: {permittivity: 15, conductivity_s_m: 0.035}`": (
        "odense", ("pseudolites.multipath={permittivity: 15, conductivity_s_m: 0.035}",)),
}  # fmt: skip


def case(name: str, *settings: str) -> Case:
    return prepare(*read(measured.ROOT / "scenarios" / f"{name}.yaml", settings))


def flown(name: str, settings: tuple[str, ...], runs: int) -> dict[str, np.ndarray]:
    """RMS errors and sigmas (t, n) of the states, z (t, n), NEES by the number of states (t,) and NEES/6 of position
    and velocity (t,), at each 10 s, before the corner and at the end."""

    def compute() -> dict[str, Any]:
        ready = case(name, *settings)
        clock = ready.shared.filter_time
        wanted = sorted({CORNER, *np.arange(10.0, clock[-1], 10.0).tolist(), float(clock[-1])})
        at = [int(np.argmin(np.abs(clock - t))) for t in wanted]
        found = fly_all(ready, SEED, 0, runs, threads(), keep="errors")
        error, sigma = np.asarray(found["error"])[:, at], np.asarray(found["sigma"])[:, at]
        known = np.where(sigma > 0.0, sigma, np.nan)
        rms = {"rms": error, "sigma": sigma, "z": error / known}
        return {
            "time": wanted,
            **{label: np.sqrt(np.mean(values**2, axis=0)).tolist() for label, values in rms.items()},
            "nees": (np.asarray(found["nees"])[:, at].mean(axis=0) / error.shape[2]).tolist(),
            "nees6": (np.asarray(found["nees_position_velocity"])[:, at].mean(axis=0) / 6.0).tolist(),
        }

    return {
        key: np.array(value) for key, value in measured.kept(("flown", name, settings, runs, SEED), compute).items()
    }


def analysed(name: str, settings: tuple[str, ...]) -> list[float]:
    """By the covariance analysis, from 10 s on: the largest expected NEES/6 of position and velocity, least and largest
    expected RMS of error/sigma of their states."""

    def compute() -> list[float]:
        ready = case(name, *settings)
        analysis = covariance_analysis(ready)
        late = ready.shared.filter_time >= 10.0
        square = np.diagonal(
            analysis.covariance + analysis.mean[:, :, None] * analysis.mean[:, None, :], axis1=1, axis2=2
        )
        ratio = np.sqrt(square / np.diagonal(analysis.assumed, axis1=1, axis2=2))[late, :6]
        nees = analysis.expected_square(slice(0, 6))[late]
        return [float(nees.max()), float(ratio.min()), float(ratio.max())]

    return measured.kept(("analysed", name, settings), compute)


def span(values: np.ndarray) -> str:
    return f"{np.min(values):.2f} to {np.max(values):.2f}"


def steady() -> list[str]:
    lines = [
        "## Heading in steady flight",
        "",
        f"Heading error and σ just before the corner ({CORNER:g} s) of `landing.yaml`, 200 runs:",
        "",
        "| `filter.steady_force` | RMS | σ |",
        "|---|---|---|",
    ]
    for value in ("false", "true"):
        found = flown("landing", (f"filter.steady_force={value}", "duration_s=60"), 200)
        i = int(np.argmin(np.abs(found["time"] - CORNER)))
        lines.append(row(f"`{value}`", *(f"{np.degrees(found[name][i, PHI_D]):.1f}°" for name in ("rms", "sigma"))))
    return lines


def sensors() -> list[str]:
    lines = [
        "## Scale factors switched off",
        "",
        "60 runs of `landing.yaml` with a phone's sensor (`icm-42688-p`, instabilities of 10 °/h and 0.05 mg) and "
        "fixes at 2 Hz:",
        "",
        "| `filter.scale_factors` | largest z of accelerometer biases | NEES/n | NEES/6 |",
        "|---|---|---|---|",
    ]
    for label, settings in (("`false`", ("filter.scale_factors=false",)), ("default", ())):
        found = flown("landing", (*PHONE, *settings), 60)
        biases = np.nanmax(found["z"][:, ACCEL : ACCEL + 3])
        lines.append(row(label, f"{biases:.3g}", span(found["nees"]), span(found["nees6"])))
    lines += [
        "",
        "## Flicker noise",
        "",
        "40 runs of `landing_smooth.yaml`; the filter models flicker noise by one Gauss-Markov bias:",
        "",
        "| sensor | NEES/n, mean over times | largest |",
        "|---|---|---|",
    ]
    for preset, more in FLICKER.items():
        found = flown("landing_smooth", (f"imu={{preset: {preset}{more}}}",), 40)
        lines.append(row(f"`{preset}{more}`", f"{found['nees'].mean():.2f}", f"{found['nees'].max():.2f}"))
    return lines


def seldom() -> list[str]:
    lines = [
        "## Fixes that come seldom",
        "",
        command("receiver.rate_hz=0.1", runs=40),
        "",
        "| `receiver.rate_hz` | `filter.kind` | rejected fixes | horizontal RMS, last 20 s, m | largest NEES/n |",
        "|---|---|---|---|---|",
    ]
    for rate, kind in [*(("0.1", kind) for kind in KINDS), *((rate, KINDS[0]) for rate in ("0.2", "0.5"))]:
        settings = (f"receiver.rate_hz={rate}", f"filter.kind={kind}")
        made = measured.summary(*settings, runs=40)
        counted = made["count"]
        found = flown("landing", settings, 40)
        cells = (
            f"{counted['rejected']} of {counted['fixes']}",
            measured.horizontal(made),
            f"{found['nees'].max():.3g}",
        )
        lines.append(row(rate, f"`{kind}`", *cells))
    return lines


def coupling() -> list[str]:
    lines = [
        "## Tight coupling",
        "",
        "| `landing.yaml`, 60 runs | kind | NEES/n, loose | NEES/n, tight |",
        "|---|---|---|---|",
    ]
    for kind in ("gaussian-sum", "eskf"):
        both = [flown("landing", (PRECISE, f"filter.kind={kind}", *more), 60) for more in ((), (TIGHT,))]
        lines.append(row(f"`{PRECISE.replace('=', ': ')}`", f"`{kind}`", *(span(one["nees"]) for one in both)))
    precise = measured.summary(TIGHT, *STABLE, runs=40)
    found = flown("landing", (TIGHT, *STABLE), 40)
    spoofed = measured.summary(*SPOOFED, scenario="landing_smooth", runs=20)
    error = flown("landing_smooth", (*SPOOFED, "duration_s=69"), 20)
    return [
        *lines,
        "",
        "### A spoofed clock",
        "",
        "A spoofer shifts the clock of GLONASS by 300 m from 50 to 70 s; the pseudolites share its time scale:",
        "",
        command(*SPOOFED, scenario="landing_smooth", runs=20),
        "",
        f"The vertical error is {error['rms'][-1, 2]:.0f} m at 69 s with a σ of {error['sigma'][-1, 2]:.2f} m. The "
        f"test of innovations alarms at {100 * spoofed['integrity']['innovation_share'][0]:.0f} % of the epochs.",
        "",
        "### A clock model that is too good",
        "",
        "The receiver's clock has h₀ and h₋₂ of 1e-18, the filter assumes 0, and navsim warns:",
        "",
        command(TIGHT, *STABLE, runs=40),
        "",
        f"Horizontal errors are {size(precise['rms']['horizontal'])} m with a σ of "
        f"{precise['sigma']['horizontal']:.2f} m, and NEES/6 reaches {found['nees6'].max():.3g}.",
    ]


def lasting() -> list[str]:
    lines = [
        "## Satellites that come and go",
        "",
        "A loosely coupled filter has six states for the [time-correlated errors](theory/lasting-errors.md) of all "
        "satellites. The covariance analysis from 10 s on has signals `open-sky`, fixes at 1 Hz, and in `s_turn.yaml` "
        f"the antenna `{{{ANTENNA}}}`:",
        "",
        "| scenario | satellites used | largest NEES/6 |",
        "|---|---|---|",
    ]
    for label, (name, used, settings) in COMING_AND_GOING.items():
        asked = ("signals={preset: open-sky}", "receiver.rate_hz=1", *settings)
        lines.append(row(label, used, f"{analysed(name, asked)[0]:.3g}"))
    lines += [
        "",
        "## Ground reflections",
        "",
        "Expected z of position and velocity from 10 s on, with `pseudolites.multipath`:",
        "",
        "| case | least | largest |",
        "|---|---|---|",
    ]
    for label, (name, settings) in REFLECTIONS.items():
        lines.append(row(label, *(f"{value:.2f}" for value in analysed(name, settings)[1:])))
    return lines


def odense() -> list[str]:
    runs = 40
    made = measured.summary(scenario="odense", runs=runs, seed=SEED)
    found, settled = flown("odense", (), runs), slice(1, None)
    at = made["at"]
    touchdown = [size(at[name][0]) for name in ("lateral", "vertical", "lateral_tse", "vertical_tse")]
    return [
        "## A realistic landing",
        "",
        "Runway 24 of Odense: a 4.5° glide in turbulence with an industrial sensor, a radio altimeter, GPS and Galileo "
        "behind an invented horizon, and one pseudolite:",
        "",
        f"    navsim run scenarios/odense.yaml --runs {runs} --seed {SEED}",
        "",
        "| quantity | value |",
        "|---|---|",
        row("error at touchdown, lateral and vertical, RMS, m", f"{touchdown[0]}, {touchdown[1]}"),
        row("total system error at touchdown, lateral and vertical, RMS, m", f"{touchdown[2]}, {touchdown[3]}"),
        row("runs outside the box", made["box"]["outside"]),
        row("NEES/6", span(found["nees6"][settled])),
        row("NEES/n", span(found["nees"][settled])),
    ]


def probe() -> measured.Probe:
    """A precise pseudolite tightly coupled, seldom fixes, the phone's sensor; reflections and Odense by analysis."""
    cases = {"tight": ("landing", (PRECISE, TIGHT)), "seldom": ("landing", ("receiver.rate_hz=0.1",)),
             "phone": ("landing", (*PHONE, "filter.scale_factors=false"))}  # fmt: skip
    out = {label: measured.flown(case(name, *settings), SEED) for label, (name, settings) in cases.items()}
    return {
        **out,
        "reflections": measured.analysed(
            case("landing", *REFLECTIONS["`landing.yaml`, `height_m: 5`, `multipath: {}`"][1])
        ),
    }


PAGE = measured.Page("filter-measured.md", "filter_settings", (SEED, measured.SEED), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# The filter, measured",
        "",
        "[The filter](filter.md) at its limits ([conclusions](sigma.md)). A range such as 0.84 to 1.08 is over the "
        "times of a flight. NEES/6 is of position and velocity, NEES/n of all n states; above 1, σ is too small.",
    ]
    for section in (steady, sensors, seldom, coupling, lasting, odense):
        lines += ["", *section()]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
