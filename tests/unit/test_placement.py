"""The geometry kernel against dense algebra, epoch by epoch; surfaces of the aerodrome."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH, WIDTHS, in_lanes
from navsim.environment.sources import environment
from navsim.optimization.placement import RunwayPlane, _polygons, surface_height
from navsim.optimization.scenario import Surfaces
from navsim.scenario.load import read
from navsim.simulation.placement_dops import MEAN, placement_dops
from navsim.simulation.placement_geometry import Geometry, glide_geometry
from tests.conftest import SCENARIOS

EPOCHS = np.linspace(0.0, 60.0, 7)


def here(*settings: str) -> tuple[Geometry, np.ndarray, np.ndarray]:
    """The geometry of landing.yaml without pseudolites, its unit vectors in ECEF (nan: not used), clocks."""
    from navsim.gnss.signals import build_signals

    scenario, document = read(SCENARIOS / "landing.yaml", ["pseudolites.count=0", *settings])
    sources, scenario, _ = environment(scenario, document)
    trajectory = scenario.trajectory()
    utc = scenario.epoch.timestamp()
    signals = build_signals(trajectory.motion(EPOCHS), utc, sources)
    line = signals.position - signals.antenna[:, None]
    line /= np.linalg.norm(line, axis=2)[:, :, None]
    line[~signals.used] = np.nan
    every = np.ones(EPOCHS.size, dtype=bool)
    return glide_geometry(trajectory, sources, np.array([utc]), EPOCHS, every), line, signals.time_scale


def dense(geometry: Geometry, line: np.ndarray, clock: np.ndarray, sites: np.ndarray, own: int) -> np.ndarray:
    """PDOP, HDOP, VDOP (3, e) of one placement by numpy, one epoch at a time."""
    out = np.full((3, len(line)), np.nan)
    for e in range(len(line)):
        used = np.isfinite(line[e, :, 0])
        to_sites = sites - geometry.receiver[e]
        u = np.concatenate([line[e, used], to_sites / np.linalg.norm(to_sites, axis=1)[:, None]])
        c = np.concatenate([clock[used], np.full(len(sites), own)])
        h = np.hstack([-u, (c[:, None] == np.unique(c)).astype(float)])
        if h.shape[0] < h.shape[1]:
            continue
        q = np.linalg.inv(h.T @ h)[:3, :3]
        up = geometry.up[e] @ q @ geometry.up[e]
        out[:, e] = np.sqrt([np.trace(q), np.trace(q) - up, up])
    return out


@pytest.mark.parametrize("clock", ["glonass", "own"])
@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_statistics_equal_dense_algebra(clock: str, count: int) -> None:
    """A sample of placements, not a whole number of registers of them: to 1e-9."""
    geometry, line, clocks = here(f"pseudolites.clock={clock}")
    rng = np.random.default_rng(3)
    centre = geometry.receiver[-1]
    sites = centre + rng.uniform(-4000, 4000, (20 * WIDTH + 5, count, 3))
    found, lost = geometry.dops(sites)
    own = {"glonass": 0, "own": 2}[clock]
    for p in (*range(12), *range(20 * WIDTH - 1, 20 * WIDTH + 5)):
        each = dense(geometry, line, clocks, sites[p], own)
        expected = np.stack([each.mean(axis=1), each.min(axis=1), each.max(axis=1)], axis=1)
        np.testing.assert_allclose(found[:, :, p], expected, rtol=1e-9)
    assert not lost.any()
    again, _ = geometry.dops(np.concatenate([sites] * 60), workers=2)
    np.testing.assert_array_equal(again[:, :, -len(sites) :], found)


def test_epochs_without_a_solution_are_counted_and_left_out() -> None:
    """Three satellites and one or two pseudolites: one is just enough, none is not, and three with their own clock."""
    sky = "sky.directions=[{azimuth_deg: 10, elevation_deg: 30}, {azimuth_deg: 130, elevation_deg: 40}, "
    sky += "{azimuth_deg: 250, elevation_deg: 20}]"
    geometry, line, clocks = here("sky.source=directions", sky)
    site = geometry.receiver[-1] + np.array([[[300.0, 2000.0, -100.0]]])
    found, lost = geometry.dops(np.empty((1, 0, 3)))
    assert np.all(np.isnan(found))
    assert lost[0] == EPOCHS.size
    found, lost = geometry.dops(site)
    assert lost[0] == 0
    np.testing.assert_allclose(found[:, MEAN, 0], dense(geometry, line, clocks, site[0], 0).mean(axis=1), rtol=1e-8)


@pytest.mark.parametrize("width", [1, *WIDTHS])
def test_the_bits_of_a_placement_are_its_own(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever lies beside it, however wide a register is, whoever does what, and whether horizons are looked at: lost
    epochs and found ones."""
    sky = "sky.directions=[{azimuth_deg: 10, elevation_deg: 30}, {azimuth_deg: 130, elevation_deg: 40}, "
    sky += "{azimuth_deg: 250, elevation_deg: 20}]"
    geometry, _, _ = here("sky.source=directions", sky, "pseudolites.clock=own")
    geometry = geometry.at(np.arange(80) % EPOCHS.size)
    sites = geometry.receiver[-1] + np.random.default_rng(5).uniform(-4000, 4000, (4 * WIDTH + 3, 2, 3))
    sites[::3, 1] = sites[::3, 0]  # one twice: too few
    sites[1, 0] = geometry.receiver[3]  # no direction to it there
    found, lost = geometry.fix_sigmas(sites)
    assert np.all(lost[::3] == 80)
    assert lost[1] == np.sum(np.arange(80) % EPOCHS.size == 3)
    assert not lost[2::3].any()
    assert not lost[4::3].any()
    for p in range(len(sites)):
        np.testing.assert_array_equal(geometry.fix_sigmas(sites[p : p + 1])[0][..., 0], found[..., p])
    monkeypatch.setattr("navsim.simulation.placement_geometry._SHARE", 80)
    again, lost_again = geometry.fix_sigmas(sites, workers=3)
    np.testing.assert_array_equal(again, found)
    np.testing.assert_array_equal(lost_again, lost)

    groups, near = -(-len(sites) // width), np.empty((2, 4, width))
    clear, values, missed = np.empty((0, 0, 0, width)), np.empty((3, 3, groups, width)), np.empty((groups, width))
    clear, places, out, no_fix = (a[..., 0] if width == 1 else in_lanes(a) for a in (clear, near, values, missed))
    for far in (np.empty((0, 2)), np.full((len(sites), 2), 1e6)):
        placement_dops(
            geometry.receiver, geometry.up, geometry.reach, geometry.spare, geometry.weighted,
            geometry.pseudolite_weighted, geometry.ridges, clear, sites, far, near, places, 0, groups, out, no_fix,
        )  # fmt: skip
        np.testing.assert_array_equal(values.reshape(3, 3, -1)[..., : len(sites)], found)
        np.testing.assert_array_equal(missed.ravel()[: len(sites)], lost)


def test_surfaces_rise_outwards_from_the_strip() -> None:
    """Annex 14: 0 at the inner edge, 2.5 % along the approach, 14.3 % beside it, the same at both ends."""
    surfaces = Surfaces()
    s = np.array([0.0, 75.0, 0.0, 75.0 + 150.0 + 10.0, 175.0, 0.0])
    l1 = np.array([60.0, 60.0, 1060.0, 1060.0, -500.0, -2060.0])
    np.testing.assert_allclose(surface_height(surfaces, 1000.0, s, l1), [0, 0, 25, 25 + 1.43, 14.3, 25], atol=1e-12)


SQUARE = [[37.0, 56.0], [37.01, 56.0], [37.01, 56.01], [37.0, 56.01], [37.0, 56.0]]
GROUND = RunwayPlane(np.array([np.radians(56.0), np.radians(37.0), 0.0]), 0.0, 0.0)


def feature(coordinates: Any, kind: str = "Polygon") -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}}


