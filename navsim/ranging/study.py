"""Recorded ranges: read, started, tuned, filtered, smoothed and compared with a reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from navsim.gnss.ranging_geometry import Plane
from navsim.ranging.estimate import Filtered, Smoothed, StartState, filter_causally, relinearise, tune
from navsim.ranging.evaluation import (
    TRUE_SIGMA,
    dilution,
    errors_against,
    find_time_offset,
    sigma_too_small,
    source_statistics,
    unobserved_states,
)
from navsim.ranging.model import BY_SOURCE, SETTINGS, RangeModel, build_model
from navsim.ranging.recording import RangeLog, ReferenceTrack, read_log, read_reference
from navsim.ranging.scenario import RecordedRanges
from navsim.ranging.start import AS_LIKELY, find_start, mirror_solution
from navsim.ranging.swapped import fits_badly, swapped_pairs
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.notes import CONSISTENT, FIX
from navsim.results.result import Result
from navsim.results.schema import RANGES
from navsim.runner.attributes import root_attributes
from navsim.runner.job import JobError
from navsim.scenario_files.source import Document
from navsim.statistics.consistency import correlated_states
from navsim.statistics.rounding import digits

MANY_REJECTED = 0.05
"""Share of a source's ranges without the usual noise beyond which they speak against the model."""
_NO_POSITION = "no position fits the ranges: check the positions of the sources, or give motion.start"
_TUNING_ROUNDS, _GAIN = 6, 1.0
"""Largest number of searches for the noise, each about a new linearisation, and the gain of log-likelihood below which
another one is not worth it."""
_AT_BOUND = 0.02
"""Difference of the logarithm of a setting from that of a bound below which the setting is at that bound."""
_START_FACTOR, _LEAST_SIGMA = 3.0, 0.3
"""1 sigma of the filter's start over that of the smoothed position, and the least, m."""


@dataclass(frozen=True)
class RangeStudy:
    """A recording ready to be computed."""

    scenario: RecordedRanges
    log: RangeLog
    model: RangeModel
    track: ReferenceTrack | None
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class RangeSolution:
    """What a recording came to: settings, smoothed states, the filter's output, plane of the sources and the solution
    on its other side, log-likelihood of both."""

    settings: dict[str, float]
    smoothed: Smoothed
    filtered: Filtered
    plane: Plane
    mirrored: Smoothed | None


def prepare(scenario: RecordedRanges, document: Document) -> RangeStudy:
    """Read and check. Raises InputError."""
    log = read_log(scenario, document)
    track = None if scenario.reference is None else read_reference(scenario.reference, log.sources, document)
    return RangeStudy(scenario, log, build_model(scenario, log), track, list(log.warnings))


def solve(model: RangeModel, tell: Callable[[str], None] = lambda _: None) -> RangeSolution:
    """Start, tune, smooth and filter. Raises JobError where no start is found."""
    settings = model.settings()
    tell("looking for the start")
    start, smoothed = find_start(model, settings)
    smoothed = relinearise(model, settings, start, smoothed)
    if not np.isfinite(smoothed.filtered.likelihood):
        raise JobError(_NO_POSITION)
    if model.free and model.scenario.tuning == "likelihood":
        before = smoothed.filtered.likelihood
        for _ in range(_TUNING_ROUNDS):
            settings = tune(model, settings, start, smoothed.lines, lambda: tell("tuning the noise"))
            smoothed = relinearise(model, settings, start, smoothed)
            gain, before = smoothed.filtered.likelihood - before, smoothed.filtered.likelihood
            if gain < _GAIN:
                break
    tell("smoothing")
    plane, mirrored = mirror_solution(model, settings, start, smoothed)
    sigma = _START_FACTOR * np.sqrt(np.diagonal(smoothed.covariance[0])[:3])
    known = StartState(
        smoothed.state[0, :3], (max(float(sigma[:2].max()), _LEAST_SIGMA), max(float(sigma[2]), _LEAST_SIGMA)),
        start.clock,
    )  # fmt: skip
    tell("filtering")
    filtered = filter_causally(model, settings, known)
    return RangeSolution(settings, smoothed, filtered, plane, mirrored)


