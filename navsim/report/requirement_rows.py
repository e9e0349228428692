"""Rows of the verdicts on requirements."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from navsim.report.consistency_rows import VERDICT, state_verdict
from navsim.report.result_cells import setting, single
from navsim.report.table import ABSENT, Cell, Table, cell
from navsim.results.result import Result
from navsim.results.schema import VERDICTS

_MONITORED = {
    "level", "emt", "accuracy", "availability", "approaches", "continuity", "misleading", "time_to_alert",
}  # fmt: skip
"""Requirements on what the integrity monitor says."""
SHARE = re.compile(r"(\S+) % of (runs|epochs|approaches)")
"""The size, %, and the noun of a requirement on a share."""


def _monitored(result: Result) -> str:
    """What the monitor of a result watches: the fixes, or the filter."""
    section = setting(result).get("integrity")
    return ABSENT if section is None else "of the filter" if section["method"] == "filter" else "of the fixes alone"


def requirements(table: Table, results: Sequence[tuple[str, Result]]) -> None:
    """Add a verdict on each requirement, if any."""
    branch = "/summary/requirements"
    asked = [result for _, result in results if f"{branch}/verdict" in result]
    if not asked:
        return
    table.head("Requirements", *(_found(result) for _, result in results))
    if _MONITORED & {str(what) for result in asked if f"{branch}/what" in result for what in result[f"{branch}/what"]}:
        table.add("  levels, accuracy, alarms, risks", *(_monitored(result) for _, result in results))
    for statement in dict.fromkeys(str(text) for result in asked for text in result[f"{branch}/statement"]):
        table.add(f"  {statement}", *(_verdict(result, statement) for _, result in results))
        plain = [_verdict(result, statement, "plain_") for _, result in results]
        if any(each != ABSENT for each in plain):
            table.add("    by the runs alone", *plain)


def _found(result: Result) -> str:
    """What the cells of a result's verdicts contain. Covariance analysis has neither intervals nor runs."""
    if str(result.attributes["method"]) == "covariance":
        return "verdict: value"
    return f"verdict: value{'' if single(result) else ' [95 %]'}; for a new study: more runs: verdict"


def verdicts(results: Sequence[tuple[str, Result]]) -> list[Table | str]:
    """Verdicts on requirements, and on the filter's sigmas if there are runs."""
    out = Table("", ("", *(name for name, _ in results)), caption="Verdicts on requirements")
    requirements(out, results)
    if any(VERDICT in result for _, result in results):
        out.head("Sigma of every state", *("" for _ in results))
        out.add("  all states", *(state_verdict(result) for _, result in results))
    return [out] if out.rows else []


def _verdict(result: Result, statement: str, of: str = "") -> Cell | str:
    """A verdict on a requirement; of: "plain_" for that of the runs alone, if the other is by control variates."""
    branch = "/summary/requirements"
    text = [] if f"{branch}/{of}verdict" not in result else [str(text) for text in result[f"{branch}/statement"]]
    if statement not in text:
        return ABSENT
    i = text.index(statement)
    word, interval = str(result[f"{branch}/{of}verdict"][i]), result[f"{branch}/{of}value"][i]
    if not word:
        return ABSENT
    more = float("nan") if of else float(result[f"{branch}/more_runs"][i])
    limit, method = float(result[f"{branch}/limit"][i]), str(result.attributes["method"])
    out = verdict_cell(statement, word, interval, more, limit, single(result), method)
    how = ""
    if method == "covariance" and np.isfinite(interval[0]):
        how = ", by analysis"
    elif not of and f"{branch}/plain_verdict" in result and str(result[f"{branch}/plain_verdict"][i]):
        how = ", by control variates"
    return replace(out, pattern=out.pattern + how)


def verdict_cell(
    statement: str, word: str, interval: np.ndarray, more: float, limit: float, one_run: bool = False, method: str = ""
) -> Cell:
    """A verdict on a requirement with the value and its interval (3,), and the number of runs that would decide it.

    limit: required; a lower limit of a share in the statement, an upper one of everything else. Shares are in per cent,
    as in the statement of the requirement. method: of the result. Runs evaluate every requirement, unless no run or
    epoch of theirs counts for it.
    """
    share = SHARE.search(statement)
    value, low, high = (100.0 * float(x) if share else float(x) for x in interval)
    if np.isnan(value):
        why = "no run or epoch counts" if method == "monte-carlo" else "not evaluated by this method"
        return cell(f"{{}}: {why}", word)
    number = f"{more:.2g}".replace("e+0", "e") if more >= 1e5 else f"{more:.0f}"
    met = interval[0] >= limit if share else interval[0] <= limit
    then = VERDICTS[-1] if met else VERDICTS[0]
    enough = f"; {number} more run{'' if number == '1' else 's'}: {then}" if np.isfinite(more) else ""
    digits = f"share {share[1]}" if share else ".4g"
    what = "landings" if share and share[2] == "runs" and method == "covariance" else share and share[2]
    shown = f"{{}}: {{:{digits}}}" + (f" % of {what}" if share else "")
    if low == high or np.isnan(low) or one_run:
        return cell(shown + enough, word, value, names=("verdict", "found"))
    return cell(f"{shown}  [{{:{digits}}}, {{:{digits}}}]{enough}", word, value, low, high,
                names=("verdict", "found", "found, low", "found, high"))  # fmt: skip
