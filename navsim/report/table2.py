"""Table 2 side by side, published and computed: in the terminal, as CSV and Markdown, and the paper's figures."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from navsim.io.results import Result
from navsim.report.tables import titled_table
from navsim.report.view import View, one_by_one

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType
    from rich.table import Table

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


def csv_text(result: Result, calibration: int) -> str:
    """One calibration as CSV: a row a case, every quantity computed and published."""
    computed, published = cells(result, calibration)
    interval = result["/table/error_horizontal"][calibration]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    quantities = [head for name in COLUMNS for head in (name, f"{name}_published")]
    writer.writerow(["pseudolites", "s_m", "l1_m", *quantities, "error_horizontal_m_low", "error_horizontal_m_high"])
    for i in range(computed.shape[0]):
        place = [_plain(result["/table/s"][i]), _plain(result["/table/l1"][i])]
        values = [_plain(x) for pair in zip(computed[i], published[i], strict=True) for x in pair]
        writer.writerow([int(result["/table/pseudolites"][i]), *place, *values, *map(_plain, interval[i, 1:])])
    return out.getvalue()


def _plain(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.10g}"


def approach_csv(result: Result) -> str:
    """The numbers behind the figures: PDOP and horizontal error over the approach."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    counts = [int(n) for n in result["/approach/pseudolites"]]
    writer.writerow(["time_s", *(f"pdop_{n}_pl" for n in counts), *(f"rms_horizontal_m_{n}_pl" for n in counts)])
    for i, when in enumerate(result["/approach/time"]):
        values = [*result["/approach/pdop"][:, i], *result["/approach/rms_horizontal"][:, i]]
        writer.writerow([_plain(when), *map(_plain, values)])
    return out.getvalue()


def _case(result: Result, i: int) -> str:
    count = int(result["/table/pseudolites"][i])
    return f"{count} PL {result['/table/s'][i]:g}/{result['/table/l1'][i]:g}" if count else "GNSS alone"


def _side_by_side(computed: float, published: float, digits: int) -> str:
    if np.isnan(published):
        return f"{computed:.{digits}f}"
    return f"{published:g} → {computed:.{digits}f} ({100 * (computed / published - 1):+.1f} %)"


def _rows(result: Result, calibration: int) -> list[list[str]]:
    computed, published = cells(result, calibration)
    interval = result["/table/error_horizontal"][calibration]
    rows = []
    for i in range(computed.shape[0]):
        texts = [
            _side_by_side(c, p, 3 if j == 5 else 2)
            for j, (c, p) in enumerate(zip(computed[i], published[i], strict=True))
        ]
        texts[5] += f" [{interval[i, 1]:.3f}, {interval[i, 2]:.3f}]"
        rows.append([_case(result, i), *texts])
    return rows


def _other_dops(result: Result, calibration: int) -> tuple[str, list[list[str]]]:
    """The DOPs that do not stand in the table: weighted ones beside unit-weight ones, or the reverse."""
    weighted = bool(result["/fit/weighted"][calibration])
    group = "table" if weighted else "weighted"
    name = "unit-weight" if weighted else "weighted"
    rows = [
        [_case(result, i), *(f"{result[f'/{group}/{dop}'][calibration, i, 0]:.3f}" for dop in COLUMNS[:3])]
        for i in range(result["/case"].size)
    ]
    return name, rows


def _fit(result: Result, c: int) -> list[str]:
    fit = [f"{100 * result[f'/fit/{name}'][c]:.1f}" for name in ("dop_rms", "dop_max", "sko_rms", "sko_max")]
    return [
        f"{result['/fit/letter'][c]}  {result['/calibration'][c]}",
        str(int(result["/fit/parameters"][c])),
        f"{fit[0]} / {fit[1]}",
        f"{fit[2]} / {fit[3]}",
        str(result["/fit/meaning"][c]),
    ]


_FIT_HEADS = ("calibration", "parameters", "DOP rms / max, %", "SKO rms / max, %", "what was fitted")


def _claims(result: Result) -> list[list[str]]:
    rows = []
    for i, name in enumerate(result["/claims/claim"]):
        verdicts = [
            f"{result['/fit/letter'][c]}: {result['/claims/computed'][c, i]}, {'holds' if holds else 'fails'}"
            for c, holds in enumerate(result["/claims/holds"][:, i])
        ]
        rows.append([str(name), str(result["/claims/says"][i]), "\n".join(verdicts), str(result["/claims/reason"][i])])
    return rows


_CLAIM_HEADS = ("claim", "the paper says", "computed", "why")