def compute(study: RangeStudy, tell: Callable[[str], None] = lambda _: None) -> Result:
    """The result of a recording. Raises JobError."""
    model, scenario = study.model, study.scenario
    try:
        solution = solve(model, tell)
    except np.linalg.LinAlgError:
        raise JobError(_NO_POSITION) from None
    smoothed, filtered = solution.smoothed, solution.filtered
    out = ResultBuilder(RANGES)
    names = model.log.sources.names
    last = np.append(np.flatnonzero(np.diff(model.data.time) > 0.0), model.data.time.size - 1)
    out["/source"] = np.array(names, dtype=object)
    out["/sources/position"] = model.data.position
    if model.log.sources.origin is not None:
        out["/sources/origin_llh"] = model.log.sources.origin
    out["/time"] = model.data.time[last]
    for name, state, covariance in (
        ("filter", filtered.state, filtered.covariance), ("smoother", smoothed.state, smoothed.covariance),
    ):  # fmt: skip
        if name == "smoother" and not scenario.smoother:
            continue
        variance = np.einsum("mii->mi", covariance[last])
        out[f"/{name}/position"] = state[last, :3]
        out[f"/{name}/position_sigma"] = _root(variance[:, :3])
        out[f"/{name}/velocity"] = state[last, 3:6]
        out[f"/{name}/velocity_sigma"] = _root(variance[:, 3:6])
    findings = [*_tuned(out, model, solution.settings), *_states(out, model, smoothed)]
    if model.clocks:
        _clocks(out, model, smoothed, last)
    findings += _per_source(out, model, solution)
    out["/dop/position"], out["/dop/horizontal"], out["/dop/vertical"] = dilution(
        smoothed.state[last, :3], model.data.position, model.has_no_clock
    )
    findings += _mirror(out, model, solution)
    if study.track is not None:
        findings += _reference(out, study, study.track, solution, last)
    result = out.result(
        root_attributes(
            RANGES, 0, scenario, measurement=scenario.ranges.measurement, datum=model.datum,
            recorded_s=np.array([model.data.time[0], model.data.time[-1]]),
        )
    )  # fmt: skip
    result.variables.update(kept(findings))
    return result


def _root(variance: np.ndarray) -> np.ndarray:
    """Standard deviations; nan where rounding left a negative variance."""
    return np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def _tuned(out: ResultBuilder, model: RangeModel, settings: dict[str, float]) -> list[Finding]:
    """The noise settings, and which of them are at a bound."""
    tuned = model.free if model.scenario.tuning == "likelihood" else ()
    used = [name for name in SETTINGS if name in model.free or name in model.given]
    spreads = [BY_SOURCE[name] for name in model.by_source]
    out["/noise/setting"] = np.array([*used, *spreads], dtype=object)
    out["/noise/value"] = np.array([settings[name] for name in (*used, *spreads)])
    units = [*(_units(name, model.order) for name in used), *("1" for _ in spreads)]
    out["/noise/units"] = np.array(units, dtype=object)
    out["/noise/tuned"] = np.array([int(name in tuned or name in spreads) for name in (*used, *spreads)])
    for name in BY_SOURCE:
        out[f"/noise/source_{name}"] = model.of_sources(settings, name)
    at_bound = [
        f"{name.replace('_', ' ')} {bound:g} {_units(name, model.order)}"
        for name in tuned
        for bound in (SETTINGS[name].low, SETTINGS[name].high)
        if abs(np.log(settings[name] / bound)) < _AT_BOUND
    ]
    if not at_bound:
        return []
    text = (
        f"the tuning ended at its bound: {', '.join(at_bound)}. The ranges do not show it, or it absorbs another "
        "error; write it in the file if you know it"
    )
    if any(each.startswith("wander") for each in at_bound):
        text += ". Without a wander: `bias: {wander: {sigma_m: 0, correlation_time_s: 1}}`"
    return [Finding("tuning", text, count=len(at_bound), of=len(tuned))]


def _units(name: str, order: int) -> str:
    if name in ("horizontal_noise", "vertical_noise"):
        return ("m/s/sqrt(s)", "m/s2/sqrt(s)")[order - 2]
    return SETTINGS[name].units


