"""Lanes: W runs in a register give each run the bits that it has alone, whatever its neighbours do."""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Callable, Sequence
from functools import cache

import numba
import numpy as np
import pytest

from navsim.compiler import lanes
from navsim.compiler.elementary import atan2, sincos, sincos_of_latitude
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, any_lane, as_simd, fma, in_lanes, no, small_matrix, small_vector, where
from navsim.compiler.linear import cholesky
from navsim.filter import estimate, evaluation, states
from navsim.filter.covariance import _transition_rows
from navsim.filter.measurement_kinds import FIX, FixTable, Measurements
from navsim.filter.records import (
    GAUSSIAN_SUM,
    OUTPUT,
    Events,
    FilterModel,
    History,
    ImuData,
    OutputErrors,
    State,
    Truth,
    empty_error_history,
    schedule,
    start,
)
from navsim.geodesy.attitude_kernels import difference, half_sinc, left_jacobian
from navsim.geodesy.earth_kernels import ecef_to_llh
from navsim.landing.ensemble import LandingStudy
from navsim.simulation.flight import exact_start
from tests.helpers import case

WIDTHS = lanes.WIDTHS


@kernel
def everything(a, b, out):
    """Every operation that lanes know, in one expression after another."""
    a, b, out = as_simd(a), as_simd(b), as_simd(out)
    heap, matrix, vector = alloc(a, (2, 3)), small_matrix(a, 2, 2), small_vector(a, 2)
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i] - 2
        total /= 1.5
    heap[1, 2] = -total
    matrix[0, 1] = fma(total, 2.0, heap[1, 2])
    vector[1] = math.floor(matrix[0, 1]) + math.sqrt(abs(total))
    out[0] = vector[1]
    out[1] = where((a[0] < b[0]) & no(a[0] >= 0.5) | (a[1] == a[1]), a[0], b[0])
    out[2] = where(math.isnan(a[2] / 0.0 * 0.0), 1, total)
    out[3] = where(a[0] > b[0], a[0], where(a[0] <= b[0], b[0], math.nan))
    out[4] = 1.0 if any_lane(a[1] != a[1]) else 2.0
    sine, cosine = sincos(a[0])
    out[5] = sine
    out[6] = cosine
    out[7] = atan2(a[0], b[0])


@pytest.mark.parametrize("width", WIDTHS)
def test_operations_give_each_lane_what_a_number_gets(width: int) -> None:
    rng = np.random.default_rng(width)
    a, b, out = rng.standard_normal((4, width)), rng.standard_normal((4, width)), np.empty((8, width))
    everything(in_lanes(a), in_lanes(b), in_lanes(out))
    for lane in range(width):
        one = np.empty(8)
        everything(a[:, lane].copy(), b[:, lane].copy(), one)
        np.testing.assert_array_equal(out[:, lane], one)
    assert np.all(np.isfinite(out))


@pytest.mark.parametrize(
    "array", [np.zeros((6, 8))[::2], np.zeros((3, 9))[:, 1:], np.zeros((3, 6)), np.zeros((2, 4), int)]
)
def test_what_is_no_lanes_is_refused(array: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no lanes"):
        in_lanes(array)


@kernel
def _sincos_of(x, sine, cosine):
    for i in range(x.shape[0]):
        sine[i], cosine[i] = sincos(x[i])


@kernel
def _atan2_of(y, x, out):
    for i in range(x.shape[0]):
        out[i] = atan2(y[i], x[i])


def test_sine_and_cosine() -> None:
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-7, 7, 100_000), rng.uniform(-1e5, 1e5, 100_000), np.arange(-8, 9) * np.pi / 4])
    sine, cosine = np.empty_like(x), np.empty_like(x)
    _sincos_of(x, sine, cosine)
    assert np.abs(sine - np.sin(x)).max() <= 1.2e-16
    assert np.abs(cosine - np.cos(x)).max() <= 1.2e-16


@kernel
def _latitudes(x, sine, cosine):
    for i in range(x.shape[0]):
        sine[i], cosine[i] = sincos_of_latitude(x[i])


