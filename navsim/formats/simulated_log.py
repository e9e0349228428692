"""A simulated run as a recorded flight: inertial samples, fixes, and the log for `navsim replay`.

The log contains the filter of the run and its initial state at full precision:

- kind, gate, components, latency and lever arm;
- the filter model of the sensors;
- the state at time 0 with 1 sigmas;
- the covariance of each fix in the filter model.

`differences` lists what a recorded flight cannot have.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np

from navsim.filter import states
from navsim.formats.conventions import (
    ACCELEROMETER_UNITS,
    FIX_CORRELATIONS,
    FIX_SIGMAS,
    GNSS_COLUMNS,
    GYRO_UNITS,
    IMU_COLUMNS,
    effects_of,
)
from navsim.formats.yaml_text import dump
from navsim.results.findings import several
from navsim.results.result import Result, scenario_of

FIX_ERROR, RANGE_ERROR = "fix_error_", "range_error_"
"""Prefixes of the names of states for time-correlated errors of fixes, and of ranges; the initial variance of each is
one."""
NEEDED = ("/imu/delta_angle", "/receiver/position_llh", "/filter/start_sigma")
"""Variables that a result needs for this."""
_LONGEST = 1e9
"""Longest correlation time of a log, s."""
_ROOT_HOUR = 60.0
"""Root of an hour, root of s."""
_SENSORS = {
    "gyro": (states.GYRO, GYRO_UNITS["deg/h"], GYRO_UNITS["deg/s"],
             ("drift_deg_h", "markov_deg_h", "rate_random_walk_deg_h_sqrt_h", "arw_deg_sqrt_h")),
    "accelerometer": (states.ACCEL, ACCELEROMETER_UNITS["mg"], 1.0,
                      ("bias_mg", "markov_mg", "bias_random_walk_mg_sqrt_h", "vrw_m_s_sqrt_h")),
}  # fmt: skip
"""For each triad: first state, units of its bias and of the integral of its white noise, keys of a constant bias, a
Markov bias, a random walk of the bias and white noise."""


def differences(result: Result) -> list[str]:
    """Features of a run's filter that its exported log lacks, so that their estimates differ."""
    names = [str(name) for name in result["/filter/state"][states.N_BASE :]]
    out = []
    if _is_tight(result):
        out.append("takes ranges (filter.coupling: tight), the replay takes fixes")
    if gains := sum(name.startswith(("gyro_", "accelerometer_")) for name in names):
        out.append(f"follows {gains} scale factors and misalignments (filter.scale_factors, filter.misalignments)")
    aids = sorted({path.split("/")[2] for path in result.variables if path.startswith("/aiding/")})
    if aids:
        names = ["DME" if aid == "dme" else aid.replace("_", " ") for aid in aids]
        out.append(f"uses the {' and '.join(filter(None, (', '.join(names[:-1]), names[-1])))}")
    scenario = scenario_of(result)
    if not _is_tight(result) and (missing := int(np.sum(np.isnan(_fixes(result)[:, 1])))):
        none = missing == result["/filter/epoch"].size
        text = f"has {several(missing, 'epoch')} without a fix, of which a replay knows nothing"
        out.append("has no fix, and a replay needs one" if none else text)
    early = int(np.sum(_arrival(result) - _assumed(scenario, "latency_s") <= 0.0))
    if early:
        out.append(
            f"takes {several(early, 'fix')}, by filter.latency_s valid before time 0, that the replay leaves out"
        )
    return out


def files(result: Result, imu: Path, fixes: Path, title: str) -> tuple[list[list[str]], list[list[str]], str]:
    """The rows of the tables of samples and fixes, the first with the names of the columns, and the log that names the
    files."""
    time = result["/imu/time"]
    step = np.diff(time, prepend=0.0)[:, None]
    samples = [time[:, None], *(result[f"/imu/delta_{name}"][0] / step for name in ("angle", "velocity"))]
    every, columns = _fixes(result), [*GNSS_COLUMNS]
    fixed = np.isfinite(every[:, 1])
    table, errors = every[fixed], _correlated_errors(result)
    if not _is_tight(result):
        spread = _spread(result["/filter/fix_covariance"][0][fixed])
        effect = result["/filter/fix_effect"][fixed] if errors.size else np.empty((*spread.shape[:1], 6, 0))
        effects = [name for k in range(errors.size) for name in effects_of(k + 1)]
        columns += [*FIX_SIGMAS, *FIX_CORRELATIONS, *effects]
        table = np.hstack([table, spread, np.swapaxes(effect, 1, 2).reshape(len(effect), 6 * effect.shape[2])])
    remarks = [f"# The run's filter {text}: its estimates differ from the replay's." for text in differences(result)]
    log = dump(_log(result, imu, fixes, title))
    return (
        [[*IMU_COLUMNS], *_cells(np.column_stack(samples))],
        [columns, *_cells(table)],
        "\n".join([*remarks, log]),
    )


def _cells(table: np.ndarray) -> list[list[str]]:
    """Numbers with all their digits, nothing for those that are unknown."""
    return [["" if np.isnan(x) else repr(float(x)) for x in row] for row in table]


def _is_tight(result: Result) -> bool:
    return "/filter/fix_covariance" not in result


