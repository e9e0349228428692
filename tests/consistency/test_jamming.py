"""Jammers beside a landing: what is left of each signal by plain formulas, what is lost and regained, and that the
filter stays honest."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.constellations.constellation import carriers
from navsim.landing.study import Case
from navsim.results.result import read
from navsim.scenario_files.source import InputError
from navsim.simulation import measurements
from tests.helpers import SCENARIOS, case, scenario
from tests.layout import as_declared
from tests.product.test_run import navsim

BRIEF = ("duration_s=30", "receiver.rate_hz=10", "filter.kind=eskf")
PLACE = {"lat_deg": 56.03, "lon_deg": 37.02}
NOISE: dict[str, Any] = {
    "name": "J1", "place": PLACE, "height_m": 10, "eirp_dbw": 0, "waveform": "noise", "centre_mhz": 1602,
    "bandwidth_mhz": 20, "on_s": [[8, 18]],
}  # fmt: skip
LIGHT = 299792458.0


def jammed(*jammers: dict[str, Any], settings: tuple[str, ...] = (), lock: dict[str, float] | None = None) -> Case:
    section = {"jammers": jammers} | ({} if lock is None else {"lock": lock})
    return case(*BRIEF, f"interference={json.dumps(section)}", *settings)


NEVER_LOST = {"lose_db_hz": 0.0, "regain_db_hz": 0.0}


def test_one_link_by_hand() -> None:
    """A satellite and an epoch: power, way, antenna, share of the band that the signal takes in, noise of the loops."""
    c = jammed(NOISE, lock=NEVER_LOST)
    plain = case(*BRIEF).shared.signals
    s, name, e = c.shared.signals, "R01", 120
    i = s.names.index(name)
    assert s.used[e, i]
    away = ecef_from_llh(np.array([math.radians(56.03), math.radians(37.02), 10.0])) - s.antenna[e]
    distance = float(np.linalg.norm(away))
    elevation = math.asin(float(c.shared.antenna_enu[e, 2] @ away) / distance)
    gain = -10.0 * (1.0 - math.sin(elevation))
    loss = 20.0 * math.log10(4.0 * math.pi * distance * 1602e6 / LIGHT)
    noise_density = 10.0 * math.log10(1.380649e-23 * 290.0)
    js = 0.0 - loss + gain - (45.0 + noise_density)
    assert s.js[0, e, i] == pytest.approx(js, abs=1e-6)
    # of white noise over 20 MHz a BPSK of 0.511 Mchip/s takes in all but what its side lobes have outside
    kappa = 1.0 / 20e6
    effective = -10.0 * math.log10(10.0**-4.5 + 10.0 ** (js / 10.0) * kappa)
    assert s.cn0[e, i] == pytest.approx(effective, abs=0.06)
    c_n0 = 10.0 ** (s.cn0[e, i] / 10.0)

    def code(ratio: float) -> float:
        chip = LIGHT / 0.511e6
        return chip**2 * 1.0 * 0.5 / (2.0 * ratio) * (1.0 + 2.0 / (0.02 * 1.5 * ratio))

    def rate(ratio: float) -> float:
        frequency = 1602e6 + 562500.0 * 1
        wavelength = LIGHT / frequency
        return (wavelength / (2.0 * math.pi * 0.02)) ** 2 * 4.0 * 2.0 / ratio * (1.0 + 1.0 / (0.02 * ratio))

    alone = 10.0**4.5
    assert s.sigma[e, i] ** 2 - plain.sigma[e, i] ** 2 == pytest.approx(code(c_n0) - code(alone), rel=1e-9)
    assert s.rate_sigma[e, i] ** 2 - plain.rate_sigma[e, i] ** 2 == pytest.approx(rate(c_n0) - rate(alone), rel=0.02)


def test_signals_are_lost_and_come_back() -> None:
    """After half a second below, and two seconds above; before the jammer begins nothing is different."""
    c, plain = jammed(NOISE | {"eirp_dbw": 20}), case(*BRIEF)
    s, time = c.shared.signals, c.shared.signals.time
    of_sky = np.array([name.startswith("R") for name in s.names]) & plain.shared.signals.used.all(axis=0)
    before = time < 8.0
    for name in ("used", "sigma", "rate_sigma", "los", "cn0", "range_bias"):
        np.testing.assert_array_equal(getattr(s, name)[before], getattr(plain.shared.signals, name)[before])
    lost = ~s.used[:, of_sky]
    expected = (time >= 8.5 - 1e-9) & (time < 20.0 - 1e-9)
    np.testing.assert_array_equal(lost, np.broadcast_to(expected[:, None], lost.shape))
    # the others' noise is drawn as ever
    drawn = [measurements.measured(world, 1, 0)[0] for world in (c.shared, plain.shared)]
    np.testing.assert_array_equal(drawn[0][before], drawn[1][before])
    assert np.isnan(drawn[0][~s.used]).all()


def test_a_narrow_jammer_takes_the_channel_it_is_on() -> None:
    """A tone on the carrier of channel 1: satellites of that channel are lost, others hear its side lobes."""
    tone = {"name": "J1", "place": PLACE, "eirp_dbw": 5, "waveform": "tone", "centre_mhz": 1602.5625}
    c = jammed(tone)
    s = c.shared.signals
    used = case(*BRIEF).shared.signals.used.all(axis=0)
    lost = {name for name, u, kept in zip(s.names, used, s.used[50], strict=True) if u and not kept}
    (group,) = c.environment.satellites
    channel = dict(zip(group.names, np.round((carriers(group.constellation) - 1602e6) / 562500.0), strict=True))
    assert lost
    assert {channel[name] for name in lost} == {1}


def test_two_jammers_and_one_beyond_the_horizon() -> None:
    """Noise adds up; a jammer 80 km away on the ground is not received by an aircraft below 200 m."""
    far = NOISE | {"name": "far", "place": {"lat_deg": 56.75, "lon_deg": 37.02}, "eirp_dbw": 90, "on_s": []}
    one, both, with_far = (jammed(*jammers, lock=NEVER_LOST) for jammers in (
        [NOISE], [NOISE, NOISE | {"name": "J2"}], [NOISE, far]))  # fmt: skip
    i, e = one.shared.signals.names.index("R01"), 120
    density = [10.0 ** (-c.shared.signals.cn0[e, i] / 10.0) - 10.0**-4.5 for c in (one, both)]
    assert density[1] == pytest.approx(2.0 * density[0], rel=1e-9)
    assert with_far.shared.signals.js[1, e, i] == -np.inf
    np.testing.assert_array_equal(with_far.shared.signals.cn0, one.shared.signals.cn0)


def test_the_filter_stays_honest_while_it_is_jammed() -> None:
    """The receiver weighs by the noise it has: innovations and errors of 60 jammed landings are what is believed."""
    c = jammed(NOISE | {"eirp_dbw": -5, "on_s": []})
    runs = list(c.fly_runs(31, 0, 60))
    nis = np.concatenate([r.innovation_squared for r in runs]).mean(axis=0) / 6.0
    assert float(np.nanmean(nis)) == pytest.approx(1.0, abs=0.02)
    nees = np.concatenate([r.nees_position_velocity for r in runs])[:, 100:].mean() / 6.0
    assert 0.85 < nees < 1.15
    still = case(*BRIEF)
    assert (c.shared.signals.fix_sigma[:, c.shared.signals.used.all(axis=0)].mean()
            > 1.3 * still.shared.signals.fix_sigma[:, still.shared.signals.used.all(axis=0)].mean())  # fmt: skip


def test_the_result_names_jammers(tmp_path: Path) -> None:
    settings = [part for key in (*BRIEF, f"interference={json.dumps({'jammers': [NOISE]})}") for part in ("--set", key)]
    for method in ("monte-carlo", "covariance"):
        navsim("run", SCENARIOS / "landing.yaml", *settings, "--method", method, "--figures", "none", "-q", "-o",
               f"{method}.h5", cwd=tmp_path)  # fmt: skip
        navsim("plot", f"{method}.h5", "--only", "interference", "--figures", "all", cwd=tmp_path)
        result = read(tmp_path / f"{method}.h5")
        as_declared(result)
        assert list(result["/interference/jammer"]) == ["J1"]
        on = (result["/interference/time"] >= 8.0) & (result["/interference/time"] < 18.0)
        used = np.isfinite(result["/interference/cn0"][0])
        assert np.isneginf(result["/interference/js"][0][~on][:, used]).all()
        assert np.nanmin(result["/interference/cn0"][on]) < 44.0
        assert (tmp_path / "all" / f"{method}_interference.png").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"waveform": "noise", "bandwidth_mhz": None}, "interference.jammers.0.bandwidth_mhz: a noise needs its width"),
        ({"waveform": "tone"}, "interference.jammers.0.bandwidth_mhz: a tone jammer has none"),
        ({"on_s": [[8, 8]]}, "interference.jammers.0.on_s.0: ends before it begins"),
        ({"waveform": "nois"}, "did you mean 'noise'?"),
        ({"eirp_dbw": 1e6}, "interference.jammers.0.eirp_dbw"),
    ],
)
def test_jammers_that_cannot_be(change: dict[str, Any], says: str) -> None:
    section = {"jammers": [{k: v for k, v in (NOISE | change).items() if v is not None}]}
    with pytest.raises(InputError) as error:
        scenario(f"interference={json.dumps(section)}")
    assert says in str(error.value)


def test_names_and_thresholds_are_checked() -> None:
    with pytest.raises(InputError, match="'J1' is given twice"):
        scenario(f"interference={json.dumps({'jammers': [NOISE, NOISE]})}")
    with pytest.raises(InputError, match="must not lie below lose_db_hz"):
        scenario(f"interference={json.dumps({'jammers': [NOISE], 'lock': {'lose_db_hz': 40, 'regain_db_hz': 30}})}")


def test_a_jammer_by_the_runway_is_heard_on_the_ground() -> None:
    """Antennas are 1 m high at least: there is no horizon of 0 m at touchdown; one that is never heard is told."""
    near = NOISE | {"place": {"lat_deg": 56.0178, "lon_deg": 37.0005}, "height_m": 0, "on_s": []}
    section = {"jammers": [near, near | {"name": "late", "on_s": [[200, 300]]}]}
    c = case("duration_s=65", "receiver.rate_hz=5", "filter.kind=eskf", f"interference={json.dumps(section)}")
    i = c.shared.signals.names.index("PL1")
    assert np.isfinite(c.shared.signals.js[0, :, i]).all()
    (text,) = [warning for warning in c.warnings if "jammers" in warning]
    assert "interference.jammers[1]: late is never received" in text
