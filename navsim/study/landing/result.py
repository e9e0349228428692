"""The result tree of a Monte Carlo study of a landing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from navsim.io.findings import kept
from navsim.io.results import Result, Stream, Variable
from navsim.models.systems import CLOCKS
from navsim.study.ensemble import Ensemble
from navsim.study.landing.case import PERCENTILES, Case, rms_window
from navsim.study.landing.ensemble import GATED, LEVELS, UNHEARD, UNSOLVED, findings
from navsim.study.landing.tree import accuracy, base, belief
from navsim.study.statistics import (
    SIGMA_TOLERANCE,
    consistency_band,
    ellipsoid_probability,
    mean_interval,
    rms_interval,
    sigma_error,
    verdict,
)


def result(case: Case, ensemble: Ensemble, seed: int, *, keep: str) -> Result:
    """The result tree of an ensemble that was flown with the same `keep`.

    keep: `all` also stores measurements and fixes of every run, `errors` the filter's errors, `none` the
    statistics alone.
    """
    out = base(case, seed)
    v = out.variables
    runs = np.arange(ensemble.first_run, ensemble.first_run + ensemble.runs)
    v["/run"] = Variable(("run",), runs, "1", "number of the run in the ensemble of the seed")
    if keep == "all":
        _receiver(v, case, ensemble)
        _measurements(v, case, ensemble)
    if keep != "none":
        _filter(v, case, ensemble)
        _aiding(v, case, ensemble, keep == "all")
    _summary(v, case, ensemble)
    v.update(kept(findings(case, ensemble)))
    return out


def _history(
    ensemble: Ensemble, name: str, convert: Callable[[np.ndarray], np.ndarray] = lambda block: block
) -> Stream:
    """A kept history as a stream of blocks along the run axis, never in memory as a whole."""
    first = convert(next(ensemble.blocks(name)))
    return Stream((ensemble.runs, *first.shape[1:]), first.dtype, lambda: map(convert, ensemble.blocks(name)))


def _measurements(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    s = case.world.signals
    v["/measurements/time"] = Variable(("time",), s.time, "s", "fix epochs")
    v["/measurements/source"] = Variable(("source",), np.array(s.names, dtype=object), "1", "names of the sources")
    dims = ("run", "time", "source")
    v["/measurements/pseudorange"] = Variable(dims, _history(ensemble, "pseudorange"), "m", "pseudoranges")
    v["/measurements/range_rate"] = Variable(dims, _history(ensemble, "range_rate"), "m/s", "pseudorange rates")
    cn0 = _history(ensemble, "pseudorange", lambda block: np.broadcast_to(s.cn0, block.shape))
    v["/measurements/cn0"] = Variable(dims, cn0, "dB-Hz", "carrier to noise density ratio")


def _receiver(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    s = case.world.signals
    clocks = sorted(set(s.clock[np.any(s.used, axis=0)].tolist()))
    v["/receiver/clock_name"] = Variable(
        ("clock_name",), np.array([CLOCKS[c] for c in clocks], dtype=object), "1", "time scales"
    )
    dims = ("run", "time")
    v["/receiver/position_llh"] = Variable(
        (*dims, "llh"), _history(ensemble, "fix_llh"), "rad, rad, m", "fixes of the antenna"
    )
    v["/receiver/velocity_ned"] = Variable(
        (*dims, "ned"), _history(ensemble, "fix_velocity"), "m/s", "velocity fixes of the antenna"
    )
    v["/receiver/clock"] = Variable(
        (*dims, "clock_name"),
        _history(ensemble, "fix_clock", lambda block: block[..., clocks]),
        "m",
        "receiver clock against each time scale",
    )


def _filter(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    world, n = case.world, len(case.states)
    v["/filter/time"] = Variable(("time",), world.filter_time, "s", "time 0, then the times the fixes are applied")
    v["/filter/state"] = Variable(
        ("state",),
        np.array(case.states),
        "1",
        "states of the filter",
        {"state_units": ", ".join(case.state_units)},
    )
    mixed = ", ".join(dict.fromkeys(case.state_units))
    v["/filter/error"] = Variable(
        ("run", "time", "state"), _history(ensemble, "error"), mixed, "truth minus estimate, after the update"
    )
    v["/filter/sigma"] = Variable(
        ("run", "time", "state"), _history(ensemble, "sigma"), mixed, "1 sigma of the filter, after the update"
    )
    v["/filter/nees"] = Variable(
        ("run", "time"),
        _history(ensemble, "nees"),
        "1",
        f"normalised estimation error squared, {n} states",
        {"degrees_of_freedom": n},
    )
    v["/filter/nees_position_velocity"] = Variable(
        ("run", "time"), _history(ensemble, "nees_position_velocity"), "1",
        "normalised estimation error squared, position and velocity", {"degrees_of_freedom": 6},
    )  # fmt: skip
    v["/filter/epoch"] = Variable(("epoch",), world.signals.time, "s", "fix epochs, time of validity")
    innovation = _history(ensemble, "innovation_squared")
    v["/filter/innovation_squared"] = Variable(
        ("run", "epoch"), innovation, "1", "normalised innovation squared, nan without a fix",
        {"degrees_of_freedom": int(ensemble.per_run("degrees").max())},
    )  # fmt: skip
    status = _history(ensemble, "status", lambda block: block.astype(np.int8))
    v["/filter/fix_status"] = Variable(("run", "epoch"), status, "1", "0 no fix, 1 used, 2 rejected by the gate")


def _aiding(v: dict[str, Variable], case: Case, ensemble: Ensemble, measured: bool) -> None:
    """What each sensor beside the receiver measured, and what the filter made of it."""
    first = 0
    for aid in case.world.aids:
        branch, part = f"/aiding/{aid.sensor.name}", slice(first, first + aid.time.size)
        first = part.stop

        def of(name: str, part: slice = part, numbers: int = 0, kind: type | None = None) -> Stream:
            def one(block: np.ndarray) -> np.ndarray:
                out = block[:, part, :numbers] if numbers else block[:, part]
                return out if kind is None else out.astype(kind)

            return _history(ensemble, name, one)

        v[f"{branch}/time"] = Variable(("time",), aid.time, "s", "times of the measurements since the epoch")
        if measured:
            v[f"{branch}/number"] = Variable(("number",), np.array(aid.sensor.numbers), "1", "what is measured")
            v[f"{branch}/measured"] = Variable(
                ("run", "time", "number"), of("aided", numbers=aid.exact.shape[1]), aid.sensor.unit, "as measured"
            )
        v[f"{branch}/innovation_squared"] = Variable(
            ("run", "time"), of("aided_squared"), "1", "normalised innovation squared, nan where there is none",
            {"degrees_of_freedom": aid.exact.shape[1]},
        )  # fmt: skip
        v[f"{branch}/status"] = Variable(
            ("run", "time"), of("aided_status", kind=np.int8), "1",
            "0 not used, 1 used, 2 rejected by the gate",
        )  # fmt: skip


def _summary(v: dict[str, Variable], case: Case, ensemble: Ensemble) -> None:
    t = case.world.filter_time
    squares = ensemble.per_run("mean_square")
    at = ensemble.per_run("at_height")
    accuracy(
        v,
        np.stack([rms_interval(squares[:, [i]]) for i in range(9)]),
        np.stack([rms_interval(ensemble.per_run("rpy_square")[:, [i]]) for i in range(3)]),
        rms_interval(squares[:, :2]),
        rms_interval(squares[:, 2:3]),
        np.stack([[rms_interval(at[:, h, [i]] ** 2) for h in range(at.shape[1])] for i in range(3)]),
    )
    belief(v, *(ensemble.per_run(name).mean(axis=0) for name in ("variance", "rpy_variance", "at_variance")))
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}_run"] = Variable(
            ("run", "height"), at[:, :, i], "m", f"{name} position error of each run, truth minus estimate"
        )

    v["/summary/percentile"] = Variable(
        ("percentile",), np.array(PERCENTILES), "1", "percentiles over runs of the size of an error"
    )
    for i, name in enumerate(("lateral", "along", "vertical")):
        v[f"/summary/at/{name}_percentile"] = Variable(
            ("height", "percentile"), np.percentile(np.abs(at[:, :, i]), PERCENTILES, axis=0).T, "m",
            f"percentiles over runs of the size of the {name} position error",
        )  # fmt: skip
    for name, first, last in (("horizontal", 0, 2), ("vertical", 2, 3)):
        size = np.sqrt(squares[:, first:last].sum(axis=1))
        v[f"/summary/rms/{name}_percentile"] = Variable(
            ("percentile",), np.percentile(size, PERCENTILES), "m",
            f"percentiles over runs of the {name} error, root mean square over 20 s to touchdown",
        )  # fmt: skip

    v["/summary/coverage/level"] = Variable(("level",), LEVELS, "1", "size of the ellipsoid in sigmas")
    inside = ensemble.per_run("inside")
    v["/summary/coverage/position"] = Variable(
        ("level", "interval"), np.stack([mean_interval(inside[:, k]) for k in range(LEVELS.size)]), "1",
        "share of outputs after time 0 with the position error inside its ellipsoid",
    )  # fmt: skip
    v["/summary/coverage/expected"] = Variable(
        ("level",), np.array([ellipsoid_probability(k, 3) for k in LEVELS]), "1", "share of a Gaussian error"
    )

    runs, n = ensemble.runs, len(case.states)
    v["/summary/consistency/time"] = Variable(("time",), t, "s", "time of the filter's output")
    most = int(ensemble.per_run("degrees").max())
    for name, degrees, meaning in (
        ("nees", n, f"normalised estimation error squared, {n} states"),
        ("nees_position_velocity", 6, "normalised estimation error squared, position and velocity"),
        ("nis", most, "normalised innovation squared"),
    ):
        low, high = consistency_band(degrees, runs) if degrees else (np.nan, np.nan)
        v[f"/summary/consistency/{name}"] = Variable(
            ("time",), ensemble.mean(name), "1", f"ensemble mean per degree of freedom: {meaning}",
            {"band_low": low, "band_high": high, "degrees_of_freedom": degrees},
        )  # fmt: skip

    band = consistency_band(3, runs)
    groups = ensemble.mean("nees_group")
    v["/summary/consistency/group"] = Variable(
        ("group",), np.array(case.groups, dtype=object), "1", "groups of three states"
    )
    v["/summary/consistency/nees_group"] = Variable(
        ("time", "group"), groups, "1", "ensemble mean per degree of freedom of each group's normalised squared error",
        {"band_low": band[0], "band_high": band[1], "degrees_of_freedom": 3},
    )  # fmt: skip
    window = rms_window(case)
    late = groups[window].mean(axis=0) if window.any() else np.full(len(case.groups), np.nan)
    v["/summary/consistency/mean_group"] = Variable(
        ("group",), late, "1", "mean of nees_group over 20 s to touchdown; one is right"
    )
    off = np.stack([sigma_error(m if runs > 1 else np.nan, band) for m in late])
    v["/summary/consistency/sigma_error"] = Variable(
        ("group", "interval"), off, "1",
        "relative error of the filter's sigma by mean_group, -0.1: 10 % small; interval by the band of a single time",
        {"tolerance": SIGMA_TOLERANCE},
    )  # fmt: skip
    words = [verdict(error) if runs > 1 else "none: a single run" for error in off]
    v["/summary/consistency/verdict"] = Variable(
        ("group",), np.array(words, dtype=object), "1", "what sigma_error says, by its interval and its tolerance"
    )

    for k, aid in enumerate(case.world.aids):
        sums = [ensemble.per_run(f"aided_{name}")[:, k].sum() for name in ("innovations", "weighed", "rejected")]
        nis = float(sums[0] / sums[1]) if sums[1] else np.nan
        branch = f"/summary/aiding/{aid.sensor.name}"
        v[f"{branch}/nis"] = Variable(
            (), nis, "1", "normalised innovation squared per degree of freedom, mean of all runs"
        )
        v[f"{branch}/rejected"] = Variable((), np.int64(sums[2]), "1", "measurements of all runs rejected by the gate")
    for name, value, meaning in (
        ("runs", runs, "number of runs"),
        ("fixes", int(ensemble.per_run("fixes").sum()), "fixes of all runs"),
        ("epochs_without_fix", _flaws(ensemble, UNHEARD, UNSOLVED), "epochs of all runs without a fix"),
        ("rejected", _flaws(ensemble, GATED), "fixes of all runs rejected by the gate"),
    ):
        v[f"/summary/count/{name}"] = Variable((), np.int64(value), "1", meaning)


def _flaws(ensemble: Ensemble, *which: int) -> int:
    """How often these flaws of fix epochs happened in all runs."""
    return int(ensemble.per_run("fix_flaws_count")[:, which].sum(dtype=np.int64))
