"""Range rates are the derivatives of ranges, whatever gives the satellites."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.gnss.signals import build_signals
from tests.helpers import case

EPOCH = "epoch=2020-06-25T10:00:00Z"
SKIES = {
    "almanac": ("sky.source=almanac", "sky.almanac=[{data}/almanacs/MCCJ_180913.agl]", "epoch=2018-09-13T12:00:00Z"),
    "nominal": ("sky.source=nominal",),
    "messages": ("sky.source=nominal", "sky.broadcast=true"),
    "navigation": ("sky.source=navigation", "sky.navigation={data}/esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz"),
    "orbits": ("sky.source=orbits", "sky.orbits=[{data}/esbc_2020177/GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz]"),
}


@pytest.mark.parametrize("sky", SKIES)
def test_range_rate_is_the_derivative_of_the_range(sky: str, request: pytest.FixtureRequest) -> None:
    """Slopes of polynomials through 81 ranges of 20 s each: to 50 um/s (a time of 1.6e9 s is rounded to 0.2 us, so
    a range to 0.2 mm). Without what a second of reception sees of the satellite's motion, (1 - range rate / c), it was
    up to 2.8 mm/s off."""
    settings = SKIES[sky]
    if sky in ("almanac", "navigation", "orbits"):
        data: Path = request.getfixturevalue("shared") / "data"
        settings = tuple(s.format(data=data) for s in settings)
    c = case(EPOCH, *settings, "pseudolites.count=2", "receiver.lever_arm_m=[2, 0.5, -1]", "sky.mask_deg=0")
    utc = c.scenario.epoch.timestamp()
    near = np.linspace(-10.0, 10.0, 81)
    largest = 0.0
    for time in (15.0, 40.0):  # on the glide, away from the corner at its end
        s = build_signals(c.trajectory.motion(time + near), utc, c.environment)
        heard = s.used.all(axis=0) & np.array([not name.startswith("PL") for name in s.names])
        assert heard.sum() > 8
        for i in np.flatnonzero(heard):
            fitted = np.polynomial.Polynomial.fit(near, s.range[:, i], 7).deriv()(0.0)
            largest = max(largest, abs(s.range_rate[40, i] - fitted))
        assert np.abs(s.range_rate[40, heard]).max() > 500.0
        # pseudolites, which the path curves beside
        ground = ~heard & s.used.all(axis=0)
        middle = (s.range[41, ground] - s.range[39, ground]) / (near[41] - near[39])
        np.testing.assert_allclose(s.range_rate[40, ground], middle, rtol=0.0, atol=1e-3)
    # the velocities of GLONASS's almanac algorithm are its own, 0.14 mm/s from the derivative of its positions
    assert largest < (2e-4 if sky == "almanac" else 5e-5)
