"""Table 2: every cell against an independent computation, the calibrations against what they promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
import pytest
import yaml

from navsim.published_tables.table2 import (
    APART,
    CALIBRATIONS,
    PUBLISHED_DOPS,
    PUBLISHED_SKO,
    ROWS,
    Calibration,
    geometry,
    published_contradiction,
    relative_difference,
    two_pseudolites_bound,
)
from tests.conftest import SCENARIOS, Within
from tests.helpers import case

BY_LETTER = {c.letter: c for c in CALIBRATIONS}


def computed(calibration: Calibration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit-weight DOPs (8, 3), weighted DOPs (8, 3), SKO (8, 2) as navsim computes them."""
    here, sites, sigma = geometry(calibration)
    dops = np.stack([here.dops(s[None])[0][:, 0, 0] for s in sites])
    sigmas = np.stack([here.fix_sigmas(s[None])[0][:, 0, 0] for s in sites])
    return dops, sigmas / sigma, sigmas[:, 1:]


def recomputed(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """DOPs (8, 3) and SKO (8, 2) from the scenario file alone: pymap3d, the paper's sphere, dense inverses."""
    data = yaml.safe_load((SCENARIOS / f"{calibration.name}.yaml").read_text())
    azimuth, elevation = np.radians([[d["azimuth_deg"], d["elevation_deg"]] for d in data["sky"]["directions"]]).T
    sky = np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1
    )
    start, height, slope = data["approach"]["start"], data["approach"]["start_height_m"], np.radians(5.0)
    slant = height / np.sin(slope)
    v0, v1 = data["approach"]["speed_start_kmh"] / 3.6, data["approach"]["speed_touchdown_kmh"] / 3.6
    end = 2.0 * slant / (v0 + v1)
    time = np.arange(1, int(end * data["receiver"]["rate_hz"]) + 1) / data["receiver"]["rate_hz"]
    gone = v0 * time - 0.5 * (v0 - v1) / end * time**2
    # the touchdown point: found so that the glide in its tangent plane begins above the start
    lat, lon = start["lat_deg"], start["lon_deg"]
    touchdown = np.array([lat + 0.0157, lon])
    for _ in range(20):
        begin = pymap3d.enu2geodetic(0.0, -slant * np.cos(slope), height, touchdown[0], touchdown[1], 0.0)
        touchdown += [lat - begin[0], lon - begin[1]]
    left = slant - gone
    path = pymap3d.enu2geodetic(0.0, -left * np.cos(slope), left * np.sin(slope), touchdown[0], touchdown[1], 0.0)
    sigma, sigma_pl = data["signals"]["range_sigma_m"], data["pseudolites"]["range_sigma_m"]
    dops, sko = np.empty((len(ROWS), 3)), np.empty((len(ROWS), 2))
    for i, row in enumerate(ROWS):
        sums = np.zeros(5)
        for receiver in zip(*path, strict=True):
            lines, weights = [sky], [np.full(len(sky), sigma**-2)]
            for sign in (1.0, -1.0)[: row.pseudolites]:
                site_lat = lat + np.degrees((slant + sign * row.s) / 6371.0e3)
                site_lon = lon + np.degrees(row.l1 / (6371.0e3 * np.cos(np.radians(lat))))
                enu = np.array(pymap3d.geodetic2enu(site_lat, site_lon, 0.0, *receiver))
                lines.append(enu[None] / np.linalg.norm(enu))
                weights.append([sigma_pl**-2])
            h = np.concatenate(lines)
            h = np.hstack([-h, np.ones((len(h), 1))])
            q = np.diag(np.linalg.inv(h.T @ h))
            p = np.diag(np.linalg.inv(h.T @ (np.concatenate(weights)[:, None] * h)))
            sums += np.sqrt([q[:3].sum(), q[:2].sum(), q[2], p[:2].sum(), p[2]])
        dops[i], sko[i] = sums[:3] / time.size, sums[3:] / time.size
    return dops, sko


@pytest.mark.validates("Cells of Table 2: DOPs and SKO of all rows and calibrations", "pymap3d and numpy",
                       each_cell="1e-6")  # fmt: skip
@pytest.mark.parametrize("letter", BY_LETTER)
def test_every_cell_is_what_an_independent_computation_gives(letter: str, within: Within) -> None:
    ours, _, our_sko = computed(BY_LETTER[letter])
    theirs, their_sko = recomputed(BY_LETTER[letter])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=within["each_cell"])
    np.testing.assert_allclose(our_sko, their_sko, rtol=0, atol=within["each_cell"])


def test_row_one_of_calibration_a() -> None:
    dops, _, sko = computed(BY_LETTER["a"])
    assert np.all(np.abs(dops[0] - PUBLISHED_DOPS[0]) < 0.015), dops[0]
    assert np.all(np.abs(sko[0] - PUBLISHED_SKO[0]) < 0.02), sko[0]


def test_calibration_b() -> None:
    dops, _, sko = computed(BY_LETTER["b"])
    assert np.all(np.abs(dops[0] - PUBLISHED_DOPS[0]) < 0.01), dops[0]
    assert np.all(np.abs(sko[0] - PUBLISHED_SKO[0]) < 0.01), sko[0]
    rms, worst = relative_difference(dops, PUBLISHED_DOPS)
    assert rms < 0.06
    assert worst < 0.12
    assert relative_difference(sko, PUBLISHED_SKO)[0] < 0.06


def test_calibration_b_prime() -> None:
    dops, _, sko = computed(BY_LETTER["b'"])
    assert np.all(np.abs(dops[0] - PUBLISHED_DOPS[0]) < 0.01), dops[0]
    rms, worst = relative_difference(dops, PUBLISHED_DOPS)
    assert rms < 0.07
    assert worst < 0.145
    assert np.all(np.abs(sko[0] - PUBLISHED_SKO[0]) < 0.05), sko[0]


