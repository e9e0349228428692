"""Ground stations of landing systems: coverage, outages, published limits in presets, messages."""

from __future__ import annotations

import math
import types
from typing import Any

import numpy as np
import pytest

from navsim.geodesy.earth import llh_from_ecef
from navsim.landing.preflight import station_warnings, warnings_of
from navsim.report.figures import source_style
from navsim.scenario.load import read
from navsim.scenario_files.presets import STATION_PRESETS
from navsim.scenario_files.source import InputError
from navsim.sensors.ground_stations import GroundStation
from navsim.simulation.aiding import Aid
from tests.helpers import SCENARIOS, case

BRIEF = ("duration_s=62", "receiver.rate_hz=1", "imu.rate_hz=20", "runway.length_m=3000")
AZIMUTH = "azimuth_station={preset: ils-1, noise_m: 1}"
ILS = "elevation_station={preset: ils, noise_deg: 0.1}"
DME = "dme={preset: dme-p, off_s: [[10, 20]]}"


def flown(*settings: str) -> tuple[Any, list[Aid]]:
    """A landing and its stations on the flight."""
    of = case(*BRIEF, *settings)
    assert all(isinstance(aid.sensor, GroundStation) for aid in of.shared.aids)
    return of, list(of.shared.aids)


def test_coverage_and_outages() -> None:
    """On the glide of 5 degrees the elevation from its foot is that of the glide, the azimuth is 0. On the ground there
    is no elevation. The DME pauses for ten seconds."""
    of, (azimuth, elevation, dme) = flown(AZIMUTH, "elevation_station={preset: mls, right_m: 15, beyond_m: 0.5}", DME)
    on_glide = elevation.time < 40.0
    np.testing.assert_allclose(np.degrees(elevation.exact[on_glide, 0]), 5.0, atol=0.02)
    assert np.isnan(elevation.exact[elevation.time > 60.5]).all()
    np.testing.assert_allclose(azimuth.exact, 0.0, atol=1e-6)
    assert np.array_equal(np.isnan(dme.exact[:, 0]), (dme.time >= 10.0) & (dme.time < 20.0))
    # 3300 m from the threshold, and the slant path before it
    assert dme.exact[0, 0] == pytest.approx(3300.0 + 1749.0 - 36.0 * 0.2, abs=6.0)
    assert azimuth.sigma[0, 0] == pytest.approx(1.0 / 3300.0)
    assert of.shared.aids[0].sensor.is_true_model


def test_faults_are_added_while_they_last() -> None:
    """Steps and ramps, of an azimuth in metres at the threshold, 3300 m from its antenna; the filter knows none."""
    sites = ("azimuth_station={noise_m: 1}", "elevation_station={noise_deg: 0.1}", "dme={noise_m: 1}")
    faults = ("azimuth_station.faults=[{at_s: 5, rate_m_s: 2}]", "dme.faults=[{error_m: 7}, {error_m: 1, at_s: 9}]",
              "elevation_station.faults=[{at_s: 5, until_s: 7, error_deg: 0.5, rate_deg_s: 0.1}]")  # fmt: skip
    (of, true), (_, wrong) = flown(*sites), flown(*sites, *faults)
    azimuth, elevation, dme = ((b.exact - a.exact)[:, 0] for a, b in zip(true, wrong, strict=True))
    time = true[0].time
    np.testing.assert_allclose(azimuth * 3300.0, 2.0 * np.maximum(time - 5.0, 0.0), atol=1e-9)
    lasts = (time >= 5.0) & (time < 7.0)
    early = time < 40.0
    due = np.where(lasts, 0.5 + 0.1 * (time - 5.0), 0.0)
    np.testing.assert_allclose(np.degrees(elevation)[early], due[early], atol=1e-9)
    np.testing.assert_allclose(dme, 7.0 + (time >= 9.0), atol=1e-9)
    assert of.shared.aids[0].sensor.is_true_model
    assert not wrong[0].sensor.is_true_model


def test_behind_and_beside_the_approach_there_is_no_azimuth() -> None:
    """Beyond the half width, and behind the antenna, a localizer measures nothing; a DME measures to all sides."""
    of, (azimuth, dme) = flown("azimuth_station={noise_m: 1, half_width_m: 100, beyond_m: 1000}", "dme={noise_m: 1}")
    frame = of.trajectory.frame
    places = np.array([[-500.0, 149.0, -60.0], [-500.0, 151.0, -60.0], [1500.0, 0.0, -60.0]])
    ecef = frame.origin + places @ frame.axes.T
    level = np.broadcast_to(np.eye(3), (3, 3, 3))
    motion = types.SimpleNamespace(position_ecef=ecef, llh=llh_from_ecef(ecef), c_nb=level, c_ne=level)
    flight: Any = types.SimpleNamespace(frame=frame, motion=lambda time: motion)
    time = np.zeros(3)
    assert np.isnan(azimuth.sensor.noise_free(flight, time)[:, 0]).tolist() == [False, True, True]
    assert not np.isnan(dme.sensor.noise_free(flight, time)).any()