def test_sine_and_cosine_of_latitudes() -> None:
    x = np.concatenate([np.random.default_rng(1).uniform(-np.pi / 2, np.pi / 2, 100_000), [0.0, np.pi / 2, -np.pi / 2]])
    sine, cosine = np.empty_like(x), np.empty_like(x)
    _latitudes(x, sine, cosine)
    assert np.abs(sine - np.sin(x)).max() <= 3e-16
    assert np.abs(cosine - np.cos(x)).max() <= 3e-16


def test_arctangent() -> None:
    rng = np.random.default_rng(2)
    y, x = rng.standard_normal((2, 200_000)) * 10.0 ** rng.uniform(-6, 6, (2, 200_000))
    y[:5], x[:5] = [0.0, 0.0, 1.0, -1.0, 0.0], [1.0, -1.0, 0.0, 0.0, 0.0]
    out, expected = np.empty_like(x), np.arctan2(y, x)
    _atan2_of(y, x, out)
    assert np.abs(out - expected)[expected == 0.0].max() == 0.0
    assert np.abs(out / np.where(expected == 0.0, 1.0, expected) - 1.0)[expected != 0.0].max() < 4e-16


@kernel
def _mixed(theta, out):
    """Functions whose closed forms and series meet within a register."""
    theta, out = as_simd(theta), as_simd(out)
    jacobian, p, q, turned = small_matrix(theta, 3, 3), small_vector(theta, 4), small_vector(theta, 4), out[0:3]
    left_jacobian(theta[0], theta[1], theta[2], jacobian)
    for i in range(4):
        p[i] = 0.0
        q[i] = 1.0 if i == 0 else 0.0
    s, c = half_sinc(theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2])
    p[0] = c
    for i in range(3):
        p[1 + i] = s * theta[i]
    difference(p, q, turned)
    out[3] = jacobian[0, 1] + jacobian[2, 2]
    ecef_to_llh(6.4e6 * theta[0], 6.4e6 * theta[1], 6.4e6 + theta[2], out[4:7])


def test_small_and_large_angles_side_by_side() -> None:
    theta = np.random.default_rng(3).standard_normal((3, 8)) * [1e-6, 0.5, 0.05, 1e-3, 0.3, 0.0, 0.9, 1e-9]
    theta[:, 5] = 0.0
    theta[2, 5] = 1e-20
    out = np.empty((7, 8))
    _mixed(in_lanes(theta), in_lanes(out))
    for lane in range(8):
        alone = np.empty((7, 8))
        _mixed(in_lanes(np.repeat(theta[:, lane : lane + 1], 8, axis=1)), in_lanes(alone))
        np.testing.assert_array_equal(out[:, lane], alone[:, 0])
    np.testing.assert_allclose(out[:3], theta, rtol=1e-14, atol=1e-22)


@kernel
def _factor(a, good):
    a, good = as_simd(a), as_simd(good)
    good[0] = where(cholesky(a, a.shape[0]), 1.0, 0.0)