def test_calibration_c() -> None:
    _, weighted, sko = computed(BY_LETTER["c"])
    for cells, published in ((weighted, PUBLISHED_DOPS), (sko, PUBLISHED_SKO)):
        rms, worst = relative_difference(cells, published)
        assert rms < 0.03
        assert worst < 0.06


@pytest.mark.parametrize(
    ("letter", "file", "settings"),
    [
        ("a", "MCCJ_180913.agl", ("epoch=2018-09-15T01:05:30Z", "sky.mask_upper_deg=45")),
        (
            "b'",
            "MCCJ_170404.agl",
            ("epoch=2017-04-04T06:44:27Z", "sky.mask_deg=4.5", "sky.mask_upper_deg=53",
             "sky.interference=[{azimuth_deg: [313, 346]}]"),
        ),
    ],
)  # fmt: skip
@pytest.mark.validates("DOPs of Table 2's calibrations a and b' under real skies", "GLONASS almanacs of MCC",
                       DOPs="0.01", published_DOPs="0.015")  # fmt: skip
def test_directions_are_those_of_the_almanac(
    shared: Path, letter: str, file: str, settings: tuple[str, ...], within: Within
) -> None:
    """Flown under the almanac itself, satellites moving: means over the glide, and row 1 as published."""
    sky = ("sky.source=almanac", f"sky.almanac={shared}/data/almanacs/{file}")
    dops, _, _ = computed(BY_LETTER[letter])
    for i, row in enumerate(ROWS):
        flown = case("pseudolites.frame=table1", "receiver.rate_hz=5", *sky, *settings, *row.assignments())
        glide = flown.shared.signals.time <= 60.19
        means = flown.shared.dop[glide][:, 1:4].mean(axis=0)
        np.testing.assert_allclose(means, dops[i], rtol=0, atol=within["DOPs"])
        if i == 0:
            assert np.all(np.abs(means - PUBLISHED_DOPS[0]) < within["published_DOPs"]), means


def _dops(rows: np.ndarray, weight: np.ndarray, *pseudolites: np.ndarray) -> np.ndarray:
    """PDOP, HDOP, VDOP (3, 3) without pseudolites, with the first, with both."""
    normal = rows.T @ (weight[:, None] * rows)
    added = [np.zeros_like(normal), *(np.outer(row, row) for row in pseudolites)]
    squares = [np.diag(np.linalg.inv(normal + n))[:3] for n in np.cumsum(added, axis=0)]
    return np.sqrt([(v.sum(), v[:2].sum(), v[2]) for v in squares])


def test_two_pseudolites_obey_the_bound() -> None:
    """Random skies, weights, clocks and pseudolites, by dense algebra."""
    rng = np.random.default_rng(4)
    closest = np.inf
    for _ in range(300):
        count, clocks = int(rng.integers(5, 10)), int(rng.integers(1, 3))
        los = rng.standard_normal((count, 3))
        rows = np.hstack([-los / np.linalg.norm(los, axis=1)[:, None], np.eye(clocks)[np.arange(count) % clocks]])
        weight = rng.uniform(0.1, 3.0, count)
        apart = np.append(rng.uniform(0, 0.3) * rng.standard_normal(3), np.zeros(clocks))
        row = np.append(rng.standard_normal(3), np.eye(clocks)[0]) * rng.uniform(0.3, 10.0)
        none, one, two = _dops(rows, weight, row, row + apart)[:, 0]
        change = np.sqrt(apart @ np.linalg.inv(rows.T @ (weight[:, None] * rows)) @ apart)
        margin = two / two_pseudolites_bound(none, one, change)
        closest = min(closest, margin)
        assert margin > 1.0 - 1e-9
    assert closest < 1.02  # the bound is nearly reached


def test_rows_1_2_and_5_contradict_each_other_with_unit_weights() -> None:
    least, printed = published_contradiction()
    assert least == pytest.approx(2.534, abs=5e-4)
    assert printed < least
    along = np.linspace(-1749.0, 0.0, 50)  # path axes of the glide; pseudolites abeam of touchdown
    path = np.stack([along, 0.0 * along, -np.tan(np.radians(5.0)) * along], axis=1)
    sight = [(p := np.array([s, 4000.0, 0.0]) - path) / np.linalg.norm(p, axis=1)[:, None] for s in (50.0, -50.0)]
    apart = np.abs(sight[0] - sight[1])
    assert np.all([np.hypot(apart[:, 0], apart[:, 1]).max(), apart[:, 2].max()] <= np.array(APART))


def test_rows_1_2_and_5_agree_with_weighted_dops() -> None:
    """A sky in path axes at the middle of the glide, and pseudolites of 13 400 times a satellite's weight."""
    azimuth, elevation = np.radians(
        [[147.97, 334.1, 133.9, 58.68, 161.5, 152.36], [30.21, 5.5, 17.08, 5.31, 6.94, 17.63]]
    )
    los = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    at = np.array([-875.0, 0.0, 875.0 * np.tan(np.radians(5.0))])
    rows = np.stack([*np.negative(los), np.ones(azimuth.size)], axis=1)
    sights = [(p := np.array([s, 4000.0, 0.0]) - at) / np.linalg.norm(p) for s in (50.0, -50.0)]
    pseudolites = [np.append(-u, 1.0) * np.sqrt(13_400.0) for u in sights]
    dops = _dops(rows, np.ones(azimuth.size), *pseudolites)
    np.testing.assert_allclose(dops, PUBLISHED_DOPS[[0, 1, 4]], rtol=0, atol=0.005)
