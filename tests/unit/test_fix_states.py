"""Fixes with a state: the chain against its closed form, flags, forced states, and the filters that take them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from navsim.compiler.lanes import WIDTH
from navsim.filter.records import NOT_USED, USED
from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss.fix_states import DIFFERENTIAL, FIXED, FLOAT, SINGLE, WRONG, FixStates, ForcedState, StateHistory
from navsim.landing.result import result as summarised
from navsim.landing.study import fly_all
from navsim.report.summary_tables import summary_table
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.simulation.landing import fly
from navsim.simulation.run_inputs import draw_inputs
from tests.conftest import Within
from tests.helpers import case, scenario
from tests.layout import as_declared

STATED = ("receiver.fix_states={}", "signals={}", "receiver.rate_hz=1", "duration_s=61", "filter.kind=eskf")


def chain() -> FixStates:
    """Fixed leads to float (80 %) or wrong (20 %), and each of these two back; differential and single are never
    reached."""
    following = np.zeros((5, 5))
    following[FIXED, [FLOAT, WRONG]] = 0.8, 0.2
    following[[FLOAT, WRONG, DIFFERENTIAL, SINGLE], FIXED] = 1.0
    noise = np.array([[0.01, 0.02, 0.03], [0.1, 0.2, 0.1], [0.5, 1.0, 0.1], [1.0, 2.0, 0.1], [0.01, 0.02, 0.03]])
    lasting = np.array([[0.0, 0.0], [0.3, 0.6], [1.0, 1.0], [1.0, 2.0], [1.0, 5.0]])
    return FixStates(np.array([60.0, 15.0, 9.0, 9.0, 40.0]), following, noise, lasting, 2.0)


@pytest.mark.validates("shares of the states of a receiver", "the stationary distribution in closed form", value="2e-2")
def test_shares_of_the_states(within: Within) -> None:
    """Visits are 1 : 0.8 : 0.2, so times are 60 : 12 : 8. Time averages of a long chain tend to them."""
    found = chain()
    np.testing.assert_allclose(found.shares, np.array([60.0, 12.0, 0.0, 0.0, 8.0]) / 80.0, atol=1e-12)
    begins, states = found.path(np.random.default_rng(3), 4e5)
    lasts = np.diff(begins, append=4e5)
    assert np.bincount(states, lasts, 5) / 4e5 == pytest.approx(found.shares, abs=within["value"])
    assert lasts[states == FIXED].mean() == pytest.approx(60.0, rel=0.05)
    assert not (states[1:] == states[:-1]).any()


def test_histories_that_have_a_state_at_a_time() -> None:
    """Before and after it the chain is where the exponential of its rates, and Bayes' theorem, say. It may last until
    another time."""
    found, since, until, draws = chain(), 25.0, 32.0, 2000
    rates = (found.following - np.eye(5)) / found.mean_time[:, None]
    rng = np.random.default_rng(7)
    times = np.array([5.0, since, 60.0])
    histories = [found.unforced(rng, 60.0, WRONG, since, until) for _ in range(draws)]
    states = np.array([history.state[history.at(times)] for history in histories])
    assert (states[:, 1] == WRONG).all()
    assert not np.diff([history.at(np.array([since, until])) for history in histories]).any()
    before = found.shares * expm(20.0 * rates)[:, WRONG] / found.shares[WRONG]
    for column, expected in ((0, before), (2, expm(28.0 * rates)[WRONG])):
        share = np.bincount(states[:, column], minlength=5) / draws
        assert np.abs(share - expected).max() < 4.0 * 0.5 / np.sqrt(draws)


def test_what_a_receiver_reports() -> None:
    """Wrong fixes are flagged as fixed, flags are late, errors last as long as a state, noise is that of the state."""
    found = chain()
    time = np.arange(0.0, 4000.0, 1.0)
    rngs, white = ((np.random.default_rng(k),) for k in (1, 2))
    state, flag, error, _ = found.drawn(rngs, white, time, 2)
    np.testing.assert_array_equal(state[:, 0], state[:, 1])
    late = np.concatenate([state[:1, 0], state[:1, 0], state[:-2, 0]])
    np.testing.assert_array_equal(flag[:, 0], np.where(late == WRONG, FIXED, late))
    quiet = replace(found, noise=np.zeros((5, 3)), flag_delay=0.0)
    rngs, white = ((np.random.default_rng(k),) for k in (1, 2))
    lasting = quiet.drawn(rngs, white, time, 1).error[:, 2, 0]
    same = state[1:, 0] == state[:-1, 0]
    assert not np.diff(lasting)[same].any()
    assert np.abs(lasting[state[:, 0] == WRONG]).max() > 2.0
    for number in (FIXED, FLOAT):
        here = state[:, 0] == number
        assert np.std(error[here, 2, 0] - lasting[here]) == pytest.approx(found.noise[number, 1], rel=0.1)


def test_what_a_gate_rejects_after_a_wrong_fix() -> None:
    """Three fixes at each change; one after them takes the filter there, unless it is a float one, which has little
    weight. Without a wrong state nothing is rejected."""
    begins, states = np.array([0.0, 2.0, 10.0, 20.0]), np.array([FIXED, WRONG, FLOAT, FIXED])
    found = chain().rejected(StateHistory(begins, states), np.arange(26.0), 3)
    assert np.flatnonzero(found).tolist() == [2, 3, 4, 10, 11, 12, 14, 15, 16, 18, 19, 20]
    assert not chain().rejected(StateHistory(begins, np.array([FIXED, SINGLE, FLOAT, FIXED])), begins, 3).any()


def test_forced_states() -> None:
    """They take the place of what was drawn; afterwards the chain is where it would have been."""
    forced = ForcedState(WRONG, 10.0, 30.0, np.array([0.0, 1.0, -6.0]))
    time = np.arange(0.0, 60.0, 0.5)
    own, with_it = (
        replace(chain(), noise=np.zeros((5, 3)), forced=f).drawn(
            (np.random.default_rng(5),), (np.random.default_rng(6),), time, 1
        )
        for f in ((), (forced,))
    )
    during = (time >= 10.0) & (time < 30.0)
    assert (with_it.state[during, 0] == WRONG).all()
    np.testing.assert_allclose(with_it.error[during, :3, 0], np.tile([0.0, 1.0, -6.0], (during.sum(), 1)))
    np.testing.assert_array_equal(with_it.state[~during], own.state[~during])


@pytest.mark.parametrize("further", [(), ("approach.guidance=estimate",)])
def test_fixes_have_the_errors_of_their_state(further: tuple[str, ...]) -> None:
    one = case(*STATED, *further)
    stated = draw_inputs(one.flight, 1, range(WIDTH)).stated
    assert stated is not None
    runs = fly(one.flight, 1, range(1))
    np.testing.assert_array_equal(runs.fix_state[0], stated.state[:, 0])
    antenna = llh_from_ecef(runs.antenna[0]) if further else llh_from_ecef(one.shared.signals.antenna)
    np.testing.assert_allclose(antenna[:, 2] - runs.fix_llh[0, :, 2], stated.error[:, 2, 0], atol=1e-6)
    assert (runs.status[0] == USED).mean() > 0.9


def test_states_keep_the_defaults_of_what_is_left_out() -> None:
    section = scenario(*STATED[1:], "receiver.fix_states={float: {mean_s: 7}}").receiver.fix_states
    assert section is not None
    found, default = section.model(), type(section)().model()
    assert found.mean_time[FLOAT] == 7.0
    np.testing.assert_array_equal(found.noise, default.noise)
    np.testing.assert_array_equal(found.following, default.following)
    assert default.shares.sum() == pytest.approx(1.0)


def test_filters_by_the_flag() -> None:
    """One that uses fixed ones alone does without the others, and is not blamed for it."""
    parts = "{state: fixed, at_s: 0, until_s: 30}, {state: single, at_s: 30, until_s: 61}"
    forced = f"receiver.fix_states={{forced: [{parts}]}}"
    settings = (*STATED[1:], forced)
    sigma = {}
    for how in ("believe", "ignore", "fixed-only"):
        one = case(*settings, f"filter.fix_flag={how}")
        ensemble = fly_all(one, 1, 0, 4, threads(1), keep="all")
        found = summarised(one, ensemble, 1, keep="all")
        as_declared(found)
        used = found["/filter/fix_status"] != NOT_USED
        late = found["/filter/epoch"] >= 30.0
        assert used[:, ~late].all()
        assert used[:, late].all() == (how != "fixed-only")
        assert "/findings/unweighed_fixes" not in found
        sigma[how] = found["/filter/sigma"][0, 20, 2], found["/filter/sigma"][0, -4, 2]
    assert sigma["ignore"][0] > 2.0 * sigma["believe"][0]
    assert sigma["fixed-only"][1] > sigma["believe"][1] > sigma["ignore"][1]
    assert found["/summary/fix_states/share"][:, 0] == pytest.approx([29 / 61, 0.0, 0.0, 32 / 61, 0.0], abs=0.02)
    table = str(summary_table([("", found)]))
    assert "States of the fixes" in table
    assert "not used: fixes have errors of their state" in table
    assert "Fix, RMS by its covariance" not in table


@pytest.mark.parametrize(("settings", "key"), [
    (("filter.fix_flag=ignore",), "fix_flag"),
    ((*STATED, "method=covariance"), "fix_states"),
    ((*STATED[:1], "filter.coupling=tight"), "fix_states"),
    ((*STATED, "integrity={method: mhss, exclusion: residual}"), "method"),
    ((*STATED[1:], "receiver.fix_states={float: {next: {fixed: 0.5}}}"), "next"),
    ((*STATED[1:], "receiver.fix_states={forced: [{state: wrong, at_s: 9, until_s: 5}]}"), "until_s"),
])  # fmt: skip
def test_what_is_refused(settings: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError, match=key):
        scenario(*settings)