def _arrival(result: Result) -> np.ndarray:
    """When the fixes came to the filter (e,), s."""
    return np.asarray(result["/filter/epoch"] + scenario_of(result)["receiver"]["latency_s"])


def _assumed(scenario: dict[str, Any], key: str) -> Any:
    """The receiver's latency or lever arm in the filter model."""
    own = scenario["filter"].get(key)
    return scenario["receiver"][key] if own is None else own


def _fixes(result: Result) -> np.ndarray:
    """Rows of the table of fixes (e, 7), as used by the run's filter, or with ranges those of the receiver; nan for
    none."""
    branch = "/receiver/" if _is_tight(result) else "/filter/fix_"
    llh, velocity = result[f"{branch}position_llh"][0], result[f"{branch}velocity_ned"][0]
    return np.column_stack([_arrival(result), np.degrees(llh[:, :2]), llh[:, 2], velocity])


def _correlated_errors(result: Result) -> np.ndarray:
    """Filter states for time-correlated errors of fixes."""
    return np.flatnonzero([str(name).startswith(FIX_ERROR) for name in result["/filter/state"]])


def _fix_errors(result: Result) -> dict[str, Any]:
    """Their correlation times and numbers, for the section `gnss`."""
    decay = result["/filter/state_decay"][_correlated_errors(result)].tolist()
    if not decay:
        return {}
    groups = [list(group) for _, group in itertools.groupby(decay)]
    return {"errors": [{"correlation_time_s": min(1.0 / max(g[0], 1e-12), _LONGEST), "states": len(g)} for g in groups]}


def _spread(covariance: np.ndarray) -> np.ndarray:
    """1 sigmas and correlations (e, 21) of covariances (e, 6, 6)."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = covariance / (sigma[:, :, None] * sigma[:, None, :])
    return np.column_stack([sigma, correlation[:, *np.triu_indices(sigma.shape[1], 1)]])


def _log(result: Result, imu: Path, fixes: Path, title: str) -> dict[str, Any]:
    """The log of these files."""
    scenario = scenario_of(result)
    section = scenario["filter"]
    tight = _is_tight(result)
    noise = {"position_sigma_m": _mean_sigma(result)} if tight else _fix_errors(result)
    return {
        "kind": "replay",
        "version": 1,
        "title": title,
        "epoch": scenario["epoch"],
        "imu": {"file": imu.name, "samples": "averaged", **{name: _sensor(result, name) for name in _SENSORS}},
        "gnss": {
            "file": fixes.name, "latency_s": _assumed(scenario, "latency_s"),
            "lever_arm_m": [*_assumed(scenario, "lever_arm_m")], "spacing_s": 0.0, **noise,
        },
        "checks": "off",
        "alignment": {"known": _start(result)},
        "tuning": "likelihood" if tight else "none",
        "filter": {
            "kind": section["kind"],
            # the run's filter never restarts, however many fixes it rejects
            "gate": {**section["gate"], "restart_s": math.ceil(scenario["duration_s"]) + 1.0},
            "steady_force": section["steady_force"],
            "gaussian_sum": section["gaussian_sum"],
            "output_rate_hz": "fixes",
        },
    }  # fmt: skip


def _start(result: Result) -> dict[str, Any]:
    """The state that the filter starts from, for `alignment.known`."""
    llh = result["/filter/start_position_llh"][0]
    position, velocity, attitude = np.split(result["/filter/start_sigma"][: states.SENSORS], 3)
    return {
        "time_s": 0.0,
        "lat_deg": math.degrees(llh[0]),
        "lon_deg": math.degrees(llh[1]),
        "height_m": float(llh[2]),
        "velocity_m_s": result["/filter/start_velocity_ned"][0].tolist(),
        "attitude_deg": np.degrees(result["/filter/start_attitude_rpy"][0]).tolist(),
        "position_sigma_m": position.tolist(),
        "velocity_sigma_m_s": velocity.tolist(),
        "attitude_sigma_deg": np.degrees(attitude).tolist(),
    }


def _sensor(result: Result, name: str) -> dict[str, float]:
    """The errors of a triad as the filter follows them: a Markov bias, or a constant one with a random walk, and white
    noise."""
    first, unit, of_integral, (constant, markov, walk, white) = _SENSORS[name]
    sigma = float(result["/filter/start_sigma"][first]) / unit
    decay, drive = (float(result[f"/filter/state_{of}"][first]) for of in ("decay", "drive"))
    noise = {white: float(result[f"/filter/noise_{name}"]) * _ROOT_HOUR / of_integral}
    if decay > 0.0:
        return {constant: 0.0, markov: sigma, "markov_time_s": 1.0 / decay, **noise}
    return {constant: sigma, markov: 0.0, walk: drive * _ROOT_HOUR / unit, **noise}


def _mean_sigma(result: Result) -> list[float]:
    """1 sigma of the run's fixes, root mean square over the flight: horizontal per axis, vertical, m."""
    variance = np.nanmean(np.diagonal(result["/receiver/covariance_enu"], axis1=1, axis2=2), axis=0)
    return [round(math.sqrt(x), 4) for x in (0.5 * (variance[0] + variance[1]), variance[2])]
