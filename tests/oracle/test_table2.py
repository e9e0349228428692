"""Table 2: every cell against an independent computation, the calibrations against what they promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
import pytest
import yaml

from navsim.landing.table2 import (
    CALIBRATIONS,
    PUBLISHED_DOPS,
    PUBLISHED_SKO,
    ROWS,
    Calibration,
    coincident_bound,
    geometry,
    published_contradiction,
    relative_difference,
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


@pytest.mark.validates("Cells of Table 2: DOPs and SKO of all rows and calibrations", "pymap3d and numpy", cells="1e-6")
@pytest.mark.parametrize("letter", BY_LETTER)
def test_every_cell_is_what_an_independent_computation_gives(letter: str, within: Within) -> None:
    ours, _, our_sko = computed(BY_LETTER[letter])
    theirs, their_sko = recomputed(BY_LETTER[letter])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=within["cells"])
    np.testing.assert_allclose(our_sko, their_sko, rtol=0, atol=within["cells"])


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
@pytest.mark.validates("Real skies of Table 2's calibrations a and b'", "GLONASS almanacs of MCC",
                       DOPs="0.01", published="0.015")  # fmt: skip
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
            assert np.all(np.abs(means - PUBLISHED_DOPS[0]) < within["published"]), means


def test_two_pseudolites_in_one_place_obey_the_bound() -> None:
    """Any sky, weights and clocks: random ones, by dense algebra. The published rows do not."""
    rng = np.random.default_rng(4)
    tried = 0
    for _ in range(300):
        count, clocks = int(rng.integers(5, 10)), int(rng.integers(1, 3))
        los = rng.standard_normal((count, 3))
        los /= np.linalg.norm(los, axis=1)[:, None]
        clock = np.eye(clocks)[rng.permutation(np.arange(count) % clocks)]
        weight = rng.uniform(0.1, 3.0, count)
        pseudolite = rng.standard_normal(3)
        row = np.concatenate([-pseudolite / np.linalg.norm(pseudolite), np.eye(clocks)[0]])
        normal = np.hstack([-los, clock]).T @ (weight[:, None] * np.hstack([-los, clock]))
        if np.linalg.cond(normal) > 1e8:
            continue
        w = rng.uniform(0.1, 100.0)
        pdop = [np.sqrt(np.trace(np.linalg.inv(normal + n * w * np.outer(row, row))[:3, :3])) for n in range(3)]
        assert pdop[2] >= coincident_bound(pdop[0], pdop[1]) * (1.0 - 1e-9)
        tried += 1
    assert tried > 200
    least, printed = published_contradiction()
    assert least == pytest.approx(2.569, abs=1e-3)
    assert printed < least