def test_a_lane_that_is_not_positive_definite_says_so_alone() -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((4, 4))
    a, good = np.repeat((root @ root.T)[..., None], 4, axis=2), np.empty((1, 4))
    a[2, 2, 1] = -1.0
    a[0, 0, 3] = np.nan
    _factor(in_lanes(a), in_lanes(good))
    np.testing.assert_array_equal(good[0], [1.0, 0.0, 1.0, 0.0])
    np.testing.assert_allclose(np.tril(a[..., 0]), np.linalg.cholesky(root @ root.T), rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(np.tril(a[..., 0]), np.tril(a[..., 2]))


def _tiled(array: np.ndarray, width: int) -> np.ndarray:
    return np.repeat(array[..., None], width, axis=-1)


@cache
def _flight() -> tuple[ImuData, FixTable, Events, np.ndarray, np.ndarray, FilterModel, Truth]:
    """Twenty seconds of a landing with fixes that come late, as one run has them."""
    drifting = ("imu.gyro.markov_deg_h=50", "imu.gyro.markov_time_s=40",
                "imu.accelerometer.markov_mg=0.5", "imu.accelerometer.markov_time_s=60")  # fmt: skip
    c = case("duration_s=20", "receiver.latency_s=0.15", "filter.gate.probability=1e-3", *drifting)
    world, run = c.shared, c.fly(1, 0)
    rng = np.random.default_rng(5)
    imu = ImuData(world.imu_time, world.dtheta + 1e-5, world.dv + 1e-4)
    count = run.fix_llh.shape[0]
    covariance = np.tile(np.diag([9.0, 9.0, 25.0, 0.04, 0.04, 0.04]), (count, 1, 1))
    covariance[:, 0, 1] = covariance[:, 1, 0] = 2.0
    fixes = FixTable(run.fix_llh + 1e-7 * rng.standard_normal((count, 3)), run.fix_velocity, covariance, np.ones(3))
    at = world.at_filter
    truth = Truth(at.llh, at.velocity_ned, at.quaternion, np.zeros((at.time.size, 6)))
    nav = exact_start(at)
    return imu, fixes, c.flight.events, nav, c.flight.covariance, c.flight.model, truth


def _without_ahead(events: Events) -> Events:
    """The same for a smoother, which has nothing to run ahead of."""
    valid = events.time[events.rows(FIX)]
    return schedule(np.unique(events.time[events.kind == OUTPUT]), (FIX, valid, valid))


def _model(kind: int, model: FilterModel) -> FilterModel:
    """The model of another kind; a Gaussian sum has little room, and divides and merges all the time."""
    return model._replace(kind=kind, components=9 if kind == GAUSSIAN_SUM else 0, split_heading_sigma=0.03)


Spoil = Callable[[State, dict[str, np.ndarray]], None]


def _before(width: int, kind: int, spoil: Spoil) -> tuple[ImuData, Measurements, Events, State, FilterModel, Truth]:
    """What lanes fly with that fly the same, but for what `spoil` makes of them; and beside what truth."""
    imu, fixes, events, nav, covariance, model, truth = _flight()
    tables = {name: _tiled(getattr(fixes, name), width) for name in ("llh", "velocity", "covariance")}
    model = _model(kind, model)
    state = start(_tiled(nav, width), _tiled(covariance, width), model.components)
    spoil(state, tables)
    measurements = Measurements.of({FIX: FixTable(**tables, lever_arm=fixes.lever_arm)}, width)
    if kind in estimate.records.SMOOTHERS:
        events = _without_ahead(events)
    return imu, measurements, events, state, model, truth.each(lambda sensors: _tiled(sensors, width))


def _flown(width: int, kind: int, spoil: Spoil) -> dict[str, np.ndarray]:
    """Histories of such lanes, and what they are worth."""
    imu, measurements, events, state, model, truth = _before(width, kind, spoil)
    out: dict[str, list[np.ndarray]] = {name: [] for name in (*History._fields, *OutputErrors._fields)}
    for _, rows, piece in estimate.fly_in_pieces(imu, measurements, events, state, model):
        judged = evaluation.evaluate(model, piece, Truth(*(m[rows] for m in truth)))
        for name, kept in out.items():
            kept.append((getattr(piece, name) if name in piece._fields else getattr(judged, name)).copy())
    return {
        **{name: np.concatenate(kept) for name, kept in out.items()},
        "state": state.navigation, "p": state.covariance, "rejected": state.rejected,
        "weight": state.components.weight,
    }  # fmt: skip


def _bad_company(lane: int) -> Callable[[State, dict[str, np.ndarray]], None]:
    """Neighbours of `lane` that are nan, lose fixes, positions or velocities, have wild ones, start far off or with a
    covariance that is none."""

    def spoil(state: State, tables: dict[str, np.ndarray]) -> None:
        width = state.navigation.shape[-1]
        others = [(lane + k) % width for k in range(1, width)]
        of_sum = state.components
        navigation, covariance = state.navigation, state.covariance
        if of_sum.weight.size:
            navigation, covariance = of_sum.navigation[0], of_sum.covariance[0]
        navigation[:, others[0]] = np.nan
        tables["llh"][20:90, :, others[1]] = np.nan
        tables["velocity"][20:80, :, others[1]] = np.nan
        tables["velocity"][::3, 1, others[1]] = np.nan
        tables["llh"][30:60, :, others[2]] += 1e-3
        if width > 4:
            navigation[states.NAV_QUAT : states.NAV_BIAS_FRAME, others[3]] = [0.0, 0.0, 0.0, 1.0]
            covariance[3, 3, others[4]] = -5.0
            covariance[..., others[5]] = np.inf
            tables["covariance"][50:, :, :, others[6]] = 0.0

    return spoil


@pytest.mark.parametrize(
    ("kind", "widths"),
    [
        ("eskf", [lanes.WIDTH]),
        ("observability-constrained", [lanes.WIDTH]),
        ("left-invariant", [lanes.WIDTH]),
        ("tfg", [lanes.WIDTH]),
        ("gaussian-sum", [lanes.WIDTH]),
        # the other width is compiled for that, for half a minute and a minute
        *(pytest.param(kind, WIDTHS, marks=pytest.mark.long) for kind in ("tfg", "gaussian-sum")),
        ("map", [lanes.WIDTH]),
    ],
)
def test_bits_do_not_depend_on_the_neighbours(kind: str, widths: Sequence[int]) -> None:
    """Any place in the register, any neighbours, either width: the same bits."""
    number = estimate.FILTER_KINDS[kind]
    alone = _flown(lanes.WIDTH, number, lambda state, tables: None)
    assert np.isfinite(alone["covariance"]).all()
    for width in widths:
        for lane in (0, 2, width - 1):
            among = _flown(width, number, _bad_company(lane))
            for name, values in among.items():
                np.testing.assert_array_equal(
                    values[..., lane], alone[name][..., 0], err_msg=f"{name}, {width}, {lane}"
                )


def test_a_run_of_one_component_among_runs_of_many() -> None:
    """A Gaussian sum that has nothing to divide has its bits, however many components its neighbours fly."""

    def known(*lanes_: int) -> Callable[[State, dict[str, np.ndarray]], None]:
        def spoil(state: State, tables: dict[str, np.ndarray]) -> None:
            for lane in lanes_:
                state.components.covariance[0, states.PHI_D, :, lane] = 0.0
                state.components.covariance[0, :, states.PHI_D, lane] = 0.0
                state.components.covariance[0, states.PHI_D, states.PHI_D, lane] = 1e-8
                state.components.covariance[0, 9:12, 9:12, lane] *= 1e-4

        return spoil

    alone = _flown(lanes.WIDTH, GAUSSIAN_SUM, known(*range(lanes.WIDTH)))
    among = _flown(lanes.WIDTH, GAUSSIAN_SUM, known(2))
    there = among["weight"] > 0.0
    assert there[:, 2].sum() == 1
    assert there[:, 0].sum() > 3
    for name, values in among.items():
        np.testing.assert_array_equal(values[..., 2], alone[name][..., 2], err_msg=name)


@pytest.mark.parametrize("kind", estimate.FILTER_KINDS)
def test_an_account_is_what_the_history_is_worth(kind: str) -> None:
    """Of smoothers, whose histories are judged either way, only what is copied is tried."""
    number = estimate.FILTER_KINDS[kind]
    history = _flown(lanes.WIDTH, number, _bad_company(0))
    imu, measurements, events, state, model, truth = _before(lanes.WIDTH, number, _bad_company(0))
    account = empty_error_history(truth, history["error"].shape[1], events.time.size, lanes.WIDTH)
    every = _tiled(imu.dtheta, lanes.WIDTH), _tiled(imu.dv, lanes.WIDTH)
    estimate.run_filter(ImuData(imu.time, *every), measurements, events, state, model, account)
    for name in OutputErrors._fields:
        np.testing.assert_array_equal(getattr(account.errors, name), history[name], err_msg=name)
    for name in ("innovation_squared", "degrees", "status"):
        np.testing.assert_array_equal(getattr(account, name), history[name], err_msg=name)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.einsum("oiil->oil", history["covariance"]))
    np.testing.assert_array_equal(account.sigma, sigma)
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2), (6, 7), (6, 8), (7, 8))):
        np.testing.assert_array_equal(account.cross[:, k], history["covariance"][:, i, j])
    np.testing.assert_array_equal(state.navigation, history["state"])


