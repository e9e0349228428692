"""Placements are judged by the landing's own signals: the placement path against the landing, over every setting."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from navsim.core.wgs84 import ecef_from_llh
from navsim.models.pseudolite import NEAREST, clearance
from navsim.models.systems import CLOCKS
from navsim.scenario.load import read_study
from navsim.scenario.optimize import Optimize
from navsim.scenario.signals import ReceiverSection
from navsim.scenario.sweep import DOP_OUTPUTS, Sweep
from navsim.study import landing, objective
from navsim.study.sweep import SweepStudy, plan
from tests.helpers import SCENARIOS, case

RECEIVER = {
    "rate_hz": st.sampled_from([0.5, 1.0, 2.0]),
    "latency_s": st.sampled_from([0.0, 0.3, 2.0]),
    "lever_arm_m": st.sampled_from(["[0, 0, 0]", "[3.0, -1.0, -0.5]"]),
    "clock_offset_us": st.sampled_from([0.0, 100.0]),
    "clock_drift_ppb": st.sampled_from([0.0, 50.0]),
    "smoothing_s": st.sampled_from([0.0, 1.0, 20.0, 1000.0]),
    "one_clock": st.booleans(),
}
"""Values of every setting of the receiver."""

OTHER = {
    "pseudolites.clock": st.sampled_from(CLOCKS),
    "pseudolites.count": st.sampled_from([0, 1, 2]),
    "pseudolites.range_sigma_m": st.sampled_from([0.5, 2.23606797749979]),
    "signals.range_law": st.sampled_from(["constant", "inverse-sine", "exponential", "cn0"]),
    "signals.gps_offset_ns": st.sampled_from([0.0, 30.0]),
    "sky.source": st.sampled_from(["nominal", "nominal-glonass", "nominal-gps"]),
    "duration_s": st.sampled_from([50.0, 62.0]),
    "sky.mask_deg": st.sampled_from([5.0, 20.0]),
}

APPROACHES = st.sampled_from(["landing", "landing_smooth"])


def study_of(tmp_path: Path, kind: str, text: str, name: str = "landing") -> Path:
    """A study file of a shipped scenario."""
    path = tmp_path / f"{kind}.yaml"
    path.write_text(f"kind: {kind}\nversion: 1\nbase: {SCENARIOS / name}.yaml\n{text}")
    return path


def test_every_setting_of_the_receiver_is_drawn() -> None:
    """A key that is added to the receiver must be added here."""
    assert RECEIVER.keys() == ReceiverSection.model_fields.keys()


@settings(max_examples=25, derandomize=True)
@given(st.fixed_dictionaries({f"receiver.{k}": v for k, v in RECEIVER.items()} | OTHER), APPROACHES, st.booleans())
@example({"receiver.one_clock": True, "pseudolites.clock": "gps", "sky.source": "nominal"}, "landing", True)
@example({"receiver.smoothing_s": 20.0, "pseudolites.count": 1}, "landing", True)
def test_placement_path_equals_the_landing(
    tmp_path_factory: pytest.TempPathFactory, drawn: dict[str, object], name: str, corrected: bool
) -> None:
    """PDOP, HDOP, VDOP, sigmas of the fix, epochs without one: to 1e-9, by both ways a sweep has, and optimize."""
    drawn = {"receiver.rate_hz": 1.0, **drawn}
    if corrected and drawn.get("pseudolites.count"):
        drawn["pseudolites.differential"] = "{sigma_m: 0.8}"
    assignments = [f"{key}={str(value).lower()}" for key, value in drawn.items()]
    flown = case(*assignments, name=name)
    result = landing.covariance_result(flown, landing.covariance_analysis(flown), 1)
    glide = landing.case.on_glide(flown.scenario, flown.trajectory, flown.world.signals.time)
    expected = np.array(
        [result[f"/summary/dop/{d}dop"][0] for d in "phv"] + [result[f"/summary/dop/{d}dop"][2] for d in "phv"]
        + [result[f"/summary/fix/rms_{n}"][0] for n in ("horizontal", "vertical")]
        + [float(np.isnan(flown.world.dop[glide, 1]).sum())]
    )  # fmt: skip
    assert len(DOP_OUTPUTS) == expected.size
    folder = tmp_path_factory.mktemp("study")
    count = flown.scenario.pseudolites.count
    base = "".join(f"  {a.replace('=', ': ', 1)}\n" for a in assignments if not a.startswith("pseudolites.count"))
    for way in ("pseudolites.count", "duration_s"):
        value = {"pseudolites.count": count, "duration_s": flown.scenario.duration_s}[way]
        rest = base if way == "pseudolites.count" else f"{base}  pseudolites.count: {count}\n"
        rest = "".join(line for line in rest.splitlines(True) if not line.startswith(f"  {way}:"))
        path = study_of(folder, "sweep", f"set:\n{rest}vary:\n- {{key: {way}, values: [{value}]}}\nmethod: dop\n", name)
        planned = plan(*read_study(path, Sweep, []), 1)
        assert (planned.geometry is not None) == (way == "pseudolites.count")
        rows, _, _ = SweepStudy(planned).batch(0, 1)
        np.testing.assert_allclose([rows[k][0] for k in DOP_OUTPUTS], expected, rtol=1e-9)
    if count and not corrected:
        area = "area: {s_m: [-500, 500], l1_m: [0, 5000]}\npseudolites: [1]\nobjective: pdop\n"
        path = study_of(folder, "optimize", f"set:\n{base}{area}", name)
        here = objective.problem(*read_study(path, Optimize, []))
        sites = ecef_from_llh(flown.ground.llh)[None]
        dops, lost = here.geometry.dops(sites)
        sigmas, _ = here.geometry.fix_sigmas(sites)
        found = [*dops[:, 0, 0], *dops[:, 2, 0], *sigmas[1:, 0, 0], float(lost[0])]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_pseudolite_beside_the_rollout_is_refused_by_all(tmp_path: Path) -> None:
    """A metre beside the runway's axis, behind touchdown: scenarios, sweeps by geometry, and optimize refuse it."""
    placed = "pseudolites.count: 1\n  pseudolites.l1_m: -600\n  pseudolites.frame: runway\n"
    path = study_of(
        tmp_path, "sweep", f"set:\n  {placed}vary:\n- {{key: pseudolites.s_m, values: [1, 100]}}\nmethod: dop\n"
    )
    planned = plan(*read_study(path, Sweep, []), 1)
    assert planned.geometry is not None
    rows, _, _ = SweepStudy(planned).batch(0, 2)
    assert np.isnan(rows["pdop"][0])
    assert np.isfinite(rows["pdop"][1])
    text = "area: {s_m: [-500, 500], l1_m: [-900, 5000]}\npseudolites: [1]\nobjective: pdop\n"
    here = objective.problem(*read_study(study_of(tmp_path, "optimize", text), Optimize, []))
    near, far = here.rules.violation(np.array([[[1.0, -600.0]], [[100.0, -600.0]]]))
    assert 0.0 < near <= NEAREST
    assert far <= 0.0


def test_clearance_does_not_depend_on_the_number_of_sites() -> None:
    rng = np.random.default_rng(1)
    track, sites = rng.normal(size=(500, 3)) * 1e3, rng.normal(size=(40, 3)) * 1e3
    np.testing.assert_allclose(clearance(track, sites), [clearance(track, s[None])[0] for s in sites], rtol=1e-12)