def _states(out: ResultBuilder, model: RangeModel, smoothed: Smoothed) -> list[Finding]:
    """Last values of clocks, biases and wandering errors, which of them the geometry shows, and pairs that it cannot
    tell apart."""
    state, covariance = smoothed.state[-1], smoothed.covariance[-1]
    first = np.diagonal(smoothed.prior)
    seen = ~unobserved_states(first, np.diagonal(covariance))
    out["/states/state"] = np.array(model.names, dtype=object)
    out["/states/units"] = np.array(model.units, dtype=object)
    out["/states/value"] = np.where(seen, state, np.nan)
    out["/states/sigma"] = np.where(seen, _root(np.diagonal(covariance)), np.nan)
    out["/states/prior_sigma"] = _root(first)
    correlated = np.arange(model.size) < model.first_markov
    correlated &= (np.arange(model.size) < 3) | (np.arange(model.size) >= 3 * model.order)
    pairs = correlated_states(covariance, np.flatnonzero(correlated))
    out["/states/pair"] = np.array([f"{model.names[a]}, {model.names[b]}" for a, b, _ in pairs], dtype=object)
    out["/states/pair_correlation"] = np.array([c for _, _, c in pairs], dtype=float)
    found = []
    unseen = [name for name, shown, there, s in zip(model.names, seen, correlated, first, strict=True)
              if there and not shown and s > 0.0]  # fmt: skip
    if unseen:
        text = f"the ranges do not show {', '.join(unseen)}: navsim gives no value and no sigma for these states"
        found.append(Finding("states_not_seen", text, count=len(unseen), of=int(correlated.sum())))
    if pairs:
        worst = "; ".join(f"{model.names[a]} and {model.names[b]} ({c:+.4f})" for a, b, c in pairs[:4])
        text = (
            f"the geometry cannot tell apart {len(pairs)} pairs of states (correlation beyond 0.99): {worst}. Only a "
            "combination of each pair is known to its sigma"
        )
        found.append(Finding("correlated_states", text, count=len(pairs), of=int(correlated.sum())))
    return found


def _clocks(out: ResultBuilder, model: RangeModel, smoothed: Smoothed, last: np.ndarray) -> None:
    """Offset and rate of each clock against the datum over time."""
    offset = model.first_clock + 2 * np.arange(len(model.clocks))
    variance = np.einsum("mii->mi", smoothed.covariance[last])
    out["/clocks/clock"] = np.array(model.clocks, dtype=object)
    for name, at in (("offset", offset), ("rate", offset + 1)):
        out[f"/clocks/{name}"] = smoothed.state[np.ix_(last, at)]
        out[f"/clocks/{name}_sigma"] = _root(variance[:, at])
    lasts = max(float(model.data.time[-1] - model.data.time[0]), 1e-9)
    out["/clocks/mean_rate"] = (smoothed.state[-1, offset] - smoothed.state[0, offset]) / lasts


def _per_source(out: ResultBuilder, model: RangeModel, solution: RangeSolution) -> list[Finding]:
    """Innovations and residuals, and their statistics by source."""
    data, filtered, smoothed = model.data, solution.filtered, solution.smoothed
    shown = smoothed.filtered if model.scenario.smoother else filtered
    estimate = smoothed.state if model.scenario.smoother else filtered.state
    distance = np.linalg.norm(estimate[:, :3] - data.position[data.source], axis=1)
    correlated = slice(3, model.first_markov)
    residual = data.range - distance - np.einsum("mi,mi->m", data.row[:, correlated], estimate[:, correlated])
    out["/ranges/time"], out["/ranges/source_index"], out["/ranges/range"] = data.time, data.source, data.range
    out["/ranges/innovation"], out["/ranges/innovation_sigma"] = shown.innovation, _root(shown.variance)
    out["/ranges/residual"], out["/ranges/weight"] = residual, shown.weight
    if np.isfinite(model.log.signal).any():
        out["/ranges/signal"] = model.log.signal
    table = source_statistics(data.source, len(model.log.sources.names), residual, shown)
    for name, values in table.items():
        out[f"/summary/{name}"] = values
    usual = shown.weight > 0.5
    out["/summary/residual_rms_all"] = float(np.sqrt(np.mean(residual[usual] ** 2)))
    out["/summary/nis_all"] = float(np.mean(shown.innovation[usual] ** 2 / shown.variance[usual]))
    out["/summary/log_likelihood"] = smoothed.filtered.likelihood
    found = []
    for name, heard, away in zip(model.log.sources.names, table["ranges"], table["outliers"], strict=True):
        if away > MANY_REJECTED * heard:
            text = f"{away} of {heard} ranges of {name} do not have the usual noise (outliers)"
            found.append(Finding("outliers", text, (FIX,), count=int(away), of=int(heard)))
    return found + (_swapped(model, table["residual_rms"]) if fits_badly(model, solution.settings, smoothed) else [])


