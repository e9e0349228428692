"""Our RINEX readers against those of the `sidereon` package, value by value."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import Observations, read_obs
from navsim.gnss import timescales
from tests.rinex import CODES_2, in_version_4, labelled, navigation_3, observations_2, observations_3

UTC = timescales.posix(2018, 9, 13, 12)
J2000 = timescales.posix(2000, 1, 1, 12)
ION = """> ION G25 LNAV
    2018 09 13 11 33 54 2.514570951462e-08 1.490116119385e-08-1.192092895508e-07
    -5.960464477539e-08 1.331200000000e+05-1.638400000000e+04-2.621440000000e+05
     1.966080000000e+05"""
SCALED_3 = [labelled("G   10", "SYS / SCALE FACTOR"), labelled("G  100   2 C1C S1C", "SYS / SCALE FACTOR")]
OBSERVATIONS = {
    "version 2": observations_2(2.11, types=4),
    "version 2, blank last lines": observations_2(2.11, types=7, blank_from=5),
    "version 3": observations_3(),
    "version 3, scaled": observations_3(extra=SCALED_3),
    "version 4": observations_3().replace("3.04", "4.02", 1),
}


@pytest.fixture(scope="module")
def sidereon() -> Any:
    return pytest.importorskip("sidereon")


def judged(theirs: Any, ours: Observations, epochs: range) -> int:
    """Compare the values of epochs that either side has; returns how many there are."""
    assert theirs.epoch_count == ours.time.size
    count = 0
    for e in epochs:
        rows = theirs.observation_values(e)
        mine = np.zeros((len(ours.satellites), len(ours.values)), dtype=bool)
        codes = list(ours.values)
        for satellite, code, value in zip(rows.satellites, rows.codes, rows.values, strict=True):
            i = ours.satellites.index(satellite)
            if code not in codes:  # it renames those of version 2; they come in the order of the header
                code = [old for old in CODES_2 if old in codes][int(mine[i].sum())]
            j = codes.index(code)
            mine[i, j] = True
            np.testing.assert_array_equal(ours.values[code][e, i], np.nan if value == 0.0 else value)
            count += bool(np.isfinite(value))
        rest = np.array([[ours.values[c][e, i] for c in codes] for i in range(len(ours.satellites))])
        assert np.isnan(rest[~mine]).all()
    return count


@pytest.mark.validates("RINEX observations: versions 2, 3, 4, scale factors, blank lines", "sidereon 3.0.4",
                       "every value the same")  # fmt: skip
@pytest.mark.parametrize("kind", OBSERVATIONS)
def test_observations(kind: str, sidereon: Any, tmp_path: Path) -> None:
    (tmp_path / "obs").write_text(OBSERVATIONS[kind])
    theirs = sidereon.parse_rinex_obs(OBSERVATIONS[kind])
    assert judged(theirs, read_obs(tmp_path / "obs"), range(2)) >= 22


@pytest.mark.validates("RINEX observations: a real day, packed by Hatanaka", "sidereon 3.0.4", "every value the same")
def test_real_observations(sidereon: Any, shared: Path) -> None:
    path = shared / "data" / "esbc_2020177" / "ESBC_2020177_GR_60S.rnx.gz"
    theirs = sidereon.parse_rinex_obs(gzip.decompress(path.read_bytes()).decode())
    assert judged(theirs, read_obs(path), range(0, 1440, 40)) > 2500


def messages_judged(text: str, sidereon: Any, path: Path) -> None:
    path.write_text(text)
    found = read_nav(path)
    assert found.gps is not None
    assert found.glonass is not None
    theirs = [r for r in sidereon.parse_rinex_nav_records(text) if r.satellite[0] == "G"]
    assert [int(r.satellite[1:]) for r in theirs] == found.gps.prn.tolist() != []
    for i, record in enumerate(theirs):
        e, c = record.elements, record.clock
        toe = record.toe_week * timescales.WEEK + record.toe_tow_s
        for mine, their in (
            (found.gps.toe[i], toe), (found.gps.sqrt_a[i], e.sqrt_a), (found.gps.e[i], e.e), (found.gps.m0[i], e.m0),
            (found.gps.af0[i], c.af0), (found.gps.af1[i], c.af1), (found.gps.tgd[i], record.group_delay_s),
            (found.gps.healthy[i], record.sv_health == 0.0),
        ):  # fmt: skip
            assert mine == pytest.approx(their, rel=1e-15)
    theirs = sidereon.parse_rinex_glonass_records(text)
    assert [int(r.satellite[1:]) for r in theirs] == found.glonass.slot.tolist() != []
    for i, record in enumerate(theirs):
        np.testing.assert_allclose(found.glonass.position[i], record.position_m, rtol=1e-15)
        np.testing.assert_allclose(found.glonass.velocity[i], record.velocity_m_s, rtol=1e-15)
        np.testing.assert_allclose(found.glonass.acceleration[i], record.acceleration_m_s2, rtol=1e-15)
        assert found.glonass.channel[i] == record.freq_channel
        assert found.glonass.time[i] - J2000 == record.epoch_utc_j2000_s
        assert bool(found.glonass.healthy[i]) == record.is_healthy


@pytest.mark.validates("RINEX 4 messages: LNAV, FDMA with health flags", "sidereon 3.0.4", "every value the same")
@pytest.mark.parametrize("flags", [0, 1, 2, 3, 4, 5, 6, 7])
@pytest.mark.parametrize("status", ["", f"{1.0:19.12E}", f"{179.0:19.12E}"])
def test_messages_of_version_4(flags: int, status: str, sidereon: Any, tmp_path: Path) -> None:
    text = in_version_4(navigation_3(UTC), "4.00", ION.split("\n"), flags=f"{float(flags):19.12E}", status=status)
    messages_judged(text, sidereon, tmp_path / "nav")
    found = read_nav(tmp_path / "nav").klobuchar
    theirs = sidereon.parse_rinex_iono_corrections(text).gps
    assert found is not None
    np.testing.assert_array_equal(found[0], theirs.alpha)
    np.testing.assert_array_equal(found[1], theirs.beta)


@pytest.mark.validates("RINEX 3.05 messages: a real day", "sidereon 3.0.4", "every value the same")
def test_real_messages(sidereon: Any, shared: Path, tmp_path: Path) -> None:
    path = shared / "data" / "esbc_2020177" / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
    messages_judged(gzip.decompress(path.read_bytes()).decode(), sidereon, tmp_path / "nav")