@pytest.mark.parametrize("kind", ["eskf", "first-estimates", "gaussian-sum", "rts", "map"])
def test_one_run_alone_has_the_bits_of_a_lane(kind: str) -> None:
    """`estimate` of a single flight, with plain numbers where it is a smoother, against `run_filter` of lanes."""
    number = estimate.FILTER_KINDS[kind]
    imu, fixes, events, nav, covariance, model, _ = _flight()
    if number in estimate.records.SMOOTHERS:
        events = _without_ahead(events)
    model = _model(number, model)
    state = start(nav, covariance, model.components)
    alone = estimate.estimate(imu, Measurements.of({FIX: fixes}), events, state, model)
    together = _flown(lanes.WIDTH, number, lambda state, tables: None)
    for name in History._fields:
        np.testing.assert_array_equal(getattr(alone, name), together[name][..., 1], err_msg=name)
    for final, name in ((state.navigation, "state"), (state.covariance, "p"), (state.rejected, "rejected")):
        np.testing.assert_array_equal(final, together[name][..., 1], err_msg=name)


def test_neighbours_really_are_rejected_and_lost() -> None:
    """What the test above flies among is what it says."""
    among = _flown(8, estimate.FILTER_KINDS["tfg"], _bad_company(0))
    status = among["status"]
    assert np.isnan(among["error"][..., 1]).all()
    assert np.sum(status[..., 2] == 1) < np.sum(status[..., 0] == 1) - 50
    assert np.any(status[..., 3] == 2)
    assert not np.any(status[..., 0] == 2)
    assert set(np.unique(among["degrees"][..., 2])) == {0.0, 2.0, 3.0, 5.0, 6.0}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the names of registers are those of x86-64")
