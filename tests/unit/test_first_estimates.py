"""Filters with constrained linearisation points, against an independent numpy transition."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import states
from navsim.filter.covariance import NOISE_N
from navsim.filter.eskf import inject
from navsim.filter.estimate import FILTER_KINDS, estimate
from navsim.filter.first_estimates import note_shift, start_transition
from navsim.filter.measurement_kinds import FIX, FixTable, Measurements
from navsim.filter.records import OUTPUT, Events, FilterModel, History, ImuData, start
from navsim.filter.states import ATT, N_BASE, PHI_D, POS, VEL
from tests.helpers import case, cross
from tests.unit.test_covariance import some_covariance

ESKF = FILTER_KINDS["eskf"]
CONSTRAINED = [FILTER_KINDS["first-estimates"], FILTER_KINDS["observability-constrained"]]
LLH = np.array([0.98, 0.64, 150.0])
STEP, FIXES, END = 0.01, (0.5, 1.0, 1.5), 2.0
SIGMA = np.repeat([10.0, 1.0, 0.1, 3e-3, 1e-2], 3)
GRAVITY = 9.8


def beginning() -> np.ndarray:
    nav = np.zeros(states.NAV_N)
    nav[:3], nav[3:6], nav[6] = LLH, (30.0, -4.0, 3.0), 1.0
    return nav


def flown(kind: int, fixes: tuple[float, ...] = FIXES) -> History:
    """Two seconds of steady flight without noise, body axes north, east, down; outputs before and after each fix."""
    count = round(END / STEP)
    force = np.tile([0.4, -0.2, -GRAVITY], (count, 1))
    imu = ImuData(STEP * np.arange(count + 1), np.zeros((count, 3)), STEP * force)
    random, rows = np.random.default_rng(8), len(fixes)
    table = FixTable(
        LLH + random.standard_normal((rows, 3)) * [1e-6, 1e-6, 5.0],
        np.array([31.0, -3.0, 2.5]) + 0.5 * random.standard_normal((rows, 3)),
        np.tile(np.diag([9.0, 9.0, 25.0, 0.04, 0.04, 0.04]), (rows, 1, 1)),
        np.zeros(3),
    )
    moments = [
        (at, what, row) for k, at in enumerate(fixes) for what, row in ((OUTPUT, 2 * k), (FIX, k), (OUTPUT, 2 * k + 1))
    ]
    time, kinds, row = (np.array(x) for x in zip(*moments, (END, OUTPUT, 2 * rows), strict=True))
    events = Events(time.astype(float), kinds, row, np.zeros(time.size, np.bool_))
    no_gate = np.full(states.MAX_MEASUREMENT_SIZE + 1, np.inf)
    model = FilterModel(kind, np.zeros((1, NOISE_N)), states.declared(states.biases()), no_gate, 0)
    return estimate(imu, Measurements.of({FIX: table}), events, start(beginning(), np.diag(SIGMA**2)), model)


def metres(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """North, east, down from one latitude, longitude, height to another, on a sphere as curved as the ellipsoid."""
    equator, squared = 6378137.0, 6.69437999014e-3
    w = 1.0 - squared * np.sin(before[0]) ** 2
    meridian, transverse = equator * (1.0 - squared) / w**1.5, equator / w**0.5
    turn = after - before
    return np.array(
        [turn[0] * (meridian + before[2]), turn[1] * (transverse + before[2]) * np.cos(before[0]), -turn[2]]
    )


def transition(origin: np.ndarray, corrected: np.ndarray, end: np.ndarray, dt: float) -> np.ndarray:
    """Phi from what the states at both ends are estimated to be, on a flat Earth: Li & Mourikis (2013), Hesch et al.
    (2014). origin: the one that attitude errors start from; corrected: the one that the sensors are mechanised from."""
    g = np.array([0.0, 0.0, 9.8217])
    by_velocity = end[3:6] - origin[3:6] - g * dt
    by_position = metres(end[:3], origin[:3]) - origin[3:6] * dt - 0.5 * g * dt**2
    force, attitude = (end[3:6] - corrected[3:6]) / dt - g, dcm(corrected)
    phi, eye = np.eye(N_BASE), np.eye(3)
    blocks = {
        (POS, VEL): eye * dt,
        (POS, ATT): -cross(by_position),
        (VEL, ATT): -cross(by_velocity),
        (ATT, 9): -attitude * dt,
        (VEL, 9): cross(force) @ attitude * dt**2 / 2,
        (POS, 9): cross(force) @ attitude * dt**3 / 6,
        (VEL, 12): -attitude * dt,
        (POS, 12): -attitude * dt**2 / 2,
    }
    for (row, column), block in blocks.items():
        phi[row : row + 3, column : column + 3] = block
    return phi


def dcm(nav: np.ndarray) -> np.ndarray:
    w, x, y, z = nav[states.NAV_QUAT : states.NAV_BIAS_FRAME]
    axis = cross(np.array([x, y, z]))
    return np.eye(3) + 2.0 * w * axis + 2.0 * axis @ axis


@pytest.mark.parametrize("kind", CONSTRAINED)
def test_the_transition_is_between_predicted_states(kind: int) -> None:
    """Each interval between fixes: P before the next fix against Phi P Phi' in numpy, with Phi of first estimates; of
    the constrained kind the usual Phi, whose attitude columns are changed least so that a turn about the vertical
    does what the first estimates say."""
    history = flown(kind)
    for k in range(len(FIXES)):
        predicted, corrected, last = (history.navigation[2 * k + i] for i in range(3))
        dt = (*FIXES, END)[k + 1] - FIXES[k]
        own, first = (transition(origin, corrected, last, dt) for origin in (corrected, predicted))
        u = np.eye(N_BASE)[PHI_D]
        constrained = own - np.outer((own - first) @ u, u)
        chosen = first if kind == FILTER_KINDS["first-estimates"] else constrained
        p, found = history.covariance[2 * k + 1 : 2 * k + 3]
        expected, usual = (phi @ p @ phi.T for phi in (chosen, own))
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((found - expected) / scale).max() < 2e-3
        assert np.abs((found - usual) / scale).max() > 1e-2, "a fix that corrects too little shows nothing"


@pytest.mark.parametrize("kind", CONSTRAINED)
def test_a_rotation_that_nothing_shows_stays_one(kind: int) -> None:
    """The rotation of a flight about an axis, (e x r, e x v, e): before the correction and after it."""
    move = np.concatenate([[3.0, -2.0, 1.0, 0.8, -0.5, 0.3, 0.02, -0.03, 0.1], np.zeros(6)])
    predicted, corrected, work = beginning(), beginning(), np.empty(N_BASE)
    inject(corrected, move)
    r, v = np.array([100.0, -50.0, 20.0]), predicted[3:6]
    for axis, e in enumerate(np.eye(3)):
        before, after = np.zeros(N_BASE), np.zeros(N_BASE)
        for vector, shift, speed in ((before, 0.0, 0.0), (after, move[:3], move[3:6])):
            vector[:9] = np.concatenate([np.cross(e, r + shift), np.cross(e, v + speed), e])
        if kind != FILTER_KINDS["first-estimates"] and axis < 2:
            after = before  # tilts keep the usual transition
        p = np.outer(before, before)
        shift = np.zeros(6)
        note_shift(corrected, predicted, work, shift)
        start_transition(kind, shift, p)
        assert not shift.any()
        np.testing.assert_allclose(p, np.outer(after, after), rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(p, p.T)


@pytest.mark.parametrize("kind", CONSTRAINED)
def test_eskf_where_nothing_is_corrected(kind: int) -> None:
    """The same bits up to the first fix and in it; another covariance at the next."""
    usual, other = flown(ESKF), flown(kind)
    np.testing.assert_array_equal(other.navigation[:3], usual.navigation[:3])
    np.testing.assert_array_equal(other.covariance[:2], usual.covariance[:2])
    assert np.abs(other.covariance[2] - usual.covariance[2]).max() > 1e-3
    p = some_covariance(7)
    same = p.copy()
    start_transition(kind, np.zeros(6), same)
    np.testing.assert_array_equal(same, p)


@pytest.mark.parametrize("kind", ["first-estimates", "observability-constrained"])
def test_the_steady_part_of_the_force_is_not_added_to_it(kind: str) -> None:
    """Corrections of velocity are part of the force already: with both they would count twice."""
    assert case("filter.kind=eskf").flight.model.steady_force
    assert not case(f"filter.kind={kind}").flight.model.steady_force
