"""Table 2 side by side, published and computed: in the terminal, as CSV and Markdown, and the paper's figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from navsim.report import table
from navsim.report.table import Cell, Table, cell, number
from navsim.report.view import View, one_by_one
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("pdop", "hdop", "vdop", "rms_horizontal_m", "rms_vertical_m", "error_horizontal_m")
_HEADS = (
    "PDOP",
    "HDOP",
    "VDOP",
    "RMS of a fix (SKO) horizontal, m",
    "RMS of a fix (SKO) vertical, m",
    "estimation error horizontal, m",
)
NOTES = (
    "Computed under skies found for the table: the paper names no date, almanac, mask or satellite list. No date is "
    "identified by any of them.",
    "Cells are means over the fix epochs from the start of the glide to touchdown. The estimation error is the "
    "root mean square over runs and over 20 s to touchdown; its fix rate and noise of range rates are "
    "fitted to the first row.",
    "HDOP/VDOP is 0.388 and SKO horizontal/vertical 0.390 in every published row: the columns are the PDOP column "
    "times a constant, which a sky with one weak direction does nearly.",
    "The conclusion of the paper calls S = 200 m best for one pseudolite; its own table says S = 1000 m.",
    "The likeliest account of the published DOPs is calibration c: weighted ones, ranges to pseudolites nearly free "
    "of error.",
)


def cells(result: Result, calibration: int) -> tuple[np.ndarray, np.ndarray]:
    """Computed and published cells (8, 6) of one calibration, columns as in COLUMNS; nan where the paper is silent."""
    group = "weighted" if result["/fit/weighted"][calibration] else "table"
    computed = [result[f"/{group}/{name}"][calibration, :, 0] for name in COLUMNS[:3]]
    computed += [result[f"/table/{name.removesuffix('_m')}"][calibration] for name in COLUMNS[3:5]]
    computed.append(result["/table/error_horizontal"][calibration, :, 0])
    published = [result[f"/published/{name.removesuffix('_m')}"] for name in COLUMNS]
    return np.stack(computed, axis=1), np.stack(published, axis=1)


def _published(name: str) -> str:
    """Heading of a published value beside a column, with the unit last."""
    plain = name.removesuffix("_m")
    return f"{plain}_published{name.removeprefix(plain)}"


def csv_text(result: Result, calibration: int) -> str:
    """One calibration as CSV: a row a case, every quantity computed and published."""
    computed, published = cells(result, calibration)
    interval = result["/table/error_horizontal"][calibration]
    quantities = [head for name in COLUMNS for head in (name, _published(name))]
    heads = ["pseudolites", "s_m", "l1_m", *quantities, "error_horizontal_low_m", "error_horizontal_high_m"]
    rows = []
    for i in range(computed.shape[0]):
        place = [int(result["/table/pseudolites"][i]), result["/table/s"][i], result["/table/l1"][i]]
        rows.append([*place, *np.stack([computed[i], published[i]], axis=1).ravel(), *interval[i, 1:]])
    return table.csv_text(heads, rows)


def approach_csv(result: Result) -> str:
    """The numbers behind the figures: PDOP and horizontal error over the approach."""
    counts = [int(n) for n in result["/approach/pseudolites"]]
    heads = ["time_s", *(f"pdop_{n}_pl" for n in counts), *(f"rms_horizontal_{n}_pl_m" for n in counts)]
    curves = [*result["/approach/pdop"], *result["/approach/rms_horizontal"]]
    return table.csv_text(heads, np.column_stack([result["/approach/time"], *curves]))


def case(result: Result, i: int) -> str:
    count = int(result["/table/pseudolites"][i])
    return f"{count} PL {result['/table/s'][i]:g}/{result['/table/l1'][i]:g}" if count else "GNSS alone"


def _side_by_side(computed: float, published: float, digits: int) -> Cell:
    if np.isnan(published):
        return Cell(f"{{:.{digits}f}}", (float(computed),), names=("computed",))
    difference = 100 * (computed / published - 1)
    values = float(published), float(computed), float(difference)
    return Cell(f"{{:g}} → {{:.{digits}f}} ({{:+.1f}} %)", values, names=("published", "computed", "difference"))


def _compared(result: Result, calibration: int, title: str = "") -> Table:
    """Published and computed cells of a calibration."""
    computed, published = cells(result, calibration)
    out = Table(title, ("case", *_HEADS))
    for i, interval in enumerate(result["/table/error_horizontal"][calibration]):
        texts = [
            _side_by_side(c, p, 3 if j == 5 else 2)
            for j, (c, p) in enumerate(zip(computed[i], published[i], strict=True))
        ]
        last = texts.pop()
        names = last.names or ("computed",)
        error = Cell(last.pattern + " [{:.3f}, {:.3f}]", (*last.values, *map(float, interval[1:])),
                     names=(*names, "computed, low", "computed, high"))  # fmt: skip
        out.add(case(result, i), *texts, error)
    return out


def _other_dops(result: Result, calibration: int) -> tuple[str, Table]:
    """DOPs that are not in the table, with their name: weighted ones, or unit-weight ones."""
    weighted = bool(result["/fit/weighted"][calibration])
    group, name = ("table", "unit-weight") if weighted else ("weighted", "weighted")
    out = Table(f"Computed with {name} DOPs", ("case", *_HEADS[:3]))
    for i in range(result["/case"].size):
        out.add(case(result, i), *(number(result[f"/{group}/{dop}"][calibration, i, 0]) for dop in COLUMNS[:3]))
    return name, out


def _fits(result: Result) -> Table:
    heads = ("calibration", "parameters", "DOP rms / max, %", "SKO rms / max, %", "what was fitted")
    out = Table("All calibrations", heads)
    for c, name in enumerate(result["/calibration"]):
        fit = {
            which: 100.0 * float(result[f"/fit/{which}"][c]) for which in ("dop_rms", "dop_max", "sko_rms", "sko_max")
        }
        out.add(
            f"{result['/fit/id'][c]}  {name}",
            cell("{}", int(result["/fit/parameters"][c])),
            cell("{:.1f} / {:.1f}", fit["dop_rms"], fit["dop_max"], names=("rms", "max")),
            cell("{:.1f} / {:.1f}", fit["sko_rms"], fit["sko_max"], names=("rms", "max")),
            str(result["/fit/meaning"][c]),
        )
    return out


def _claims(result: Result) -> Table:
    out = Table("Claims", ("claim", "the paper says", "computed", "why"), lines=True)
    for i, name in enumerate(result["/claims/claim"]):
        verdicts = [
            f"{result['/fit/id'][c]}: {result['/claims/computed'][c, i]}, {'holds' if holds else 'fails'}"
            for c, holds in enumerate(result["/claims/holds"][:, i])
        ]
        out.add(str(name), str(result["/claims/says"][i]), "\n".join(verdicts), str(result["/claims/reason"][i]))
    return out


def contradiction(result: Result) -> str:
    """The inequality that rows 1, 2 and 5 of Table 2 break, in words."""
    least = result.attributes["least_pdop_of_case_6_from_cases_1_and_2"]
    most = result.attributes["largest_pdop_of_case_6_printed"]
    return (
        f"Rows 1, 2 and 5 contradict each other if DOPs have unit weights: under any sky a second pseudolite, 100 m "
        f"from the first, leaves a PDOP of at least {least:.3f} in 2 PL 50/4000, with every rounding in favour. The "
        f"paper prints at most {most:.3f}."
    )


def tables(result: Result) -> list[Table | str]:
    """Everything, for the terminal."""
    title = f"Table 2: published → computed (difference), calibration {result['/fit/id'][0]}"
    notes = "\n".join(f"- {note}" for note in (contradiction(result), *NOTES))
    return [_compared(result, 0, title), _other_dops(result, 0)[1], _fits(result), _claims(result), notes]


def markdown(result: Result) -> str:
    """Everything, as a Markdown page."""
    runs = int(result.variables["/table/error_horizontal"].attributes["runs"])
    lines = [
        "# Table 2 of the landing paper, published and computed",
        "",
        f"Made by `navsim table2`, seed {result.attributes['seed']}, {runs} runs a row. Published → computed.",
        "",
    ]
    for c, name in enumerate(result["/calibration"]):
        lines += [f"## Calibration {result['/fit/id'][c]}: {result['/fit/meaning'][c]} (`{name}`)", ""]
        lines += table.markdown(_compared(result, c))
        which, other = _other_dops(result, c)
        lines += [f"With {which} DOPs:", "", *table.markdown(other)]
    lines += ["## How close", "", *table.markdown(_fits(result))]
    lines += ["## Claims", "", *table.markdown(_claims(result))]
    lines += ["## Notes", "", *(f"- {note}" for note in (contradiction(result), *NOTES)), ""]
    return "\n".join(lines)


def figures(result: Result) -> dict[str, Figure]:
    """The paper's figures 4 and 5: PDOP and horizontal error over the approach for none, one and two pseudolites."""
    from navsim.report.figure_data import settled
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    out = {}
    time = result["/approach/time"]
    for name, path, label in (
        ("pdop", "/approach/pdop", "PDOP"),
        ("rms", "/approach/rms_horizontal", "horizontal RMS error, m"),
    ):
        figure = new_figure(COLUMN, 2.6)
        axes = figure.subplots()
        for values, row, colour in zip(result[path], result["/approach/curve"], COLOURS, strict=False):
            axes.plot(time, values, color=colour, label=case(result, int(row) - 1))
        axes.set_xlim(time[0], time[-1])
        axes.set_ylim(0.0, 1.1 * np.max(result[path][:, settled(time)]))
        axes.set_xlabel("time, s")
        axes.set_ylabel(label)
        legend_above(figure, axes, 3)
        out[name] = figure
    return out


def texts(result: Result, target: Path) -> dict[Path, str]:
    """CSV files and a Markdown page beside the result at `target`."""
    out = {f"{name}.csv": csv_text(result, c) for c, name in enumerate(result["/calibration"])}
    out |= {"table2_approach.csv": approach_csv(result), "table2.md": markdown(result)}
    return {target.with_name(name): text for name, text in out.items()}


VIEW = View(
    one_by_one(tables),
    figures,
    ("/fit", "/claims", "/table"),
    texts=texts,
    verdicts=one_by_one(lambda result: [_claims(result)]),
    drawings="navsim.published_tables.page:table2s",
)
