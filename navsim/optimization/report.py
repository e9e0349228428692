"""Report of an optimisation: tables of positions and of the sensitivity of the optimum, plan, accuracy against
number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.report.flown_requirements import flown_requirements, plain_requirements
from navsim.report.requirement_rows import SHARE
from navsim.report.result_cells import setting
from navsim.report.summary_tables import WHITE_ALONE, errors_of
from navsim.report.table import ABSENT, Cell, Table, cell, interval, number
from navsim.report.view import View, one_by_one
from navsim.results.findings import several
from navsim.results.result import Result, scenario_of
from navsim.results.schema import FILTER_QUANTITIES, LARGE, MET, NOT_MET, UNDECIDED
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _range_text(values: np.ndarray) -> Cell | str:
    """Distances by bearing as least and largest; a bearing that area or rules end has no bound."""
    known = values[np.isfinite(values)]
    if not known.size:
        return ABSENT
    pattern = "{:.0f} - {:.0f}" + ("" if known.size == values.size else " *")
    return cell(pattern, float(known.min()), float(known.max()), names=("smallest", "largest"))


def placed(result: Result) -> str:
    """Kind of what is placed: pseudolites, or beacons."""
    return "pseudolites" if scenario_of(result, "study").get("beacons") is None else "beacons"


def site_name(result: Result, k: int) -> str:
    """Name of the k-th of a placement, from 0."""
    return f"{'PL' if placed(result) == 'pseudolites' else 'B'}{k + 1}"


def row_of(result: Result, i: int) -> Cell:
    """The i-th placement in a table: its number of sources, and its cost where the study has costs."""
    count = int(result["/pseudolites"][i])
    if "/pareto/cost" not in result:
        return cell("{}", count)
    power = f" ({result['/pareto/eirp'][i]:g} dBm)" if "/pareto/eirp" in result else ""
    return cell("{} for {:.6g}" + power, count, float(result["/pareto/cost"][i]), names=("number", "cost"))


def row_name(result: Result, i: int) -> str:
    """The i-th placement in words, as in `row_of`."""
    count, power = int(result["/pseudolites"][i]), ""
    if "/pareto/eirp" in result:
        power = f" with {result['/pareto/eirp'][i]:g} dBm"
    cost = f" for {result['/pareto/cost'][i]:.6g}" if "/pareto/cost" in result else ""
    return several(count, placed(result)[:-1]) + cost + power


def tables(result: Result) -> list[Table | str]:
    """The front, and every placement with its neighbourhood."""
    name = str(result.attributes["objective"])
    variable = result.variables["/pareto/objective"]
    none = variable.attributes["without_pseudolites"]
    heads = (placed(result), "objective", "better than none", "PDOP", "HDOP", "VDOP", "tried", "tightest rule")
    judged, costs = "/pareto/met" in result, "/pareto/cost" in result
    more = (*(("on the front",) if costs else ()), *(("requirements",) if judged else ()))
    front = Table(f"{name}: {variable.long_name}", (*heads, *more))
    none_met = (_met(result["/pareto/met_without"]),) if judged else ()
    front.add("0", number(none, 4), *([""] * 6), *(("",) if costs else ()), *none_met)
    for i in range(result["/pseudolites"].size):
        value = result["/pareto/objective"][i]
        # a maximised objective gains in the other direction
        gain = value / none - 1 if name in LARGE else 1 - value / none
        gain = cell("{:.1f} %", float(100 * gain)) if np.isfinite(gain) and np.isfinite(none) else ABSENT
        of = "" if placed(result) == "pseudolites" else "beacons_"
        dops = [number(result[f"/optimum/{of}{dop}"][i]) for dop in ("pdop", "hdop", "vdop")]
        tried = "{} (all)" if result["/pareto/every_choice"][i] else "{}"
        tried += "" if result["/pareto/finished"][i] else " (stopped)"
        margin = result["/optimum/violation"][i]
        room = "none given" if np.isneginf(margin) else _room(result, i, float(-margin))
        evaluations = cell(tried, int(result["/pareto/evaluations"][i]))
        on = (("yes" if result["/pareto/on_front"][i] else "no"),) if costs else ()
        front.add(row_of(result, i), number(value, 4), gain, *dops, evaluations, room, *on,
                  *((_met(result["/pareto/met"][i], runs_verdict(result, i)),) if judged else ()))  # fmt: skip
    if judged:
        front.notes = _fewest(result)
        if costs and np.isfinite(result["/pareto/cheapest"]):
            front.notes += f"; the least cost: {result['/pareto/cheapest']:.6g}"
    front.notes = "\n".join(filter(None, (front.notes, *_ideal(result))))
    losses = [f"{100 * loss:.0f} % within, m" for loss in result["/loss"]]
    axes = ("s", "l1", "up") if "/optimum/up" in result else ("s", "l1")
    places = Table(
        "Positions, and how far each may move before the objective worsens (smallest and largest over directions; "
        "*: up to the limit of area or rules)",
        (
            placed(result),
            "name",
            *(f"{axis}, m" for axis in axes),
            *(("cost",) if costs else ()),
            "latitude, °",
            "longitude, °",
            *losses,
        ),
    )
    for i, count in enumerate(result["/pseudolites"]):
        for k in range(int(count)):
            angles = [number(np.degrees(result[f"/optimum/{axis}"][i, k]), 7) for axis in ("latitude", "longitude")]
            explored = result["/optimum/explored"][i]
            around = result["/optimum/neighbourhood"][i, k]
            reach = [_range_text(row) if explored else "not computed" for row in around]
            where = [number(result[f"/optimum/{axis}"][i, k], 2) for axis in axes]
            cost = [cell("{:.6g}", float(result["/optimum/cost"][i, k]))] if costs else []
            places.add(row_of(result, i), site_name(result, k), *where, *cost, *angles, *reach)
    return [front, *flown(result), *_judged(result), *([requirements(result)] if judged else []), places]


def flown(result: Result) -> list[Table | str]:
    """Runs of the best placements compared with the covariance analysis, and placements that runs contradicted."""
    counts, runs = result["/pseudolites"], result["/flown/runs"]
    if not runs.any():
        return ["No runs have checked the best placements; --runs 200 compares them with the errors of a filter."]
    name = str(result.attributes["objective"])
    of_filter = name in FILTER_QUANTITIES
    heads = (placed(result), *(("covariance analysis", "runs [95 %]") if of_filter else ()), "horizontal, m",
             "vertical, m", "runs")  # fmt: skip
    out = Table("Runs of the best placements (RMS [95 %])", heads)
    for i in range(counts.size):
        errors = [interval(result[f"/flown/{part}"][i], 3) for part in ("horizontal", "vertical")]
        both = (
            [number(result["/pareto/objective"][i], 4), interval(result["/flown/objective"][i], 4)] if of_filter else []
        )
        out.add(row_of(result, i), *both, *(errors if runs[i] else ["not flown"] * 2), cell("{}", int(runs[i])))
    if "/flown/verdict" in result:  # results of before have none
        text = {row_name(result, i): str(result["/flown/verdict"][i]) for i in range(counts.size)}
        out.notes = "\n".join(f"All states, {whose}: {verdict}" for whose, verdict in text.items() if verdict)
    if "/rejected/rejected" not in result:
        return [out]
    against = Table(
        "Rejected: runs contradict the covariance analysis",
        (placed(result), "covariance analysis", "runs [95 %]", "s, l1, m"),
    )
    for i in range(result["/rejected/rejected"].size):
        k = int(result["/rejected/pseudolites"][i])
        at = ", ".join(
            f"({s:.2f}, {l1:.2f})"
            for s, l1 in zip(result["/rejected/s"][i, :k], result["/rejected/l1"][i, :k], strict=True)
        )
        against.add(
            cell("{}", k), number(result["/rejected/analysed"][i], 4), interval(result["/rejected/flown"][i], 4), at
        )
    return [out, against]


def _judged(result: Result) -> list[Table | str]:
    counts = [row_name(result, i) for i in range(result["/pseudolites"].size)]
    return flown_requirements(result, "Requirements of the best placements", counts)


def _room(result: Result, i: int, left: float) -> Cell | str:
    """The rule that is kept with the least room, and that room; results of before do not name it."""
    rule = str(result["/optimum/tightest_rule"][i]) if "/optimum/tightest_rule" in result else ""
    unit = "dB" if rule == "near_far_db" else "m"
    return cell(f"{rule}: {{:.2f}} {unit} left".removeprefix(": "), left)


def _ideal(result: Result) -> list[str]:
    """Notes on pseudolites that have no errors that last, or jam nothing, since the scenario does not say so."""
    if placed(result) == "beacons":
        return []
    interference, errors = scenario_of(result).get("interference"), errors_of(setting(result, "pseudolites"))
    notes = [f"errors of pseudolites: {errors}"] if errors == WHITE_ALONE else []
    if interference is None or interference["pseudolites"] is None:
        text = "without interference.pseudolites, no pseudolite jams the receiver: near-far effects are not simulated"
        notes.append(text)
    return notes


def runs_verdict(result: Result, i: int) -> str:
    """Verdict of the runs of the i-th placement on all requirements; "" without runs."""
    path = "/flown/requirements/verdict"
    each = set(result[path][i].tolist()) if path in result else {""}
    return next(word for word in ("", NOT_MET, UNDECIDED, MET) if word in each)


def _met(flag: np.ndarray, by_runs: str = "") -> str:
    """Whether requirements are met by analysis, and by the runs."""
    if not flag:
        return "not met"
    return "met" if by_runs == MET else "met by analysis"


def _fewest(result: Result) -> str:
    """With how many of what is placed requirements are met by analysis, and the verdicts of runs from there on, in
    words."""
    what, number = placed(result), int(result["/pareto/fewest"])
    if number < 0:
        return f"no placement found meets the requirements, for any number of {what}"
    met = np.flatnonzero((result["/pareto/met"] > 0) & (result["/pseudolites"] >= number))
    runs = "; ".join(f"{row_name(result, i)} {runs_verdict(result, i) or 'not simulated'}" for i in met.tolist())
    text = f"by analysis, the fewest {what} with which the requirements are met: {number}"
    return f"{text}\nby runs: {runs}" if runs else text


def requirements(result: Result) -> Table:
    """Every requirement with each number of pseudolites: verdict, value, and margin."""
    counts = [several(0, placed(result)[:-1]), *(row_name(result, i) for i in range(result["/pseudolites"].size))]
    heads = ("requirement", "limit", *counts)
    out = Table("Requirements by analysis: verdict, value, margin to the required size", heads)
    branch = "/requirements"
    for k, statement in enumerate(result[f"{branch}/statement"]):
        cells = []
        for i in range(len(counts)):
            value, verdict, used = (
                result[f"{branch}/{name}_without"][k] if i == 0 else result[f"{branch}/{name}"][i - 1, k]
                for name in ("value", "verdict", "utilisation")
            )
            cells.append(_fulfilled(str(statement), str(verdict), float(value), float(used)))
        out.add(str(statement), cell("{:g}", float(result[f"{branch}/limit"][k])), *cells)
    if not result[f"{branch}/decided"].all():
        out.notes = "undecided requirements were no constraint; navsim run can decide them"
    return out


def _fulfilled(statement: str, verdict: str, value: float, utilisation: float) -> Cell:
    """A verdict with the value, in per cent if it is a share, and the margin."""
    if np.isnan(value):
        return cell("{}", verdict)
    share = SHARE.search(statement)
    value, shown = (100.0 * value, f"{{}}: {{:share {share[1]}}} %") if share else (value, "{}: {:.4g}")
    if not np.isfinite(utilisation):
        return cell(shown, verdict, value, names=("verdict", "found"))
    margin = 100.0 * (1.0 - utilisation)
    return cell(shown + " (margin {:.1f} %)", verdict, value, margin, names=("verdict", "found", "margin"))


def best_plain(result: Result) -> dict[str, Any]:
    """The optima as plain data."""
    none = float(result.variables["/pareto/objective"].attributes["without_pseudolites"])
    out: dict[str, Any] = {"objective": str(result.attributes["objective"])}
    judged = "/pareto/met" in result
    if judged:
        out["fewest"] = int(result["/pareto/fewest"]) if int(result["/pareto/fewest"]) >= 0 else None
        if "/pareto/cheapest" in result:
            out["cheapest"] = _plain(float(result["/pareto/cheapest"]))
    out["without_pseudolites"] = none if np.isfinite(none) else None
    out["stopped"] = str(result.attributes["stopped"])
    out["placements"] = [
        {
            placed(result): int(count),
            "value": _plain(float(result["/pareto/objective"][i])),
            **_costs_plain(result, i),
            "finished": bool(result["/pareto/finished"][i]),
            "flown": _flown_plain(result, i),
            "sites": [
                {
                    f"{key}_m": float(result[f"/optimum/{axis}"][i, k])
                    for axis, key in (("s", "s"), ("l1", "l1"), ("up", "height"))
                    if f"/optimum/{axis}" in result
                }
                for k in range(int(count))
            ],
            **(
                {
                    "met": bool(result["/pareto/met"][i]),
                    "met_by_runs": runs_verdict(result, i) or None,
                    "requirements": _requirements_plain(result, i),
                }
                if judged
                else {}
            ),
        }
        for i, count in enumerate(result["/pseudolites"])
    ]
    return out


def _costs_plain(result: Result, i: int) -> dict[str, Any]:
    """Cost, power and place on the front of the i-th placement as plain data."""
    if "/pareto/cost" not in result:
        return {}
    power = {"eirp_dbm": float(result["/pareto/eirp"][i])} if "/pareto/eirp" in result else {}
    return {"cost": float(result["/pareto/cost"][i]), "on_front": bool(result["/pareto/on_front"][i])} | power


def _flown_plain(result: Result, i: int) -> dict[str, Any] | None:
    """Runs of the i-th placement as plain data, each with its interval; None without runs."""
    runs = int(result["/flown/runs"][i])
    if not runs:
        return None
    names = ("objective", "horizontal", "vertical")
    errors = {name: [_plain(float(x)) for x in result[f"/flown/{name}"][i]] for name in names}
    verdict = {"verdict": str(result["/flown/verdict"][i])} if "/flown/verdict" in result else {}
    return {"runs": runs} | errors | verdict | plain_requirements(result, i)


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _requirements_plain(result: Result, i: int) -> list[dict[str, Any]]:
    """Every requirement with the i-th placement as plain data."""
    branch = "/requirements"
    return [
        {
            "statement": str(statement),
            "verdict": str(result[f"{branch}/verdict"][i, k]),
            "limit": float(result[f"{branch}/limit"][k]),
            "value": _plain(float(result[f"{branch}/value"][i, k])),
            "utilisation": _plain(float(result[f"{branch}/utilisation"][i, k])),
        }
        for k, statement in enumerate(result[f"{branch}/statement"])
    ]


_NEAR = 1.0
"""Distance from the border of its area within which a pseudolite counts as on the border, m."""


def _on_border(result: Result, i: int) -> list[str]:
    """Pseudolites of the i-th placement that the area alone keeps from going farther."""
    area = scenario_of(result, "study").get("area")
    if area is None:
        return []
    out = []
    for k in range(int(result["/pseudolites"][i])):
        place = {"s_m": result["/optimum/s"][i, k], "l1_m": result["/optimum/l1"][i, k]}
        if any(abs(place[key] - end) <= _NEAR for key in place for end in area[key]):
            out.append(site_name(result, k))
    return out


def plan_rows(result: Result) -> list[int]:
    """The placements that plans show: all, or with costs those that have a map, if there is one."""
    computed = result["/map/computed"] > 0
    some = computed if "/pareto/cost" in result and computed.any() else np.full(computed.size, True)
    return [int(i) for i in np.flatnonzero(some)]


def plan_title(result: Result, i: int) -> str:
    """Objective of the i-th placement, with notes."""
    many = row_name(result, i)
    stopped = "" if result["/pareto/finished"][i] else " (search stopped)"
    border = _on_border(result, i)
    where = f"; on the border of the area: {', '.join(border)}" if border else ""
    met = f"; requirements {_met(result['/pareto/met'][i])}" if "/pareto/met" in result else ""
    computed = "" if result["/map/computed"][i] or not result["/map/computed"].any() else "; map not computed"
    return f"{many}: {digits(result['/pareto/objective'][i], 4)}{met}{stopped}{where}{computed}"


def label(result: Result) -> str:
    """Name of the objective, with its unit."""
    variable = result.variables["/pareto/objective"]
    return variable.long_name + ("" if variable.units == "1" else f", {variable.units}")


@dataclass(frozen=True)
class Front:
    """Accuracy against what it takes, for the drawing and the page; points by number of sources, or by cost."""

    label: str
    x: np.ndarray
    """(n,) number of sources, or cost; the first is without any if that has a value."""
    value: np.ndarray
    met: np.ndarray | None
    """(n,) bool, whether requirements are met; None without requirements."""
    finished: np.ndarray
    """(n,) bool."""
    line: np.ndarray
    """Indices of the points that a line joins, from left to right: with costs those on the front."""
    names: list[str]
    """Numbers of sources, where x is the cost."""
    flown: np.ndarray
    """(f,) x of those that runs check: an error of the filter."""
    runs: np.ndarray
    """(f, 3) RMS of the runs, with its 95 % interval."""


def _spent(result: Result) -> np.ndarray:
    """Numbers of what is placed, or costs where the study has them."""
    return result["/pareto/cost"] if "/pareto/cost" in result else result["/pseudolites"].astype(int)


def flown_points(result: Result) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of what is placed, or costs, and what the runs of the best placements found: RMS with its 95 % interval
    (n, 3). Empty where the objective is no error of a filter, which runs cannot check."""
    errors = result["/flown/objective"]
    there = (result["/flown/runs"] > 0) & np.isfinite(errors).all(axis=1)
    there &= str(result.attributes["objective"]) in FILTER_QUANTITIES
    return _spent(result)[there], errors[there]


