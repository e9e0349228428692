"""What the Earth hides: satellites and pseudolites below the horizon; heights of pseudolites that cannot be meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.environment.sources import environment
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.dop import dops
from navsim.gnss.interference.horizon import horizon_dip
from navsim.gnss.signals import build_signals
from navsim.optimization.problem import problem
from navsim.optimization.scenario import Optimize
from navsim.planner.outlook import Outlook
from navsim.planner.proposal import PlannedScenario
from navsim.results.findings import of
from navsim.runner.executor import threads
from navsim.runner.opening import checked
from navsim.scenario.load import read, read_study
from navsim.simulation.placement_geometry import glide_geometry
from navsim.sweeps import study as sweep
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import Sweep
from tests.conftest import SCENARIOS
from tests.helpers import case, scenario

A, B = 6378137.0, 6356752.314245
BRIEF = ("duration_s=62", "receiver.rate_hz=0.5", "imu.rate_hz=20")
FAR = ("pseudolites.frame=runway", "pseudolites.s_m=45000", "pseudolites.l1_m=0")
"""45 km beside the touchdown point: seen over 4.12 (sqrt(h) + 1) km, that is from above 99 m."""


def through_the_earth(antenna: np.ndarray, source: np.ndarray, ground: float) -> np.ndarray:
    """Whether straight lines (n, 3) to (n, s, 3), ECEF, m, go through the ellipsoid raised by `ground`: the quadric."""
    scale = np.array([A + ground, A + ground, B + ground])
    o, d = antenna[:, None] / scale, (source - antenna[:, None]) / scale
    aa, bb, cc = np.sum(d * d, axis=-1), np.sum(o * d, axis=-1), np.sum(o * o, axis=-1) - 1.0
    root = bb**2 - aa * cc
    with np.errstate(invalid="ignore"):
        return (root > 0.0) & (-bb - np.sqrt(root) > 0.0)


def test_the_dip_is_that_of_the_tangent() -> None:
    """arccos(R/(R + h)): 1.93' at 1 m (nautical tables: 1.76' sqrt(h) with refraction), 0.40 deg at 153 m."""
    np.testing.assert_allclose(np.degrees(horizon_dip(np.array([1.0, 153.0]))) * 60.0, [1.926, 23.82], rtol=1e-3)
    assert horizon_dip(-5.0) == 0.0


@pytest.mark.parametrize("height", [0.0, 550.0])
def test_satellites_under_the_horizon_are_not_received(height: float) -> None:
    """However low the mask: those are received whose straight line misses the ellipsoid at the runway's height."""
    settings = (*BRIEF, "sky.source=nominal", "sky.mask_deg=-90", f"runway.height_m={height}", "pseudolites.count=0")
    flown = case(*settings)
    s = flown.shared.signals
    hidden = through_the_earth(s.antenna, s.position, height)
    np.testing.assert_array_equal(s.used, ~hidden)
    assert hidden.sum() > 20 * len(s.time)
    said = [text for text in flown.warnings if text.startswith("sky.mask_deg: -90 deg is below the horizon")]
    assert len(said) == 1
    assert said[0] in checked(SCENARIOS / "landing.yaml", list(settings))[2]


def test_a_mask_within_the_dip_is_used() -> None:
    """From 153 m satellites down to -0.4 deg are seen, on the ground none below 0."""
    elevations = (-0.38, -0.2, 3, 60, 70)
    directions = ", ".join(f"{{azimuth_deg: {70 * i}, elevation_deg: {e}}}" for i, e in enumerate(elevations))
    sky = f"sky={{source: directions, mask_deg: -0.385, directions: [{directions}]}}"
    flown = case(*BRIEF, sky, "pseudolites.count=0")
    s = flown.shared.signals
    height = flown.trajectory.motion(s.time).llh[:, 2]
    below = np.degrees(np.arccos(6371e3 / (6371e3 + np.maximum(height, 0.0))))
    np.testing.assert_array_equal(s.used[:, 0], below >= 0.38)
    np.testing.assert_array_equal(s.used[:, 1], below >= 0.2)
    assert 0 < s.used[:, 0].sum() < s.used[:, 1].sum() < len(s.time)
    assert not [text for text in flown.warnings if "sky.mask_deg" in text]


def test_directions_below_the_horizon_are_not_received() -> None:
    sky = (
        "sky={source: directions, mask_deg: -20, directions: ["
        + ", ".join(f"{{azimuth_deg: {60 * i}, elevation_deg: {e}}}" for i, e in enumerate((-10, -1, 0, 20, 50, 70)))
        + "]}"
    )
    used = case(*BRIEF, sky, "pseudolites.count=0").shared.signals.used
    assert not used[:, :2].any()
    assert used[:, 2:].all()


def test_a_pseudolite_beyond_the_horizon_is_not_received() -> None:
    """By the radio horizon, as jammers: 4.12 km (sqrt(h1/m) + sqrt(h2/m))."""
    flown = case(*BRIEF, *FAR)
    s = flown.shared.signals
    away = np.linalg.norm(s.position[:, -1] - s.antenna, axis=1)
    height = np.maximum(flown.trajectory.motion(s.time).llh[:, 2], 1.0)
    seen = away <= 4120.0 * (np.sqrt(height) + 1.0)
    assert seen.any()
    assert not seen.all()
    np.testing.assert_array_equal(s.used[:, -1], seen)
    said = [text for text in flown.warnings if "beyond the radio horizon" in text]
    assert len(said) == 2
    assert f"of {(~seen).sum()} of {seen.size} fixes" in said[0]


