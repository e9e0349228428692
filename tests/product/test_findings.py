"""What a study finds in what was flown: said, kept in the result, an error where it was asked for."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from navsim.filter.records import NOT_USED
from navsim.landing import study as landing
from navsim.landing.ensemble import LandingStudy
from navsim.optimization.problem import problem
from navsim.optimization.scenario import Optimize
from navsim.results.findings import Finding, kept, of
from navsim.results.notes import CONSISTENT, FIX
from navsim.results.result import Result, ResultError, Variable, read, write
from navsim.runner import findings as judging
from navsim.runner.batches import Batch, Ensemble
from navsim.runner.executor import threads
from navsim.scenario.load import read as read_scenario
from navsim.scenario.load import read_study
from navsim.simulation.run import Run
from navsim.sweeps import study as sweep
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import Sweep
from tests.conftest import SCENARIOS
from tests.helpers import in_brief
from tests.product.test_run import navsim, warnings_of

LOST = "pseudolites.clock_offset_ns=1000000"
"""The pseudolites' ranges are 300 km short: the least squares find no solution."""
TINY = ("signals.range_sigma_m=0.0005", "signals.range_rate_sigma_m_s=0.0005")
SURE = (*TINY, "filter.steady_force=false")
"""The filter believes its heading too well, so far that its errors contradict it."""
LANDINGS = sorted(p.stem for p in SCENARIOS.glob("*.yaml") if "kind: landing" in p.read_text())


def case(*assignments: str, name: str = "landing") -> landing.Case:
    return landing.prepare(*read_scenario(SCENARIOS / f"{name}.yaml", assignments))


def ensemble(first_run: int, *batches: Batch) -> Ensemble:
    """An ensemble of these batches."""
    flown = Ensemble(first_run, sum(batch.per_run["fixes"].size for batch in batches))
    for batch in batches:
        flown.add(batch)
    return flown


def found_in(c: landing.Case, runs: int = 1) -> dict[str, Finding]:
    ensemble = landing.fly_all(c, 1, 0, runs, threads(1), keep="none")
    return {f.name: f for f in landing.findings(c, ensemble) if f.name != "input"}


def test_all_fixes_lost() -> None:
    c = case(LOST, "duration_s=20")
    assert np.isfinite(c.shared.dop).all()  # by its geometry all is well
    one = found_in(c)["lost_fixes"]
    assert (one.against, one.count, one.of, one.runs, one.first) == ((FIX,), 200, 200, 1, 0.1)
    assert one.text.startswith("no fix at all: 200 of 200 epochs without a fix: sources enough")
    three = found_in(c, 3)["lost_fixes"]
    assert (three.count, three.of, three.runs) == (600, 600, 3)
    assert "in 3 of 3 runs" in three.text
    result = landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="none"), 1, keep="none")
    assert int(result["/summary/count/epochs_without_fix"]) == 200
    assert "lost_fixes" in [f.name for f in of(result)]


def test_covariance_analysis_without_fixes() -> None:
    c = case(LOST, "duration_s=20", "method=covariance")
    result = landing.covariance_result(c, landing.covariance_analysis(c), 1)
    found = {f.name: f for f in of(result)}
    assert (found["lost_fixes"].count, found["lost_fixes"].of) == (200, 200)
    assert int(result["/summary/count/fixes"]) == 0
    assert int(result["/summary/count/epochs_without_fix"]) == 200


def test_covariance_analysis_of_a_filter_that_believes_too_much() -> None:
    c = case("filter.fix_sigma_scale=0.05", "duration_s=20", "method=covariance")
    found = {f.name: f for f in of(landing.covariance_result(c, landing.covariance_analysis(c), 1))}
    assert {"errors_beyond_sigma", "sigma_position_velocity", "innovations"} <= set(found)
    assert {f.against for f in found.values() if f.name != "input"} == {(CONSISTENT,)}


def test_sigmas_beyond_what_the_filter_carries() -> None:
    found = found_in(case(*SURE, "duration_s=20"))
    assert {"rejected_fixes", "errors_beyond_sigma", "sigma_position_velocity", "innovations"} <= set(found)
    assert found["rejected_fixes"].against == (FIX, CONSISTENT)
    assert found["errors_beyond_sigma"].first == pytest.approx(0.1)
    assert "times their expected size" in found["sigma_position_velocity"].text
    assert "sigma_all_states" in found_in(case(*SURE, "duration_s=20"), 3)


def test_shorter_than_a_fix_interval() -> None:
    (found,) = found_in(case("duration_s=0.05")).values()
    assert found.against == (FIX,)
    assert "never gets a fix" in found.text