def collection(features: Any) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (collection(None), "its features are no list"),
        (b'{"type": "FeatureCollection"}', "its features are no list"),
        (collection([None]), "feature 0: None is not a Polygon"),
        (collection([feature([SQUARE]), {"geometry": None}]), "feature 1: None is not a Polygon"),
        (collection([feature([SQUARE], "x" * 1000)]), "feature 0: 'xxx"),
        (collection([]), "no polygons"),
        (b"[" * 100_000 + b"]" * 100_000, "nested too deeply"),
        (b'{"a": ' * 100_000, "nested too deeply"),
        (b"\xff", "not a GeoJSON file"),
        (b"9" * 5000, "not a GeoJSON file"),
        (collection([feature(None)]), "feature 0: not a polygon: rings are due"),
        (collection([feature([])]), "rings are due"),
        (collection([feature([None])]), "points are due"),
        (collection([feature([[[True, 56.0], *SQUARE[1:]]])]), "a point is a list of numbers"),
        (collection([feature([[["37", 56.0], *SQUARE[1:]]])]), "a point is a list of numbers"),
        (collection([feature([[[37.0], *SQUARE[1:]]])]), "a point is a list of numbers"),
        (collection([feature([[SQUARE]])]), "a point is a list of numbers"),
        (collection([feature([SQUARE[:2]])]), "feature 0: not a polygon"),
        (collection([feature([[[37.0, 96.0], *SQUARE[1:]]])]), "longitude, latitude in degrees"),
        (collection([feature([[[37.0, float("nan")], *SQUARE[1:]]])]), "longitude, latitude in degrees"),
        (collection([feature([[[10**400, 56.0], *SQUARE[1:]]])]), "longitude, latitude in degrees"),
        (collection([feature([[[-180, -89], [180, -89], [180, 89], [-180, 89], [-180, -89]]])]), "more than 500,000"),
    ],
)  # fmt: skip
def test_what_is_no_keep_out(content: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        _polygons(content, GROUND, 0.0, False)
    assert len(str(caught.value)) < 300


def test_keep_outs_of_both_kinds() -> None:
    """A square with a hole, 1113.5 m from south to north (an arc of 0.01 degrees on the ellipsoid)."""
    hole = [[x * 0.5 + 18.5025, y * 0.5 + 28.0025] for x, y in SQUARE]
    ((one, _),) = _polygons(collection([feature([SQUARE, hole])]), GROUND, 0.0, True)
    ((several, _),) = _polygons(collection([feature([[SQUARE, hole]], "MultiPolygon")]), GROUND, 0.0, False)
    assert one.equals(several)
    low, high = one.bounds[1::2]
    assert high - low == pytest.approx(1113.5, abs=1.0)
    assert one.area == pytest.approx(0.75 * 1113.5 * 622.9, rel=0.01)