def front_of(result: Result) -> Front:
    """The points of the front."""
    none = float(result.variables["/pareto/objective"].attributes["without_pseudolites"])
    x, counts, costs = _spent(result), result["/pseudolites"].astype(int), "/pareto/cost" in result
    met = result["/pareto/met"].astype(bool) if "/pareto/met" in result else None
    value, finished = result["/pareto/objective"], result["/pareto/finished"] > 0
    joined = result["/pareto/on_front"] > 0 if costs else np.full(x.size, True)
    if np.isfinite(none):
        x, value, finished = np.append(0, x), np.append(none, value), np.append(True, finished)
        met = None if met is None else np.append(bool(result["/pareto/met_without"]), met)
        joined, counts = np.append(met is None or met[0] or not costs, joined), np.append(0, counts)
    line = np.flatnonzero(joined)
    line = line[np.argsort(x[line], kind="stable")]
    label = f"cost of the {placed(result)}" if costs else placed(result)
    return Front(label, x, value, met, finished, line, list(map(str, counts)) if costs else [],
                 *flown_points(result))  # fmt: skip


def used(result: Result) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Numbers of pseudolites (n,), decided requirements, and utilisation of each (n, r), nan if it is not finite."""
    branch = "/requirements"
    chosen = np.flatnonzero(result[f"{branch}/decided"])
    counts = np.append(0, result["/pseudolites"].astype(int))
    taken = np.vstack([result[f"{branch}/utilisation_without"][None], result[f"{branch}/utilisation"]])[:, chosen]
    return counts, [str(result[f"{branch}/statement"][k]) for k in chosen], np.where(np.isfinite(taken), taken, np.nan)


def plan(result: Result) -> Figure:
    """For each number of pseudolites: the placement over the objective with the first one moved."""
    from matplotlib.patches import Rectangle

    from navsim.report.figures import label_points, legend_above, ridge_lines, view_from_above
    from navsim.report.printing import COLUMN, new_figure
    from navsim.report.ridges import shown_ridges

    rows, counts = plan_rows(result), result["/pseudolites"]
    s, l1, maps = result["/map/s"], result["/map/l1"], result["/map/objective"]
    across, along = s[-1] - s[0], l1[-1] - l1[0]
    height = min(2.7, max(1.3, 5.5 * across / max(along, 1.0)))
    fig = new_figure(2 * COLUMN, 0.8 + height * len(rows))
    axes = fig.subplots(len(rows), 1, squeeze=False, sharex=True)[:, 0]
    large = str(result.attributes["objective"]) in LARGE
    for i, ax in zip(rows, axes, strict=True):
        finite = maps[i][np.isfinite(maps[i])]
        if finite.size:
            shown = np.ma.masked_invalid(maps[i])
            image = ax.pcolormesh(
                -l1, s, shown, shading="nearest", cmap="viridis" if large else "viridis_r",
                vmin=np.percentile(finite, 5 if large else 0), vmax=np.percentile(finite, 100 if large else 95),
                rasterized=True,
            )  # fmt: skip
            fig.colorbar(image, ax=ax, label=label(result), extend="min" if large else "max")
        if finite.size and "/map/seen" in result and np.ptp(result["/map/seen"]) > 0.0:
            levels = ax.contour(-l1, s, result["/map/seen"], levels=[0.5, 0.999], colors="white", linewidths=0.8)
            ax.clabel(levels, fmt={0.5: "seen 50 %", 0.999: "100 %"}, fontsize=6)
        x, y = -result["/optimum/l1"][i], result["/optimum/s"][i]
        ax.plot(x, y, "*", color="#D55E00", ms=9, mec="white", mew=0.6, ls="", label=placed(result),
                clip_on=False, zorder=5)  # fmt: skip
        ends = [0.0, setting(result, "runway", "length_m")]
        ax.plot(ends, [0.0, 0.0], color="black", lw=3, solid_capstyle="butt", label="runway")
        computed, count = bool(result["/map/computed"][i]), int(counts[i])
        ax.set_title(plan_title(result, i))
        ax.set_ylabel("right of the axis, m")
        ax.update_datalim([(-l1[-1], s[0]), (-l1[0], s[-1])])
        if computed:
            ax.set_facecolor("#dddddd")
        else:
            area = Rectangle((-l1[-1], s[0]), along, across, fill=False, ec="#777777", ls="--", lw=0.8)
            ax.add_patch(area)
            area.set_label("area of the search")
        ax.grid(visible=not computed)
        ax.margins(0.03)
        ridge_lines(ax, shown_ridges(result), ax.get_xlim(), ax.get_ylim())
        view_from_above(ax)
        label_points(ax, (site_name(result, k) for k in range(count)), x[:count], y[:count])
    mapped = np.isfinite(maps).any()
    others = ", the others kept" if counts.max() > 1 else ""
    stopped = str(result.attributes["stopped"])
    unmapped = "maps not computed" + (f" (stopped: {stopped})" if stopped else "")
    legend_above(fig, axes[0], 3, f"colours: {site_name(result, 0)} moved{others}" if mapped else unmapped)
    unmet = ", or requirements not met" if "/pareto/met" in result else ""
    grey = f"; grey: not allowed, or no value{unmet}" if mapped else ""
    axes[-1].set_xlabel(f"beyond the threshold (= -l1), m{grey}")
    return fig


def front(result: Result) -> Figure:
    """The objective against the number of pseudolites, or against their cost, each point with its number."""
    from navsim.report.figures import label_points, legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(COLUMN, 2.4)
    ax = fig.subplots()
    of = front_of(result)
    ax.plot(of.x[of.line], of.value[of.line], "o-", color=COLOURS[0], ms=4,
            label="by covariance analysis" if of.flown.size else None)  # fmt: skip
    others = np.setdiff1d(np.arange(of.x.size), of.line)
    if others.size:
        ax.plot(of.x[others], of.value[others], "o", color=COLOURS[0], mfc="white", ms=4, label="not on the front")
    if of.flown.size:
        reach = np.abs(of.runs[:, 1:] - of.runs[:, :1]).T
        ax.errorbar(of.flown, of.runs[:, 0], reach, fmt="s", color=COLOURS[1], ms=3, capsize=3, lw=0.9,
                    label="by runs, with 95 % interval")  # fmt: skip
    title = None
    if not of.finished.all():
        hollow: dict[str, Any] = {"color": COLOURS[0], "mfc": "white", "ms": 5, "label": "search stopped"}
        ax.plot(of.x[~of.finished], of.value[~of.finished], "o", **hollow)
    if (met := of.met) is not None:
        ax.plot(of.x[~met], of.value[~met], "x", color=COLOURS[1], ms=9, label="requirements not met", clip_on=False)
        fewest = int(result["/pareto/fewest"])
        title = f"requirements met by analysis with {fewest}" if fewest >= 0 else "requirements met with none"
    legend_above(fig, ax, 1, title)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(of.label)
    ax.set_ylabel(label(result))
    if of.names:
        label_points(ax, of.names, of.x, of.value)
    else:
        ax.set_xticks(of.x)
    return fig


def utilisation(result: Result) -> Figure:
    """Utilisation of each decided requirement against the number of pseudolites."""
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLUMN, marked, new_figure

    counts, names, taken = used(result)
    statements = names
    fig = new_figure(1.3 * COLUMN, 2.6 + 0.17 * len(statements))
    ax = fig.subplots()
    for i, statement in enumerate(statements):
        ax.plot(counts, taken[:, i], "-", **marked(i), ms=5, mfc="none",
                label=statement)  # fmt: skip
    ax.axhline(1.0, color="black", lw=0.9, ls="--", label="limit: met below")
    ax.set_xticks(counts)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(placed(result))
    ax.set_ylabel("size kept as often as required,\nrelative to the required size")
    legend_above(fig, ax, 1)
    return fig


def figures(result: Result) -> dict[str, Figure]:
    """The plan, the front, and what becomes of requirements."""
    out = {"plan": plan(result), "front": front(result)}
    return out | ({"requirements": utilisation(result)} if "/pareto/met" in result else {})


def _verdicts(result: Result) -> list[Table | str]:
    return [*_judged(result), *([requirements(result)] if "/pareto/met" in result else [])]


VIEW = View(
    one_by_one(tables),
    figures,
    more=best_plain,
    verdicts=one_by_one(_verdicts),
    drawings="navsim.optimization.page:optima",
)
