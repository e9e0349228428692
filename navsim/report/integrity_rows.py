"""Rows of the monitors: levels, alarms, exclusions, risk."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from navsim.report.result_cells import RANGE, count_cell, setting, share_cell
from navsim.report.table import ABSENT, Cell, Table, cell, number
from navsim.results.priors import GROUP_PRIOR
from navsim.results.result import Result


def _protection(result: Result, name: str) -> Cell | str:
    """A protection level on the glide, with its limit."""
    path = f"/summary/integrity/{name}"
    if path not in result or not np.isfinite(result[path]).all():
        return ABSENT
    mean, low, high = map(float, result[path][:3])
    alert = f"/summary/integrity/{name[0]}al"
    limit = float(result[alert]) if alert in result else np.inf
    if not np.isfinite(limit):
        return Cell("{:.2f}  ({:.2f} - {:.2f})", (mean, low, high), whole=True, names=RANGE)
    return Cell("{:.2f}  ({:.2f} - {:.2f}), limit {:g}", (mean, low, high, limit), whole=True,
                names=(*RANGE, "limit"))  # fmt: skip


def _compared(result: Result, name: str) -> Cell | str:
    """A level of another system's form on the glide."""
    path = f"/summary/integrity/{name}"
    if path not in result or not np.isfinite(result[path]).all():
        return ABSENT
    return Cell("{:.2f}  ({:.2f} - {:.2f})", tuple(map(float, result[path][:3])), whole=True, names=RANGE)


def _level_share(result: Result) -> Cell | str:
    path = "/summary/integrity/level_share"
    return number(float(result[path]), 3) if path in result else ABSENT


def _alarms(result: Result) -> Cell | str:
    if "/summary/integrity/alarms" not in result:
        return ABSENT
    alarms, tested = (int(result[f"/summary/integrity/{name}"]) for name in ("alarms", "tested"))
    return Cell("{} of {}", (alarms, tested), trials=tested, trial="tested epoch", names=("count", "of"))


def _range_noise(result: Result) -> Cell | str:
    """Distribution of the ranging noise if it is not the assumed Gaussian."""
    if "/integrity/hpl" not in result:
        return ABSENT
    section = setting(result, "integrity")
    if "error_model" not in section or section["error_model"] == "gaussian":  # earlier version, or as modelled
        return ABSENT
    noise = section["heavy_tailed"]
    core, tail, share = (float(noise[name]) for name in ("core", "tail", "share"))
    return cell("{:g} σ, {:g} σ of {:g} %", core, tail, 100.0 * share, names=("core", "tail", "share"))


def _exclusions(result: Result) -> Cell | str:
    branch = "/summary/integrity/exclusions"
    if branch not in result:
        return ABSENT
    came = [int(result[f"{branch}_{name}"]) for name in ("correct", "wrong", "needless")]
    return Cell("{}: {}, {}, {}", (int(result[branch]), *came), trials=result["/run"].size,
                names=("count", "correct", "wrong", "needless"))  # fmt: skip


_INTEGRITY = {
    "epochs available": "availability",
    "approaches available throughout": "approaches",
    "continuity risk in 15 s": "continuity_risk",
    "hazardously misleading information": "hmi",
}
"""Labels of shares, and their names in the result."""


def _priors(result: Result) -> Cell | str:
    """Fault probabilities assumed by protection levels."""
    if "/integrity/hpl" not in result:
        return ABSENT
    section = setting(result, "integrity")
    if section["method"] == "chi2":
        return ABSENT
    known = [section.get(f"p_{what}") for what in ("satellite", "constellation", "pseudolite")]
    if None in known:  # of an earlier version
        return ABSENT
    own = dict(section.get("p_constellations") or {})
    on_ground = {"beacon": ("beacons",), "station": ("azimuth_station", "elevation_station", "dme")}
    for name, keys in on_ground.items() if section["method"] == "filter" else ():
        if f"p_{name}" in section and any(setting(result).get(key) is not None for key in keys):
            own[name] = section[f"p_{name}"]
    own |= _groups(result, section)
    values = [one if isinstance(one, str) else float(one) for one in (*known, *own.values())]  # monitoring: a word
    named = ["", "", "", *(f"{name} " for name in own)]
    pattern = ", ".join(name + ("{}" if isinstance(one, str) else "{:.3g}")
                        for name, one in zip(named, values, strict=True))  # fmt: skip
    return Cell(pattern, tuple(values), names=("satellite", "system", "pseudolite", *own))


def _groups(result: Result, section: dict[str, Any]) -> dict[str, float]:
    """Probabilities that all transmitters of a group fail at once; section: `integrity`."""
    if (given := section.get("ground_groups")) is not None:
        return {" + ".join(group["members"]): group["prior"] for group in given}
    kinds = ("pseudolites", "beacons") if section["method"] == "filter" else ("pseudolites",)
    several = [kind for kind in kinds if f"/{kind}/name" in result and result[f"/{kind}/name"].size > 1]
    return {f"all {kind}": GROUP_PRIOR for kind in several}