def test_each_flaw_of_a_run() -> None:
    """Flaws no scenario is known to cause, put into a run by hand."""
    c = case("duration_s=5")
    (runs,) = c.fly_runs(1, 0, 1)
    runs.error[0, 10] = np.inf
    runs.nees[0, 20:23] = np.nan
    runs.sigma[0, 30, 4] = abs(runs.error[0, 30, 4]) / 11.0
    runs.nees_position_velocity[0, 30] = 121.0
    runs.fix_velocity[0, 40] = np.nan
    runs.status[0, 45:47] = NOT_USED

    class Flown(landing.Case):
        def fly_runs(self, seed: int, first: int, count: int, measured: bool = True) -> Iterator[Run]:
            yield runs

    broken = Flown(**{field.name: getattr(c, field.name) for field in fields(c)})
    batch = Batch(*LandingStudy(broken, 1, "none").batch(0, 1))
    found = {f.name: f for f in landing.findings(broken, ensemble(0, batch))}
    expected = {
        "not_finite": (1, 51, 1.0, (CONSISTENT,)),
        "covariance_not_positive": (3, 51, 2.0, (CONSISTENT,)),
        "errors_beyond_sigma": (2, 51, 1.0, (CONSISTENT,)),
        "fixes_without_velocity": (1, 50, 4.1, (FIX,)),
        "unweighed_fixes": (2, 50, 4.6, (FIX,)),
    }
    assert {name: (f.count, f.of, round(f.first, 6), f.against) for name, f in found.items()
            if name in expected} == expected  # fmt: skip


MEANT = {"beacons_uav": {"epochs_without_fix", "aided_rejections"}, "beacons_pad": {"epochs_without_fix"}}
"""Findings that shipped scenarios are made for: satellites are silenced, and beacons have outliers."""


