"""Pseudolites in a landing: how strong they are heard, what their noise is, what is said of them."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.scenario.source import InputError
from tests.helpers import case, scenario

BRIEF = ("duration_s=30", "receiver.rate_hz=2", "pseudolites.frame=runway", "sky.source=nominal-gps")
LIGHT = 299792458.0


def test_noise_by_the_link() -> None:
    """The loop's noise at the C/N0 that follows from power, distance, pattern, antenna and noise figure."""
    s = case(
        *BRIEF, "pseudolites.eirp_dbm=-25", "pseudolites.range_law=cn0", "receiver.noise_figure_db=3",
        "pseudolites.pattern={elevation_deg: [-90, 90], gain_db: [[-4, -4]]}",
    ).world.signals  # fmt: skip
    distance = np.linalg.norm(s.position[:, -2:] - s.antenna[:, None], axis=2)
    gain = -10.0 * (1.0 - np.sin(s.elevation[:, -2:]))
    noise = 10.0 * np.log10(1.380649e-23 * 290.0)
    cn0 = -25.0 - 30.0 - 4.0 - 20.0 * np.log10(4.0 * np.pi * distance * 1575.42e6 / LIGHT) + gain - noise - 3.0
    np.testing.assert_allclose(s.cn0[:, -2:], cn0, atol=1e-9)
    ratio = 10.0 ** (cn0 / 10.0)
    sigma = LIGHT / 1.023e6 * np.sqrt(0.5 / (2.0 * ratio) * (1.0 + 2.0 / (0.02 * 1.5 * ratio)))
    np.testing.assert_allclose(s.sigma[:, -2:], sigma, rtol=1e-9)
    np.testing.assert_array_equal(s.cn0[:, :-2][s.used[:, :-2]], 45.0)


def test_shadowed_pseudolites_are_counted_by_name() -> None:
    settings = (*BRIEF, "pseudolites.s_m=3000", "pseudolites.l1_m=1000", "wind.speed_m_s=0")
    plain, flown = case(*settings), case(*settings, "receiver.antenna={mask_deg: 5}")
    hidden = (~flown.world.signals.used[:, -2:]).sum(axis=0)
    assert plain.world.signals.used[:, -2:].all()
    assert (hidden > 0).all()
    for name, times in zip(("PL1", "PL2"), hidden, strict=True):
        text = f"receiver.antenna: the aircraft shadows {name} at {times} of 60 fixes"
        assert [said for said in flown.warnings if said == text]
    assert not [said for said in case(*settings, "receiver.antenna={}").warnings if "shadows" in said]


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("pseudolites.pattern={elevation_deg: [0, 90], gain_db: [[0, 0]]}", "relative to eirp_dbm"),
        ("pseudolites={count: 0, eirp_dbm: 0, cn0_reference_m: 100}", "is for cn0_dbhz"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {elevation_deg: [9, 0], gain_db: [[0, 0]]}}", "have to rise"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {elevation_deg: [0, 9], gain_db: [[0]]}}", "has 1 values"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {azimuth_deg: [0, 9], elevation_deg: [0, 9], gain_db: "
         "[[0, 0]]}}", "has 1 lists"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {azimuth_deg: [0, 360], elevation_deg: [0, 9], gain_db: "
         "[[0, 0], [0, 0]]}}", "360 is 0 again"),
        ("receiver.antenna={elevation_deg: [0, 45, 90]}", "gain_dbi: has 2 values, elevation_deg has 3"),
        ("interference={pseudolites: {}}", "give pseudolites.eirp_dbm, or pseudolites.cn0_reference_m"),
        ("interference={pseudolites: {lines: false, isolation_db: 21.1}}", "isolation_db: is of lines"),
    ],
)  # fmt: skip
def test_what_cannot_go_together(setting: str, said: str) -> None:
    with pytest.raises(InputError, match=said.replace(".", r"\.")):
        scenario(setting)


def test_strength_by_two_ways_is_told() -> None:
    (said,) = [w for w in case(*BRIEF, "pseudolites.eirp_dbm=0", "pseudolites.cn0_dbhz=50").warnings if "cn0_dbhz" in w]
    assert said == "pseudolites.cn0_dbhz: not used, the strength follows from eirp_dbm"