def integrity_rows(table: Table, results: list[tuple[str, Result]]) -> None:
    """Add the results of the monitor of the fixes, or of the filter."""

    def row(label: str, shown: Callable[[Result], Cell | str]) -> None:
        table.add(f"  {label}", *(shown(result) for _, result in results))

    flown = any("/summary/integrity/alarms" in result for _, result in results)
    asked = any("/summary/integrity/hmi" in result for _, result in results)
    methods = [setting(result, "integrity", "method") for _, result in results if "/integrity/hpl" in result]
    whose = {"filter" if method == "filter" else "fixes" for method in methods}
    title = f"Integrity of the {' or the '.join(sorted(whose))} on the glide"
    table.head(title, *("mean (min - max), m" for _ in results))
    for name in ("hpl", "vpl"):
        row(name.upper(), partial(_protection, name=name))
    for name in ("lateral", "along"):
        row(f"{name} level, runway axes", partial(_protection, name=f"level_{name}"))
    for form, names in (("sbas", ("hpl", "vpl")), ("gbas", ("lpl", "vpl"))):
        if any(f"/summary/integrity/{form}_vpl" in result for _, result in results):
            for name in names:
                row(f"{name.upper()} by the form of {form.upper()}", partial(_compared, name=f"{form}_{name}"))
    if any("/summary/integrity/gbas_vpl_run" in result for _, result in results):
        for name in ("lpl", "vpl"):
            row(f"{name.upper()} by B values, mean of a run", partial(_compared, name=f"gbas_{name}_run"))
        for axis in ("lateral", "vertical"):
            row(f"{axis} error beyond it", partial(share_cell, path=f"/summary/integrity/gbas_exceeded_{axis}"))
    row("share of epochs with levels", _level_share)
    if any(_priors(result) != ABSENT for _, result in results):
        row("prior: satellite, system, pseudolite", _priors)
    if flown:
        row("alarms, of tested epochs", _alarms)
        if any(int(r["/summary/integrity/lost"]) for _, r in results if "/summary/integrity/lost" in r):
            row("alerts without a fix or source", lambda r: count_cell(r, "/summary/integrity/lost"))
        for name in ("horizontal", "vertical"):
            row(f"{name} error beyond its level", partial(share_cell, path=f"/summary/integrity/exceeded_{name}"))
    if any(_range_noise(result) != ABSENT for _, result in results):
        row("noise of ranges", _range_noise)
    if any("/summary/integrity/innovation_share" in result for _, result in results):
        row("epochs with an innovation alarm", lambda r: share_cell(r, "/summary/integrity/innovation_share"))
    if any("/summary/integrity/exclusions" in result for _, result in results):
        row("exclusions: right, wrong, needless", _exclusions)
    if any("/summary/integrity/exclusions_available" in result for _, result in results):
        row("exclusions available", lambda r: share_cell(r, "/summary/integrity/exclusions_available"))
    if asked:
        for label, name in _INTEGRITY.items():
            row(label, partial(share_cell, path=f"/summary/integrity/{name}"))


_LEVEL, _NO_FAULT, _WORST = "level, m", "risk without a fault", "risk given the worst fault"
_TOTAL, _LARGEST = "total risk", "largest risk of a fault"
"""By priors (`mhss`), and without (`chi2`)."""


def tail_rows(table: Table, results: list[tuple[str, Result]]) -> None:
    """Add the sampled probability that errors exceed their levels without an alarm."""
    branch = "/integrity/tails"
    rows = [
        (float(at), str(axis))
        for _, result in results
        if f"{branch}/risk" in result
        for at in result[f"{branch}/at"]
        for axis in result[f"{branch}/axis"]
    ]
    if not rows:
        return
    table.head("Beyond the level without an alarm", *("sampled risk [95 %] (effective samples)" for _ in results))
    for at, axis in dict.fromkeys(rows):
        for part in (_LEVEL, _TOTAL, _LARGEST, _NO_FAULT, _WORST):
            cells = [_tail(result, at, axis, part) for _, result in results]
            if part not in (_TOTAL, _LARGEST) or any(one != ABSENT for one in cells):
                table.add(f"  {at:g} s, {axis}, {part}", *cells)


def _tail(result: Result, at: float, axis: str, part: str) -> Cell | str:
    """At a time and axis: level; total or largest risk, and what is allowed; risk without a fault; of the worst."""
    branch = "/integrity/tails"
    if f"{branch}/risk" not in result or axis not in (axes := list(map(str, result[f"{branch}/axis"]))):
        return ABSENT
    there = np.flatnonzero(result[f"{branch}/at"] == at)
    if not there.size:
        return ABSENT
    e, q = int(there[0]), axes.index(axis)
    level, allowed = float(result[f"{branch}/level"][e, q]), float(result[f"{branch}/allowed"][q])
    risk = result[f"{branch}/risk"][e, q]
    if not np.isfinite(level) or not np.isfinite(risk[1:, 0]).any():
        return ABSENT
    if part == _LEVEL:
        return number(level, 2)
    if part in (_TOTAL, _LARGEST):
        if (part == _LARGEST) != (setting(result, "integrity", "method") == "chi2"):
            return ABSENT
        return Cell("{:.3g}  [{:.3g}, {:.3g}], allowed {:g}", (*map(float, result[f"{branch}/total"][e, q]), allowed),
                    ends=True, names=("risk", "", "", "allowed"))  # fmt: skip
    k = 1 + int(np.nanargmax(risk[1:, 0])) if part == _WORST else 0
    found = (*map(float, risk[k]), float(result[f"{branch}/effective"][e, q, k]))
    if part != _WORST:
        return Cell("{:.3g}  [{:.3g}, {:.3g}]  ({:.0f})", found, ends=True,
                    names=("risk", "", "", "effective samples"))  # fmt: skip
    bias, name = float(result[f"{branch}/bias"][e, q, k]), str(result[f"{branch}/fault"][k])
    names = ("fault", "bias", "risk", "risk, low", "risk, high", "effective samples")
    return Cell("{}, {:.1f} m: {:.3g}  [{:.3g}, {:.3g}]  ({:.0f})", (name, bias, *found), names=names,
                units=("", "m", "1", "1", "1", "1"))  # fmt: skip
