"""FAS data blocks: published ones bit by bit, and that of a landing.

The blocks are those of https://mrsoft.fi/ohj04en.htm, made by the EUROCONTROL tool: in the second one the threshold is
100 m further and 1 m higher.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.export import export
from navsim.formats.fas import FIELDS, SIZE, decode, encode
from navsim.geodesy import earth
from navsim.landing.result import result as summarised
from navsim.landing.study import fly_all
from navsim.results.result import ResultError
from navsim.runner.executor import threads
from tests.helpers import case

PUBLISHED = tuple(
    bytes.fromhex(text)
    for text in (
        "10181806050C00000132310538AD181B2C59E4098216B057FD405100F4015E016400C8FA4D87B43E",
        "10181806050C0000013231050694181B2F5CE4098C16E270FD3D4E00F4015E016400C8FA46DA408B",
    )
)


@pytest.mark.parametrize("block", PUBLISHED)
def test_a_published_block(block: bytes) -> None:
    """Bit by bit, there and back."""
    values = decode(block)
    assert (values["airport"], values["path"], values["runway"], values["service provider"]) == ("EFXX", "E12A", 12, 1)
    found = [values[name] for name in ("glide path angle", "course width", "horizontal alert limit",
                                       "vertical alert limit", "crossing height", "crossing height in m")]  # fmt: skip
    np.testing.assert_allclose(found, [3.5, 105.0, 40.0, 50.0, 500, 0], atol=1e-9)
    assert encode(values) == block


def test_the_second_threshold() -> None:
    """100 m along the runway and 1 m higher; both approaches have one alignment point."""
    places, points = [], []
    for values in map(decode, PUBLISHED):
        lat, lon, up = (float(values[f"threshold {name}"]) for name in ("latitude", "longitude", "height"))
        more = [float(values[f"alignment {name}"]) for name in ("latitude", "longitude")]
        places.append(earth.ecef_from_llh(np.array([*np.radians(np.array([lat, lon]) / 3600.0), up])))
        points.append([lat + more[0], lon + more[1]])
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(100.0, abs=0.1)
    assert float(decode(PUBLISHED[1])["threshold height"]) - float(decode(PUBLISHED[0])["threshold height"]) == (
        pytest.approx(1.0)
    )
    np.testing.assert_allclose(points[0], points[1], atol=1e-6)


def test_any_wrong_bit_is_found() -> None:
    for bit in range(8 * SIZE):
        block = bytearray(PUBLISHED[0])
        block[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ValueError, match="checksum"):
            decode(bytes(block))
    with pytest.raises(ValueError, match="40 bytes"):
        decode(PUBLISHED[0][1:])


@pytest.mark.parametrize(("name", "value"), [
    ("airport", "efxx"), ("path", "E12"), ("course width", 200.0), ("vertical alert limit", 51.2),
    ("threshold height", -513.0), ("alignment latitude", 5000.0),
])  # fmt: skip
def test_what_a_block_cannot_hold(name: str, value: float | str) -> None:
    with pytest.raises(ValueError, match=name):
        encode(decode(PUBLISHED[0]) | {name: value})


def test_the_block_of_a_landing(tmp_path: Path) -> None:
    """Its numbers are those of the scenario, to half of their resolution."""
    given = ("integrity={limits: {hal_m: 40, val_m: 35, tta_s: 6}}", "runway.aim_point_m=300", "runway.slope_percent=1",
             "duration_s=2",
             "approach.indicator={system: gls, course_width_m: 105, course_origin_m: 2305}",
             "approach.flight_technical_error.lateral={sigma_m: 1}")  # fmt: skip
    one = case(*given)
    flown = summarised(one, fly_all(one, 1, 0, 1, threads(1), keep="none"), 1, keep="none")
    (path,) = export(flown, tmp_path / "one.h5", ["fas"])
    first, *rows = path.read_text().splitlines()
    values = decode(bytes.fromhex(first))
    assert len(rows) == len(FIELDS)
    threshold, heading = flown["/truth/threshold_llh"], np.radians(one.scenario.runway.heading_deg)
    arcsec = [float(values[f"threshold {name}"]) for name in ("latitude", "longitude")]
    np.testing.assert_allclose(arcsec, 3600.0 * np.degrees(threshold[:2]), atol=2.6e-4)
    more = [float(values[f"alignment {name}"]) for name in ("latitude", "longitude")]
    lat, lon = np.radians(np.add(arcsec, more) / 3600.0)
    ahead, right, _ = earth.in_heading_axes(earth.ecef_from_llh(np.array([lat, lon, threshold[2]])), threshold, heading)
    assert (ahead, right) == pytest.approx((2000.0, 0.0), abs=0.05)
    due = 300.0 * np.tan(np.radians(5.0)) + 3.0  # the touchdown point is above the threshold
    assert float(values["crossing height"]) * 0.05 == pytest.approx(due, abs=0.026)
    numbers = {"glide path angle": 5.0, "course width": 105.0, "horizontal alert limit": 40.0,
               "vertical alert limit": 35.0, "runway": round(np.degrees(heading) / 10.0) % 36 or 36}  # fmt: skip
    for name, due in numbers.items():
        assert float(values[name]) == pytest.approx(due), name
    for missing, key in (("/summary/indicator/scale_origin", "indicator"), ("/summary/integrity/hal", "limits")):
        kept = flown.variables.pop(missing)
        with pytest.raises(ResultError, match=key):
            export(flown, tmp_path / "two.h5", ["fas"])
        flown.variables[missing] = kept