def _swapped(model: RangeModel, residual: np.ndarray) -> list[Finding]:
    """Sources that seem exchanged in the table; residual: RMS of each (s,), m."""
    pairs = swapped_pairs(model, residual)
    if not pairs:
        return []
    each = ", or ".join(f"{a} and {b}" for a, b in pairs)
    text = f"the positions of {each} seem exchanged: exchanged back, they fit the ranges far better; check `sources`"
    return [Finding("sources_exchanged", text, (FIX,), count=len(pairs))]


def _mirror(out: ResultBuilder, model: RangeModel, solution: RangeSolution) -> list[Finding]:
    """The mirror image in the sources' plane: how much less likely it is, and where it is nearer than 1 sigma."""
    plane, smoothed, other = solution.plane, solution.smoothed, solution.mirrored
    out["/mirror/normal"], out["/mirror/thickness"], out["/mirror/width"] = plane.normal, plane.thickness, plane.width
    if not plane.is_flat:
        return []
    apart = 2.0 * np.abs(plane.distance(smoothed.state[:, :3]))
    across = _root(np.einsum("i,mij,j->m", plane.normal, smoothed.covariance[:, :3, :3], plane.normal))
    near = int(np.sum(apart < across))
    out["/mirror/near_share"] = near / apart.size
    found = []
    flat = (
        f"the sources lie nearly in a plane ({digits(plane.thickness, 2)} m thick, {digits(plane.width)} m wide, 1 "
        f"sigma; normal {plane.normal[0]:+.2f}, {plane.normal[1]:+.2f}, {plane.normal[2]:+.2f})"
    )
    if other is not None:
        less = smoothed.filtered.likelihood - other.filtered.likelihood
        out["/mirror/log_likelihood_ratio"] = less
        tolerance = max(AS_LIKELY, 0.01 * model.data.time.size)
        if less < tolerance:
            text = (
                f"{flat}: the mirror image of the track fits the ranges as well (log-likelihood {-less:+.1f}). The "
                "side is taken that is above, or as the start says; give motion.start where you know it"
            )
            found.append(Finding("mirror_solution", text))
    if near:
        text = f"{flat}: the position is nearer to its mirror image than 1 sigma; which side is not known"
        found.append(Finding("mirror_near", text, count=near, of=apart.size))
    return found


def _reference(
    out: ResultBuilder, study: RangeStudy, track: ReferenceTrack, solution: RangeSolution, last: np.ndarray
) -> list[Finding]:
    """Errors against the reference."""
    model, smoothed = study.model, solution.smoothed
    given = study.scenario.reference
    assert given is not None
    offset = given.time_offset_s
    if offset is None:
        offset = find_time_offset(track, model, smoothed)
    true = track.at(model.data.time[last] - offset)
    out["/reference/position"], out["/reference/time_offset"] = true, float(offset)
    if not np.isfinite(true).any():
        return [Finding("reference", "the reference has no position at the time of a range; check its times")]
    found = []
    for name, output in (("filter", solution.filtered), ("smoother", smoothed)):
        if name == "smoother" and not study.scenario.smoother:
            continue
        rms, mean, unit = errors_against(true, output.state[last], output.covariance[last])
        out[f"/summary/{name}_error_rms"], out[f"/summary/{name}_error_mean"] = rms, mean
        out[f"/summary/{name}_error_z"] = np.sqrt(np.mean(unit**2, axis=0))
        for axis, of_axis in (("horizontal", unit[:, :2]), ("vertical", unit[:, 2:])):
            if sigma_too_small(of_axis):
                text = (
                    f"the {axis} errors of the {name} are {np.sqrt(np.mean(of_axis**2)):.2f} times its sigma (RMS); "
                    f"{TRUE_SIGMA[0]:g} to {TRUE_SIGMA[1]:g} is true, and chance does not explain the difference"
                )
                found.append(Finding("reference_sigma", text, (CONSISTENT,)))
    return found
