"""Drawings of Table 2, and of the table of few satellites."""

from __future__ import annotations

from collections.abc import Sequence

from bokeh.models import FactorRange

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.published_tables import integrity_table_report as integrity_table
from navsim.published_tables import table2_report as table2
from navsim.report.figure_data import settled


def table2s(results: Sequence[Named]) -> list[Drawing]:
    """Drawings of Table 2: the paper's figures 4 and 5."""
    panels, keys, thinned = [], [], []
    for name, result in results:
        time = result["/approach/time"]
        which = plots.thin(time.size, 1000)
        thinned.append(which)
        for path, label in (("/approach/pdop", "PDOP"), ("/approach/rms_horizontal", "horizontal RMS error, m")):
            on = plots.plot(name if len(results) > 1 else "", "time, s", label, 300)
            marks = []
            for i, (values, case) in enumerate(zip(result[path], result["/approach/curve"], strict=True)):
                text = table2.case(result, int(case) - 1)
                keys.append(Key(text, plots.colour(i)))
                marks.append(
                    plots.line(on, plots.source(x=which(time), y=which(values)), "y", plots.colour(i), name=text)
                )
            plots.extend_y_axis(on, [result[path][:, settled(time)]])
            plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), (label, "@y{0.000}"))
            panels.append(on)
    caption = (
        "PDOP and horizontal error over the approach for none, one and two pseudolites: the paper's figures 4 and 5."
    )
    caption += plots.most_thinned(thinned).caption("epoch")
    return [Drawing("approach", "Over the approach", panels, caption, list(dict.fromkeys(keys)))]


def few_satellites(results: Sequence[Named]) -> list[Drawing]:
    """Drawing of the table of few satellites: usefulness of levels as colours."""
    panels = []
    mapper = plots.colour_map(0.0, 1.0)
    for name, result in results:
        rows = [f"{n} pseudolites" for n in result["/pseudolites"]][::-1]
        columns = [str(n) for n in result["/satellites"]]
        for path, text in (("worst", "worst subset"), ("median", "median subset")):
            title = f"{text.capitalize()}{f', {name}' if len(results) > 1 else ''}"
            on = plots.plot(title, "satellites", "", 240, x_range=FactorRange(*columns), y_range=FactorRange(*rows))
            drawn = plots.cells(on, rows, columns, result[f"/subsets/{path}"][::-1], "{:.2f}", mapper)
            plots.hover_text(on, [drawn], ("satellites", "@x"), ("", "@y"), ("share", "@value{0.000}"))
            panels.append(on)
    text = "; ".join(dict.fromkeys(integrity_table.limits(result) for _, result in results))
    caption = f"Share of epochs of the glide with {text}: 1 always, 0 never."
    return [Drawing("useful", "How useful levels are", panels, caption)]