def test_the_hot_loop_is_vector_code() -> None:
    """The prediction works on whole registers, with fused multiplications and no calls."""
    matrix = lanes.array_type(lanes.WIDTH, 2)
    again = numba.njit(nogil=True, error_model="numpy")(_transition_rows.py_func)
    signature = (matrix, numba.int64, matrix, numba.int64, matrix)
    again.compile(signature)
    code = again.inspect_asm(signature)
    register = "%zmm" if lanes.WIDTH == 8 else "%ymm"
    fused = [line for line in code.splitlines() if "vfmadd" in line]
    assert len(fused) > 60
    assert all(register in line and "pd" in line for line in fused)
    assert not re.search(r"vfmadd\w+sd", code)


def test_statistics_of_a_run_are_those_it_has_alone() -> None:
    """Nothing that is kept of a run, or said of it, depends on how many fly with it."""
    c = case("duration_s=20", "altimeter={}", "filter.gate.probability=0.05", "integrity={p_constellation: 1.0e-8}")
    study = LandingStudy(c, 3, "all")
    together, _, kept = study.batch(0, lanes.WIDTH + 1)
    for run in (0, 2, lanes.WIDTH):
        alone, _, histories = study.batch(run, 1)
        for name, values in alone.items():
            np.testing.assert_array_equal(together[name][run], values[0], err_msg=name)
        for name, values in histories.items():
            np.testing.assert_array_equal(kept[name][run], values[0], err_msg=name)


def test_sums_are_those_of_the_runs() -> None:
    """Squares of position errors are kept twice: of each run, for intervals, and summed with the other states'."""
    per_run, sums, _ = LandingStudy(case("duration_s=20", "filter.kind=eskf"), 3, "none").batch(0, 11)
    np.testing.assert_allclose(sums["mean_square"].sum(axis=0)[:3], per_run["position_square"].sum(axis=0), rtol=1e-13)