@pytest.mark.parametrize("runs", [5, pytest.param(20, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", in_brief(LANDINGS, 0, 7))
def test_no_false_alarm_of_a_shipped_scenario(name: str, runs: int) -> None:
    """Runs by themselves, and as an ensemble."""
    c = case(name=name)

    def told(finding: Finding) -> bool:
        return finding.text not in c.warnings and finding.name not in MEANT.get(name, ())

    study = LandingStudy(c, 1, "none")
    batches = [Batch(*study.batch(k, 1)) for k in range(runs)]
    for k, batch in enumerate(batches):
        assert [f.text for f in landing.findings(c, ensemble(k, batch)) if told(f)] == []
    assert [f.text for f in landing.findings(c, ensemble(0, *batches)) if told(f)] == []


def test_thresholds() -> None:
    """Chance is no finding: few rejections by a gate, a mean square within what its degrees of freedom allow."""
    assert judging.limit(np.inf) == judging.DOUBTED
    assert judging.limit(6) > judging.limit(600) > judging.DOUBTED
    assert not judging.too_many(1, 1.2e-3)
    assert judging.too_many(2, 1e-4)
    assert not judging.too_many(8, 1.2)
    assert judging.too_many(1, 0.0)
    assert judging.doubted("innovations", "all", 0.99 * judging.limit(60), 60) == []
    assert judging.doubted("innovations", "all", 1.01 * judging.limit(60), 60) != []


def test_kept_in_a_file(tmp_path: Path) -> None:
    found = [
        Finding("input", "an old almanac"),
        Finding("rejected_fixes", "3 of 9 fixes", (FIX, CONSISTENT), 3, 9, 2, 0.5),
    ]
    for name, some in (("none", []), ("two", found)):
        result = Result({"kind": "landing", "navsim_version": "1"}, kept(some))
        write(tmp_path / f"{name}.h5", result)
        assert repr(of(read(tmp_path / f"{name}.h5"))) == repr(some)
    assert of(Result({}, {})) == []
    damaged = kept(found) | {"/findings/count": Variable(("finding",), np.array([1]), "1", "too few")}
    with pytest.raises(ResultError, match="damaged"):
        of(Result({}, damaged))


def test_said_kept_and_refused(tmp_path: Path) -> None:
    command = ("run", SCENARIOS / "landing.yaml", "--set", LOST, "--set", "duration_s=65", "--figures", "none")
    done = navsim(*command, "--json", "--require-fix", "-o", tmp_path / "lost.h5", cwd=tmp_path, code=3)
    assert "error: --require-fix: no fix at all: 650 of 650 epochs without a fix" in done.stderr
    assert "lost.h5 is complete" in done.stderr
    assert any("no fix at all" in w for w in warnings_of(done))
    findings = json.loads(done.stdout)["findings"]
    at = findings["finding"].index("lost_fixes")
    assert (findings["count"][at], findings["of"][at], findings["runs"][at]) == (650, 650, 1)
    shown = navsim("show", tmp_path / "lost.h5", cwd=tmp_path)
    assert warnings_of(shown) == warnings_of(done)


def test_combinations_without_a_fix(tmp_path: Path) -> None:
    """By what was flown: their geometry has a solution at every epoch."""
    (tmp_path / "lost.yaml").write_text(
        f"kind: sweep\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nmethod: monte-carlo\nruns: 2\n"
        "set: {duration_s: 20, receiver.rate_hz: 1}\noutputs: [pdop, horizontal]\n"
        "vary: [{key: pseudolites.clock_offset_ns, values: [0, 1000000]}]\n"
    )
    for method in ("monte-carlo", "covariance"):
        section, document, base = read_study(tmp_path / "lost.yaml", Sweep, [f"method={method}"])
        planned = plan(section, document, base, 1)
        result = sweep.sweep_result(planned, sweep.compute(planned, threads(1)))
        np.testing.assert_array_equal(result["/outcome/combination"], [sweep.COMPUTED, sweep.NO_FIX])
        np.testing.assert_array_equal(np.isnan(result["/sweep/pdop"]), [False, True])
        assert int(result.attributes["refused"]) == 1
        found = {f.name: f for f in of(result)}
        assert found["refused"].against == (FIX,)
        assert "1 of 2 combinations are nan: no fix at all" in found["refused"].text
        assert "the first: pseudolites.clock_offset_ns 1000000" in found["lost_fixes"].text
        assert (found["lost_fixes"].count, found["lost_fixes"].of) == (1, 2)


def test_a_flight_whose_truth_is_not_known() -> None:
    time = np.arange(1.0, 101.0)
    status = np.full(100, 1)
    status[:2], status[10:13], status[50:] = NOT_USED, NOT_USED, 1
    status[20:24] = 2
    llh = np.zeros((100, 3))
    llh[7] = np.nan
    sigma = np.ones((100, 15))
    sigma[30:32, 3] = np.nan
    v = {
        "/innovations/time": time, "/innovations/status": status, "/innovations/degrees": np.full(100, 6),
        "/innovations/normalized_squared": np.full(100, 60.0), "/filter/time": time, "/filter/position_llh": llh,
        "/filter/velocity_ned": np.zeros((100, 3)), "/filter/sigma": sigma,
    }  # fmt: skip
    result = Result({}, {path: Variable((), data, "1", "x") for path, data in v.items()})
    withheld = time < 3.0  # these were kept back on purpose
    found = {f.name: (f.count, f.of, f.first) for f in judging.of_flight(result, 1e-6, withheld)}
    assert found.pop("innovations")[:2] == (1, 1)
    assert found == {
        "unweighed_fixes": (3, 98, 11.0),
        "not_finite": (1, 100, 8.0),
        "covariance_not_positive": (2, 100, 31.0),
        "rejected_fixes": (4, 98, 21.0),
    }


def test_filters_of_the_companion_papers() -> None:
    error, sigma = np.zeros((3, 10, 2)), np.ones((10, 2))
    assert judging.of_filter("full", np.arange(10.0), 50.0 + error, sigma) == []
    error[1, 4:, 1], sigma[8, 0] = np.nan, np.nan
    found = {f.name: f for f in judging.of_filter("full", np.arange(10.0), error, sigma)}
    assert (found["not_finite"].count, found["not_finite"].of, found["not_finite"].runs) == (6, 30, 1)
    assert found["not_finite"].text.startswith("full: 6 of 30 outputs are not finite numbers, in 1 of 3 runs")
    assert (found["covariance_not_positive"].count, found["covariance_not_positive"].first) == (1, 8.0)


def test_no_fix_is_the_sum_of_its_causes() -> None:
    half = Finding("epochs_without_fix", "", (FIX,), 5, 10), Finding("lost_fixes", "", (FIX,), 5, 10)
    assert judging.without_fix(half)
    assert not judging.without_fix(half[:1])
    assert judging.without_fix([Finding("no_fix", "", (FIX,))])


def test_a_placement_without_a_fix(tmp_path: Path) -> None:
    """What the full analysis of a best placement finds, here of any."""
    (tmp_path / "lost.yaml").write_text(
        f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\n"
        "set: {receiver.rate_hz: 1, pseudolites.clock_offset_ns: 1000000}\n"
        "pseudolites: [1]\nobjective: horizontal\narea: {s_m: [100, 900], l1_m: [1000, 2000]}\n"
    )
    posed = problem(*read_study(tmp_path / "lost.yaml", Optimize, []))
    assert posed.found is not None
    assert [f.name for f in posed.found(np.array([[300.0, 1500.0]]))] == ["lost_fixes"]
