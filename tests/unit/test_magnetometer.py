"""The magnetometer: its model by hand, its linearisation by numerical derivatives."""

from __future__ import annotations

import sys
import types
from typing import Any

import numpy as np
import pytest

from navsim.filter import eskf, states
from navsim.filter.measurement_kinds import MAGNETIC, Measurements
from navsim.filter.measurement_models import observe
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.report import figure_data, summary_tables
from navsim.results.result import Result, Variable
from navsim.scenario_files.source import InputError
from navsim.sensors.magnetometer import Magnetometer
from tests.helpers import case

FIELD = "declination_deg: 0, dip_deg: 66.03751102, intensity_ut: 49.24428901"
"""20 uT north and 45 uT down."""


def sensor(*keys: str) -> Magnetometer:
    """A magnetometer with hard iron of 1 uT and these keys."""
    settings = ", ".join(("noise_ut: 0.3, hard_iron_ut: 1", FIELD, *keys))
    (model,) = case("duration_s=10", "receiver.rate_hz=1", f"magnetometer={{{settings}}}").scenario.aiding()
    assert isinstance(model, Magnetometer)
    return model


def flight(height: float, *rpy: float) -> Any:
    """An aircraft so high above its runway, at a constant attitude, deg."""
    c_nb = dcm_from_rpy(np.radians(rpy))[None]
    llh = np.array([[0.9, 0.6, height]])
    return types.SimpleNamespace(motion=lambda time: types.SimpleNamespace(c_nb=c_nb), llh=lambda time: llh)


def test_what_it_measures() -> None:
    """Nose to the east: north is to the left, so 20 uT north are -20 uT to the right. A sensor turned by 90 degrees of
    yaw looks to the right."""
    time, east = np.zeros(1), flight(20.0, 0.0, 0.0, 90.0)
    plain = sensor("disturbance_ut: 4, disturbance_height_m: 10")
    np.testing.assert_allclose(plain.noise_free(east, time), [[0.0, -20.0, 45.0]], atol=1e-6)
    turned = sensor("mounting_deg: [0, 0, 90]")
    np.testing.assert_allclose(turned.noise_free(east, time), [[-20.0, 0.0, 45.0]], atol=1e-6)
    hard, field_model, scale, following, previous, disturbance = plain.effects(east, time)
    np.testing.assert_array_equal(hard[0], np.eye(3))
    # 1 uT more to the east is 1 uT forward; 1 uT more to the north 1 uT to the left
    np.testing.assert_allclose(field_model[0], [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(np.diagonal(scale[0]), [0.0, -20.0, 45.0], atol=1e-6)
    np.testing.assert_allclose(np.diagonal(following[0]), [-20.0, 45.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.diagonal(previous[0]), [45.0, 0.0, -20.0], atol=1e-6)
    np.testing.assert_allclose(disturbance, np.exp(-2.0) * field_model, atol=1e-12)
    assert [error.sigma for error in plain.errors] == [1.0, 0.14, 0.0, 0.0, 0.0, 4.0]


def test_its_linearisation() -> None:
    """Each column of H against the change of the prediction, at an attitude far from level and with all errors."""
    sizes = f"hard_iron_ut: 1, scale_percent: 2, misalignment_mrad: 10, disturbance_ut: 3, {FIELD}"
    flown = case("duration_s=10", "receiver.rate_hz=1", f"magnetometer={{noise_ut: 0.3, {sizes}}}")
    declared, ground = flown.flight.model.declared, flown.scenario.runway.ellipsoidal_m
    (aid,) = flown.shared.aids
    tables = Measurements.of({MAGNETIC: aid.table(np.zeros((1, 3)))})
    nav = np.zeros(states.NAV_SENSORS + declared.size)
    half = np.radians(35.0)
    nav[states.NAV_LLH : states.NAV_VEL] = 0.97, 0.64, ground + 8.0
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = np.cos(half), *(np.sin(half) * np.array([0.48, -0.6, 0.64]))
    rng = np.random.default_rng(4)
    nav[states.NAV_SENSORS :] = 0.5 * rng.standard_normal(declared.size) * np.repeat(flown.design.sensors.sigma, 3)
    n = states.SENSORS + declared.size

    def observed(nav: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, n)), np.zeros((6, 6))
        m = observe(MAGNETIC, 0, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r)
        assert m == 3
        np.testing.assert_array_equal(r[:3, :3], 0.09 * np.eye(3))
        return z[:3], h[:3]

    _, h = observed(nav)
    for k in range(n):
        step = np.zeros(n)
        step[k] = 1e-4 if k in (states.R_N, states.R_E, states.R_D) else 1e-6
        changed = []
        for sign in (1.0, -1.0):
            other = nav.copy()
            eskf.inject(other, sign * step)
            changed.append(observed(other)[0])
        found = (changed[1] - changed[0]) / (2.0 * step[k])
        np.testing.assert_allclose(h[:, k], found, atol=2e-6 * max(1.0, np.abs(found).max()), err_msg=str(k))
    assert np.abs(h[:, states.R_D]).max() > 1e-3, "the disturbance fades with height"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("magnetometer={noise_ut: 1}",), "hard_iron_ut"),
        (("magnetometer={noise_ut: 1, hard_iron_ut: 1, dip_deg: 70}",), "together"),
        (("filter.magnetometer={noise_ut: 1}",), "there is none: give `magnetometer"),
        ((f"magnetometer={{noise_ut: 1, hard_iron_ut: 1, rate_hz: 200, {FIELD}}}",), "imu.rate_hz"),
        (
            (f"magnetometer={{noise_ut: 1, hard_iron_ut: 1, {FIELD}}}",
             "filter.magnetometer={errors: none, hard_iron_ut: 3}"),
            "errors: states",
        ),
    ],
)  # fmt: skip
def test_messages(settings: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError) as caught:
        case(*settings)
    assert words in str(caught.value.problems[0])


def test_rows_and_states_follow_from_the_declaration() -> None:
    """Table and figures name the sensor and its states without a list of their own."""
    flown = case("duration_s=10", "receiver.rate_hz=1", f"magnetometer={{noise_ut: 1, hard_iron_ut: 1, {FIELD}}}")
    shown = figure_data.followed(list(flown.states), list(flown.state_units))
    assert [(one.label, one.axis) for one in shown[15:]] == [
        *(("magnetometer hard iron, µT", axis) for axis in "xyz"),
        *(("magnetometer field model, µT", axis) for axis in ("north", "east", "down")),
    ]
    names = np.array([*flown.states])
    result = Result(
        {"scenario": "kind: landing\nmagnetometer: {noise_ut: 1}\naltimeter: null\n"},
        {
            "/filter/state": Variable(("state",), names, "1", ""),
            "/summary/aiding/magnetometer/nis": Variable((), np.float64(1.0), "1", ""),
        },
    )
    assert summary_tables._sensors(result) == ["magnetometer"]
    assert summary_tables._further_states(result) == {"magnetometer": 6}


def test_a_field_without_a_model_says_what_to_give(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygeomag", None)
    with pytest.raises(InputError, match="or give the number: declination_deg, dip_deg and intensity_ut"):
        case("magnetometer={noise_ut: 1, hard_iron_ut: 1}")