def contradiction(result: Result) -> str:
    """The inequality that rows 1, 2 and 5 of Table 2 break, in words."""
    least = result.attributes["least_pdop_of_case_6_from_cases_1_and_2"]
    most = result.attributes["largest_pdop_of_case_6_printed"]
    return (
        f"Two pseudolites in one place obey PDOP2 >= PDOP0 / sqrt(1 + 2 ((PDOP0/PDOP1)^2 - 1)), whatever sky, weights "
        f"and clocks. GNSS alone and 1 PL 50/4000 leave at least {least:.3f} for 2 PL 50/4000, every rounding in "
        f"favour; the paper prints at most {most:.3f}, with its pseudolites 100 m apart, 1° seen from the aircraft."
    )


def console(result: Result) -> RenderableType:
    """Everything, for the terminal."""
    from rich.console import Group

    def table(title: str, heads: tuple[str, ...], rows: list[list[str]], lines: bool = False) -> Table:
        out = titled_table(title, *heads, lines=lines)
        for row in rows:
            out.add_row(*row)
        return out

    name, other = _other_dops(result, 0)
    title = f"Table 2: published → computed (difference), calibration {result['/fit/letter'][0]}"
    return Group(
        table(title, ("case", *_HEADS), _rows(result, 0)),
        table(f"The same with {name} DOPs", ("case", *_HEADS[:3]), other),
        table("All calibrations", _FIT_HEADS, [_fit(result, c) for c in range(result["/calibration"].size)]),
        table("Claims", _CLAIM_HEADS, _claims(result), lines=True),
        "\n".join(f"- {note}" for note in (contradiction(result), *NOTES)),
    )


def markdown(result: Result) -> str:
    """Everything, as a Markdown page."""

    def table(heads: tuple[str, ...], rows: list[list[str]]) -> list[str]:
        lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
        return [*lines, *(f"| {' | '.join(cell.replace(chr(10), '<br>') for cell in row)} |" for row in rows), ""]

    runs = int(result.variables["/table/error_horizontal"].attributes["runs"])
    lines = [
        "# Table 2 of the landing paper, published and computed",
        "",
        f"Made by `navsim table2`, seed {result.attributes['seed']}, {runs} runs a row. Published → computed.",
        "",
    ]
    for c, name in enumerate(result["/calibration"]):
        lines += [f"## Calibration {result['/fit/letter'][c]}: {result['/fit/meaning'][c]} (`{name}`)", ""]
        lines += table(("case", *_HEADS), _rows(result, c))
        other, rows = _other_dops(result, c)
        lines += [f"With {other} DOPs:", "", *table(("case", *_HEADS[:3]), rows)]
    fits = [_fit(result, c) for c in range(result["/calibration"].size)]
    lines += ["## How close", "", *table(_FIT_HEADS, fits)]
    lines += ["## Claims", "", *table(_CLAIM_HEADS, _claims(result))]
    lines += ["## Notes", "", *(f"- {note}" for note in (contradiction(result), *NOTES)), ""]
    return "\n".join(lines)


def figures(result: Result) -> dict[str, Figure]:
    """The paper's figures 4 and 5: PDOP and horizontal error over the approach for none, one and two pseudolites."""
    from navsim.report.figures import COLOURS, COLUMN, legend_above, new_figure, settled

    out = {}
    time = result["/approach/time"]
    for name, path, label in (
        ("pdop", "/approach/pdop", "PDOP"),
        ("rms", "/approach/rms_horizontal", "horizontal RMS error, m"),
    ):
        figure = new_figure(COLUMN, 2.6)
        axes = figure.subplots()
        for values, case, colour in zip(result[path], result["/approach/curve"], COLOURS, strict=False):
            axes.plot(time, values, color=colour, label=_case(result, int(case) - 1))
        axes.set_xlim(time[0], time[-1])
        axes.set_ylim(0.0, 1.1 * np.max(result[path][:, settled(time)]))
        axes.set_xlabel("time, s")
        axes.set_ylabel(label)
        legend_above(figure, axes, 3)
        out[name] = figure
    return out


def texts(result: Result, target: Path) -> dict[Path, str]:
    """CSV files and a page of Markdown beside the result at `target`."""
    out = {f"{name}.csv": csv_text(result, c) for c, name in enumerate(result["/calibration"])}
    out |= {"table2_approach.csv": approach_csv(result), "table2.md": markdown(result)}
    return {target.with_name(name): text for name, text in out.items()}


VIEW = View(one_by_one(console), 170, figures, ("/fit", "/claims", "/table"), texts=texts)