@pytest.mark.parametrize("far", [100_000.0, 3000.0])
def test_placements_see_as_landings_do(far: float) -> None:
    """The geometry kernel and the landing itself, also where a pseudolite comes and goes at the horizon."""
    given, document = read(SCENARIOS / "landing.yaml", [*BRIEF, "pseudolites.count=0", "pseudolites.frame=runway"])
    sources, given, _ = environment(given, document)
    trajectory, utc = given.trajectory(), np.array([given.epoch.timestamp()])
    time = np.arange(0.0, 60.0, 2.0)
    geometry = glide_geometry(trajectory, sources, utc, time, np.ones(time.size, bool))
    places = [(45_000.0, 0.0), (200.0, far), (20_000.0, 3000.0), (600.0, 3000.0)]
    sites, means, lost = [], [], []
    for s, l1 in places:
        placed = scenario(*BRIEF, f"pseudolites={{count: 2, frame: runway, s_m: {s}, l1_m: {l1}}}")
        llh = placed.pseudolite_positions(trajectory.frame)
        world, placed, _ = environment(placed, document)
        signals = build_signals(trajectory.motion(time), float(utc[0]), world)
        sites.append(ecef_from_llh(llh))
        pdop = dops(signals.los, signals.time_scale)[:, 1]
        means.append(np.nanmean(pdop))
        lost.append(np.isnan(pdop).sum())
    found, without = geometry.dops(np.array(sites))
    np.testing.assert_allclose(found[0, 0], means, rtol=1e-9)
    np.testing.assert_array_equal(without, lost)
    near, _ = geometry.dops(np.array(sites[-1:]))
    np.testing.assert_array_equal(near[..., 0], found[..., -1])


def test_levels_of_placements_see_as_landings_do() -> None:
    """Maps of the planner, where pseudolites come and go at the horizon."""
    file = SCENARIOS / "landing.yaml"
    placed = "pseudolites={count: 1, frame: runway, s_m: 500, l1_m: 0}"
    _, document = read(file, [*BRIEF, placed, "sky.source=nominal", "integrity={method: mhss}"])
    outlook = Outlook(PlannedScenario(document, file.read_text()))
    places = np.array([[[0.0, 45_000.0, 0.0]], [[0.0, 500.0, 0.0]], [[0.0, 90_000.0, 0.0]]])
    found = outlook.judge("vpl_p95", ("PL1",))(places)
    assert len({*np.round(found, 3)}) == 3
    np.testing.assert_allclose(found, [outlook._by_signals("vpl_p95", place, ("PL1",)) for place in places], rtol=1e-6)


GEOID = "{height_m: 240, height_above: geoid, geoid_undulation_m: 40}"
HEIGHTS = [
    ("runway.height_m=550", "height_m: -500", "500 m below the runway"),
    ("runway.height_m=550", "height_m: 5000", "5000 m above the runway"),
    ("runway.height_m=550", "height_m: 555", "which is itself at 550 m; give 5 if that was meant"),
    (f"runway={GEOID}", "height_m: 246", "itself at 240 m; give 6"),
    (f"runway={GEOID}", "height_m: 290", "itself at 280 m; give 10"),
    ("runway.height_m=550", "height_m: 30", ""),
    ("runway.height_m=20", "height_m: 25", ""),
    ("runway.height_m=550", "height_m: -60", ""),
]


@pytest.mark.parametrize(("runway", "height", "said"), HEIGHTS)
def test_heights_that_cannot_be_meant(runway: str, height: str, said: str) -> None:
    """Above the ellipsoid, given as above the runway."""
    for placed in (f"count: 1, s_m: 300, l1_m: 2500, {height}", f"sites: [{{s_m: 300, l1_m: 2500, {height}}}]"):
        given = [*BRIEF, runway, f"pseudolites={{frame: runway, {placed}}}"]
        told = [text for text in checked(SCENARIOS / "landing.yaml", given)[2] if "height_m" in text]
        assert told == [text for text in case(*given).warnings if "height_m" in text]
        assert bool(told) == bool(said)
        assert not said or said in told[0]


def test_studies_tell_of_heights(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    base = f"version: 1\nbase: {SCENARIOS / 'landing.yaml'}\n"
    settings = "set: {receiver.rate_hz: 0.2, pseudolites.frame: runway, pseudolites.count: 1}\n"
    file.write_text(
        f"kind: optimize\n{base}{settings}objective: pdop\npseudolites: [1]\nheight_m: 5000\n"
        "area: {s_m: [100, 1000], l1_m: [0, 4000]}\n"
    )
    assert [text for text in problem(*read_study(file, Optimize)).warnings if text.startswith("height_m: 5000 m above")]
    file.write_text(f"kind: sweep\n{base}{settings}vary: [{{key: pseudolites.height_m, values: [3, 5000]}}]\n")
    planned = plan(*read_study(file, Sweep), 1)
    (found,) = of(sweep.sweep_result(planned, sweep.compute(planned, threads(1))))
    assert "in 1 of 2 combinations" in found.text
    assert "5000 m above the runway" in found.text