@pytest.mark.parametrize(
    ("section", "preset", "limits"),
    [
        ("azimuth_station", "ils-1", {"bias_m": 10.5, "bends_m": 10.0}),
        ("azimuth_station", "ils-3", {"bias_m": 3.0, "bends_m": 5.0}),
        ("azimuth_station", "mls", {"bias_m": 6.096, "noise_m": 3.2004}),
        ("elevation_station", "mls", {"bends_deg": 0.087, "noise_deg": 0.05}),
        ("dme", "dme-n", {"bias_m": 370.0}),
        ("dme", "dme-p", {"bias_m": 30.0, "noise_m": 18.0}),
    ],
)
def test_presets_are_published_limits(section: str, preset: str, limits: dict[str, float]) -> None:
    """Limits hold for 95 % of a Gaussian error: 1.96 sigma."""
    its = STATION_PRESETS[section][preset]
    for key, limit in limits.items():
        assert 1.959963985 * its[key] == pytest.approx(limit, rel=1e-9)


def test_path_following_error_of_the_elevation_is_its_parts() -> None:
    its = STATION_PRESETS["elevation_station"]["mls"]
    assert 1.959963985 * math.hypot(its["bias_deg"], its["bends_deg"]) == pytest.approx(0.133)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("azimuth_station={preset: ils-1}",), "noise_m"),
        (("filter.dme={noise_m: 3}",), "there is none: give `dme"),
        (("dme={noise_m: 3, off_s: [[20, 10]]}",), "not after its start"),
        (("elevation_station={noise_deg: 1, low_deg: 3, high_deg: 2}",), "must be below"),
        (("dme={noise_m: 3}", "filter.dme={errors: none, bias_m: 3}"), "errors: states"),
        (("azimuth_station={noise_m: 3, beyond_m: -5}",), "beyond the threshold"),
        (("azimuth_station={noise_m: 3, beyond_m: 5}",), "of the aircraft"),
        (("elevation_station={noise_deg: 1, right_m: 0}",), "of the aircraft"),
        (("dme={noise_m: 3, faults: [{at_s: 3}]}",), "changes nothing"),
        (("dme={noise_m: 3, faults: [{at_s: 3, until_s: 3, error_m: 1}]}",), "must lie after at_s"),
        (("azimuth_station={noise_m: 1, right_m: 20}",), "stands on the centre line"),
        (("localizer={noise_m: 3}",), "did you mean 'azimuth_station'?"),
        (("glide_path={noise_deg: 3}",), "did you mean 'elevation_station'?"),
    ],
)
def test_messages(settings: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError) as caught:
        case(*BRIEF, *settings)
    assert words in str(caught.value.problems[0])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (ILS, "elevation_station: before touchdown the path is outside its sector, 2.28 to 3.72 deg, for"),
        ("elevation_station={noise_deg: 1, beyond_m: -9000}", "elevation_station.beyond_m: the aircraft is behind"),
        ("elevation_station={noise_deg: 1, height_m: 100}", "elevation_station.height_m: the antenna stands 100 m"),
        ("azimuth_station={noise_m: 1, beyond_m: 60000}", "azimuth_station: the antenna stands 60000 m beyond"),
        ("azimuth_station={noise_m: 1, beyond_m: 2400}", "azimuth_station.beyond_m: the antenna stands on the runway"),
        ("dme={noise_m: 1, off_s: [[1, 2], [200, 300]]}", "dme.off_s[1]: the outage begins at 200 s, after the end"),
        ("dme={noise_m: 1, faults: [{at_s: 90, error_m: 5}]}", "dme.faults[0]: the fault begins at 90 s, after"),
        ("dme={noise_m: 1, off_s: [[0, 30], [30, 90]]}", "dme.off_s: the station is off until touchdown"),
    ],
)  # fmt: skip
def test_stations_of_no_use_are_warned_of(settings: str, words: str) -> None:
    """Also by validation, which computes no measurement. The paths are at 5 degrees."""
    scenario = case(*BRIEF, settings).scenario
    assert any(text.startswith(words) for text in station_warnings(scenario, scenario.trajectory()))


def test_shipped_stations_are_in_order() -> None:
    scenario = case(name="landing_ils").scenario
    assert station_warnings(scenario, scenario.trajectory()) == []
    assert warnings_of(*read(SCENARIOS / "landing_ils.yaml")) == []


def test_sources_of_stations_differ_in_the_figure() -> None:
    """Each has a colour and hatch of its own, and takes none of the others'."""
    others = ["altimeter", "magnetometer", "clock"]
    stations = [f"{name}{end}" for name in ("azimuth_station", "elevation_station", "dme")
                for end in ("", "_bias", "_bends")]  # fmt: skip
    styles = source_style([*stations, *others])
    assert len(set(styles)) == len(styles)
    assert styles[-3:] == source_style(others)
