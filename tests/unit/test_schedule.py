"""The order of events: what a filter may know when it answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navsim.filter.measurement_kinds import ALTITUDE, FIX
from navsim.filter.records import OUTPUT, PASS, TIME_TOLERANCE, Events, schedule

LETTERS = {PASS: "-", OUTPUT: "o", FIX: "f", ALTITUDE: "a"}


def told(events: Events) -> str:
    """`f0 o1 | a3 o2 |`: kinds and rows in order, what is ahead between bars."""
    out, ahead = [], False
    for kind, row, here in zip(events.kind, events.row, events.ahead, strict=True):
        if here != ahead:
            out.append("|")
            ahead = bool(here)
        if kind != PASS:
            out.append(f"{LETTERS[int(kind)]}{row}")
    return " ".join(out)


def test_without_delay_everything_is_in_the_order_of_time() -> None:
    fixes, heights = np.array([1.0, 2.0]), np.array([0.5, 1.0, 1.5])
    events = schedule(np.array([0.0, 1.0, 2.0]), (FIX, fixes, fixes), (ALTITUDE, heights, heights))
    assert told(events) == "o0 a0 f0 a1 o1 a2 f1 o2"


def test_answers_run_ahead_of_late_fixes_with_what_has_come() -> None:
    """Fixes 0.3 s late, heights at once: at 1.3 s the fix of 1.0 s is in the filter, the height of 1.2 s in a copy."""
    fixes, heights = np.array([1.0, 2.0]), np.array([0.9, 1.2, 1.4])
    events = schedule(np.array([1.3, 2.3]), (FIX, fixes, fixes + 0.3), (ALTITUDE, heights, heights))
    assert told(events) == "a0 f0 | a1 o0 | a1 a2 f1 | o1"


def test_outputs_have_times_of_their_own() -> None:
    with pytest.raises(ValueError, match="two outputs have the same time"):
        schedule(np.array([1.0, 1.0]), (FIX, np.array([1.0]), np.array([1.0])))


times = st.lists(st.integers(0, 60), unique=True, max_size=8).map(lambda x: np.sort(np.array(x, dtype=float)) / 10)


@given(times, times, times, st.sampled_from([0.0, 0.3, 1.0]), st.sampled_from([0.0, 0.2]))
def test_each_answer_knows_all_that_had_come_and_no_more(
    outputs: np.ndarray, fixes: np.ndarray, heights: np.ndarray, late: float, less_late: float
) -> None:
    tables = {FIX: (fixes, fixes + late), ALTITUDE: (heights, heights + less_late)}
    events = schedule(outputs, *((kind, *times) for kind, times in tables.items()))
    own: list[tuple[int, int]] = []
    copy: list[tuple[int, int]] = []
    answered = []
    was, at = False, {False: -np.inf, True: -np.inf}
    for time, kind, row, ahead in zip(*(part.tolist() for part in events), strict=True):
        if ahead and not was:
            copy, at[True] = own.copy(), at[False]
        was = ahead
        if kind != PASS or time >= 0.0:  # nobody goes back in time
            assert time >= at[ahead] - TIME_TOLERANCE
            at[ahead] = max(time, at[ahead])
        known = copy if ahead else own
        if kind == OUTPUT:
            answered.append(row)
            due = {
                (k, i)
                for k, (valid, arrival) in tables.items()
                for i in range(valid.size)
                if arrival[i] <= outputs[row] + TIME_TOLERANCE
            }
            assert set(known) == due
            assert len(known) == len(due)
            assert time == outputs[row]
        elif kind != PASS:
            known.append((kind, row))
    assert answered == list(range(outputs.size))
