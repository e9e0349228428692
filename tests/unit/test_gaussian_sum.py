"""The Gaussian sum: what divides, merges and weighs components leaves the moments that it must."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from navsim.compiler.elementary import exp_of_negative
from navsim.filter import estimate, gaussian_sum, states, tfg
from navsim.filter import mixture as components_of
from navsim.filter.eskf import inject
from navsim.filter.measurement_kinds import FIX, FixTable, Measurements
from navsim.filter.mixture import MixtureBuffers, merge, split, split_and_merge
from navsim.filter.records import ImuData, Mixture, schedule, start
from navsim.filter.states import GYRO, N_BASE, NAV_BIAS_FRAME, NAV_N, NAV_QUAT, NAV_SENSORS, PHI_D, PHI_E, PHI_N
from navsim.simulation.flight import exact_start
from tests.helpers import case
from tests.unit.test_covariance import error, some_covariance
from tests.unit.test_group_filters import FIXED, bias_axes, retract, rotation, workshop
from tests.unit.test_group_filters import start as some_state

WIDEST = np.radians(4.5)
ROOM = 12


def centre() -> np.ndarray:
    """A navigation state whose bias axes are not held."""
    nav = some_state()
    nav[NAV_BIAS_FRAME:NAV_SENSORS] = 1.0, 0.0, 0.0, 0.0
    return nav


def covariance(heading: float) -> np.ndarray:
    """A covariance with this 1 sigma of heading, rad, to which all other states owe something."""
    p = some_covariance(3)
    scale = np.ones(N_BASE)
    scale[PHI_D] = heading / np.sqrt(p[PHI_D, PHI_D])
    out: np.ndarray = p * scale * scale[:, None]
    return out


def sum_of(*parts: tuple[np.ndarray, np.ndarray, float], room: int = ROOM) -> Mixture:
    """A sum of components: navigation state, covariance, weight."""
    mixture = Mixture(np.zeros((room, NAV_N)), np.zeros((room, N_BASE, N_BASE)), np.zeros((room, 6)), np.zeros(room))
    for j, (nav, p, weight) in enumerate(parts):
        mixture.navigation[j], mixture.covariance[j], mixture.weight[j] = nav, p, weight
    return mixture


def bench() -> MixtureBuffers:
    vectors = (np.empty(size) for size in (N_BASE, N_BASE, N_BASE, NAV_N, NAV_N))
    return MixtureBuffers(
        *vectors, np.empty((N_BASE, N_BASE)), np.empty((N_BASE, N_BASE)), np.empty(6), sum_of(room=2), np.empty(ROOM)
    )


def moments(mixture: Mixture, flat: bool = False) -> tuple[np.ndarray, np.ndarray]:
    nav, p = np.empty(NAV_N), np.empty((N_BASE, N_BASE))
    components_of.moments(mixture, nav, p, flat, workshop(), bench())
    return nav, p


def same(one: tuple[np.ndarray, np.ndarray], two: tuple[np.ndarray, np.ndarray], tolerance: float) -> None:
    """Means within a part of a sigma, covariances to a part of theirs."""
    scale = np.sqrt(np.diag(two[1]))
    np.testing.assert_allclose(error(one[0], two[0]) / scale, 0.0, atol=tolerance)
    np.testing.assert_allclose(one[1] / scale / scale[:, None], two[1] / scale / scale[:, None], atol=tolerance)
    np.testing.assert_array_equal(one[1], one[1].T)


def own(nav: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The coordinates (n,) of a state in the chart at a centre."""
    out = np.empty(N_BASE)
    tfg.error_in_filter_coordinates(centre, error(nav, centre), out, 0, 0)
    return out


def divided(heading: float) -> Mixture:
    mixture = sum_of((centre(), covariance(heading), 1.0))
    split(mixture, True, 0.0, workshop(), bench())
    return mixture


@pytest.mark.parametrize("heading", [0.01, 0.2])
def test_a_divided_component_has_the_moments_of_the_whole(heading: float) -> None:
    """Mean and covariance of all states, and along heading the fourth moment."""
    mixture = divided(heading)
    np.testing.assert_allclose(mixture.weight[:4], [4 / 6, 1 / 6, 1 / 6, 0.0])
    same(moments(mixture), (centre(), covariance(heading)), 1e-7)
    offset = np.array([own(nav, centre())[PHI_D] for nav in mixture.navigation[:3]]) / heading
    narrowed = 0.65
    np.testing.assert_allclose(np.sqrt(mixture.covariance[0, PHI_D, PHI_D]) / heading, narrowed)
    fourth = mixture.weight[:3] @ (offset**4 + 6.0 * offset**2 * narrowed**2 + 3.0 * narrowed**4)
    np.testing.assert_allclose(fourth, 3.0, rtol=1e-6)


def test_two_that_are_merged_have_the_moments_of_both() -> None:
    mixture = divided(0.1)
    whole = moments(mixture)
    merge(mixture, True, 1.0, 2.0, workshop(), bench())
    np.testing.assert_allclose(mixture.weight[:3], [4 / 6, 2 / 6, 0.0])
    same(moments(mixture), whole, 1e-6)
    merge(mixture, True, 0.0, 1.0, workshop(), bench())
    np.testing.assert_allclose(mixture.weight[:2], [1.0, 0.0])
    same((mixture.navigation[0], mixture.covariance[0]), (centre(), covariance(0.1)), 1e-6)


def test_moments_are_those_of_points_on_the_chart() -> None:
    """Components next to points, at known places by the definition of the feedback: mean and covariance of the
    places."""
    rng = np.random.default_rng(5)
    sigma = np.sqrt(np.diag(covariance(0.2)))
    weight = np.array([0.5, 0.3, 0.15, 0.05])
    places = rng.standard_normal((4, N_BASE)) * sigma
    places -= weight @ places
    tiny = np.diag(1e-12 * sigma**2)
    parts = [(retract("tfg", centre(), y), tiny, float(w)) for y, w in zip(places, weight, strict=True)]
    same(moments(sum_of(*parts)), (centre(), np.einsum("j,ja,jb->ab", weight, places, places)), 2e-5)


def test_what_is_answered_has_positions_and_velocities_as_they_are() -> None:
    """Components far apart in heading and in one direction of position, known well across it: neither the mean nor what
    is known across is spoiled, as it is in the chart; of the rest nothing changes."""
    rng = np.random.default_rng(7)
    weight = np.array([0.5, 0.3, 0.15, 0.05])
    off = np.zeros((4, N_BASE))
    off[:, 0], off[:, 4], off[:, PHI_D] = (
        8.0 * rng.standard_normal(4),
        0.2 * rng.standard_normal(4),
        0.15 * rng.standard_normal(4),
    )
    off -= weight @ off
    parts = []
    for one, w in zip(off, weight, strict=True):
        nav = centre()
        inject(nav, one)
        parts.append((nav, np.diag(np.full(N_BASE, 1e-6)), float(w)))
    nav, p = moments(sum_of(*parts), flat=True)
    np.testing.assert_allclose(error(nav, centre())[:6], 0.0, atol=1e-6)
    np.testing.assert_allclose(
        p[:6, :6], np.einsum("j,ja,jb->ab", weight, off, off)[:6, :6] + 1e-6 * np.eye(6), atol=1e-6
    )
    of_chart = moments(sum_of(*parts))
    assert np.sqrt(of_chart[1][1, 1]) > 0.05
    np.testing.assert_allclose(p[6:9, 6:9], of_chart[1][6:9, 6:9], rtol=1e-9)


def test_measurements_weigh_by_their_likelihood() -> None:
    """Against densities of scipy; what is next to impossible goes."""
    rng = np.random.default_rng(6)
    prior = np.array([0.4, 0.3, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    innovations = rng.standard_normal((4, 3))
    innovations[3] = 40.0
    roots = rng.standard_normal((4, 3, 3))
    of_innovations = roots @ roots.transpose(0, 2, 1) + 0.5 * np.eye(3)
    squares, sizes = np.full(ROOM, np.nan), np.full(ROOM, np.nan)
    for j in range(4):
        squares[j] = innovations[j] @ np.linalg.solve(of_innovations[j], innovations[j])
        sizes[j] = np.sqrt(np.linalg.det(of_innovations[j]))
    weight, kept = prior.copy(), prior.copy()
    gaussian_sum.update_weights(True, weight, squares, sizes)
    gaussian_sum.update_weights(False, kept, squares, sizes)
    density = [multivariate_normal.pdf(innovations[j], cov=of_innovations[j]) for j in range(4)]
    expected = prior[:3] * density[:3]
    assert density[3] < 1e-12 * max(density)
    np.testing.assert_allclose(weight[:3], expected / expected.sum(), rtol=1e-10)
    np.testing.assert_array_equal(weight[3:], 0.0)
    np.testing.assert_array_equal(kept, prior)


def arranged(mixture: Mixture, turn: float) -> Mixture:
    split_and_merge(mixture, turn, WIDEST, workshop(), bench())
    return mixture


def levelled(p: np.ndarray) -> np.ndarray:
    """A covariance whose tilt is known to half a milliradian."""
    scale = np.ones(N_BASE)
    scale[[PHI_N, PHI_E]] = 5e-4 / np.sqrt(np.diag(p)[[PHI_N, PHI_E]])
    out: np.ndarray = p * np.outer(scale, scale)
    return out


def headings(mixture: Mixture) -> np.ndarray:
    """1 sigma of heading of the components that are there."""
    out: np.ndarray = np.sqrt(mixture.covariance[:, PHI_D, PHI_D])[mixture.weight > 0.0]
    return out


def test_components_are_as_narrow_as_a_turn_asks_for() -> None:
    """Down to half of the widest, as far as there is room; the sum keeps its moments."""
    whole = centre(), levelled(covariance(1.4 * WIDEST))
    calm, turning = (arranged(sum_of((*whole, 1.0)), turn) for turn in (0.02, 0.5))
    assert headings(calm).size == 3
    assert headings(calm).max() < WIDEST
    assert 3 < headings(turning).size <= ROOM
    for mixture in (calm, turning):
        assert mixture.weight.sum() == pytest.approx(1.0)
        same(moments(mixture), whole, 1e-5)
    # what is narrow enough for any turn stays as it is
    narrow = arranged(sum_of((centre(), covariance(0.4 * WIDEST), 1.0)), 0.5)
    np.testing.assert_array_equal(narrow.weight, np.eye(ROOM)[0])
    np.testing.assert_array_equal(narrow.covariance[0], covariance(0.4 * WIDEST))


def test_components_are_narrow_while_tilt_is_being_learnt() -> None:
    """Down to half of the widest without any turn; once the tilt is known, neighbours become one again."""
    whole = centre(), covariance(1.4 * WIDEST)
    tilted = arranged(sum_of((*whole, 1.0)), 0.02)
    count = headings(tilted).size
    assert count > 3
    for j in range(count):
        tilted.covariance[j] = levelled(tilted.covariance[j])
    assert headings(arranged(tilted, 0.02)).size < count


def test_there_are_never_more_than_there_is_room_for() -> None:
    mixture = arranged(sum_of((centre(), covariance(6.0 * WIDEST), 1.0)), 0.5)
    assert headings(mixture).size in (ROOM - 1, ROOM)
    assert mixture.weight.sum() == pytest.approx(1.0)
    same(moments(mixture), (centre(), covariance(6.0 * WIDEST)), 1e-3)


def test_straight_flight_leaves_room_for_a_turn() -> None:
    wide = centre(), levelled(covariance(6.0 * WIDEST))
    calm = arranged(sum_of((*wide, 1.0)), 0.02)
    assert headings(calm).size in (6, 7)
    assert headings(arranged(calm, 0.5)).size in (ROOM - 1, ROOM)


def test_a_turn_divides_what_is_in_the_tails() -> None:
    """Of a component whose weight doesn't matter in straight flight: runs whose heading lies there turn, too."""
    far = np.zeros(N_BASE)
    far[PHI_D] = 12.0 * WIDEST
    narrow, wide = levelled(covariance(0.4 * WIDEST)), levelled(covariance(1.4 * WIDEST))
    parts = (centre(), narrow, 0.996), (retract("tfg", centre(), far), wide, 0.004)
    calm, turning = (arranged(sum_of(*parts), turn) for turn in (0.02, 0.5))
    assert headings(calm).size == 2
    assert headings(turning).size > 2
    assert headings(turning).max() < 1.4 * WIDEST


def test_components_with_one_heading_become_one() -> None:
    """Their heading known by a narrow covariance each, and not apart."""
    apart = np.zeros(N_BASE)
    apart[PHI_D] = 0.1 * WIDEST
    p = covariance(0.3 * WIDEST)
    mixture = sum_of((centre(), p, 0.6), (retract("tfg", centre(), apart), p, 0.4))
    whole = moments(mixture)
    arranged(mixture, 0.02)
    np.testing.assert_allclose(mixture.weight[:2], [1.0, 0.0])
    same((mixture.navigation[0], mixture.covariance[0]), whole, 1e-9)


def test_a_turn_is_held_back_until_heading_is_known() -> None:
    """In straight flight errors of gyro biases have fixed axes once the level ones are known. In a turn bias axes are
    held while heading is uncertain. Once it is known in a bank, bias errors are plain until the filter knows all gyro
    biases about equally well."""
    first = Rotation.from_euler("ZYX", [0.4, 0.1, 0.0])
    bank, nod = Rotation.from_rotvec([0.2, 0.0, 0.0]), Rotation.from_rotvec([0.0, 0.05, 0.0])
    dive = Rotation.from_rotvec([0.0, 0.3, 0.0])
    unknown, known = np.array([1.0, 2.0, 700.0]), np.array([1.0, 2.0, 8.0])

    def after(frame: np.ndarray, turn: Rotation, heading: float, gyros: np.ndarray, pitch: float = 0.1) -> np.ndarray:
        """The stored turn after a further turn of the body; the axes of the gyro sigmas are pitched down from the first
        body axes."""
        so_far = Rotation.from_quat(frame, scalar_first=True) if frame.any() else level
        before, to_body = first * so_far, Rotation.from_euler("Y", -pitch)
        nav, p = centre(), np.eye(N_BASE)
        nav[NAV_BIAS_FRAME:NAV_SENSORS] = frame
        nav[NAV_QUAT:NAV_BIAS_FRAME] = (before * turn).as_quat(scalar_first=True)
        p[PHI_D, PHI_D] = heading**2
        p[GYRO : GYRO + 3, GYRO : GYRO + 3] = to_body.as_matrix() @ np.diag(gyros**2) @ to_body.as_matrix().T
        gaussian_sum._set_bias_axes(nav, p, before.as_quat(scalar_first=True), 0.1, np.empty((3, 3)))
        out: np.ndarray = nav[NAV_BIAS_FRAME:NAV_SENSORS]
        return out

    level, plain = Rotation.identity(), np.zeros(4)
    body, held, nodded = (turn.as_quat(scalar_first=True) for turn in (level, bank, nod))
    fixed = np.array([-1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(after(body, level, 0.2, unknown), fixed)
    np.testing.assert_array_equal(after(fixed, level, 0.2, known), body)
    np.testing.assert_array_equal(after(fixed, level, 0.002, unknown), body)
    np.testing.assert_allclose(-after(fixed, nod, 0.2, unknown), nodded, atol=1e-12)
    np.testing.assert_allclose(after(body, nod, 0.2, unknown), nodded, atol=1e-12)
    # between two fixes the body may turn by more than the ratio of the sigmas
    np.testing.assert_allclose(after(body, dive, 0.2, unknown), dive.as_quat(scalar_first=True), atol=1e-12)
    np.testing.assert_allclose(after(held, level, 0.2, unknown), held, atol=1e-12)
    np.testing.assert_array_equal(after(held, level, 0.01, unknown), plain)
    np.testing.assert_allclose(after(nodded, level, 0.01, unknown), nodded, atol=1e-12)
    np.testing.assert_array_equal(after(held, level, 0.002, unknown), body)
    np.testing.assert_array_equal(after(plain, bank, 0.2, unknown), plain)
    np.testing.assert_array_equal(after(plain, bank, 0.01, known), body)
    # where the unknown bias is not the vertical one, axes are not held, but plain errors remain
    np.testing.assert_array_equal(after(body, bank, 0.2, unknown, 0.4), body)
    np.testing.assert_array_equal(after(plain, bank, 0.2, unknown, 0.4), plain)


@pytest.mark.parametrize(("heading", "kind", "stored", "turn"), [
    (0.02, FIXED, [-1.0, 0.0, 0.0, 0.0], [0.0, 0.05, 0.0]),
    (0.002, FIXED, [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    (0.002, "tfg", [0.995, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0]),
    (0.01, "tfg", [0.995, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0]),
])  # fmt: skip
def test_other_axes_keep_the_moments_of_gyro_biases(
    heading: float, kind: str, stored: list[float], turn: list[float]
) -> None:
    """Turns begin and end, in a bank or not: points of the errors in the old axes have in the new ones the mean by
    which the estimate moves, and the covariance."""
    nav, factor, root = centre(), np.zeros((N_BASE, 3)), np.sqrt(3.0)
    nav[NAV_BIAS_FRAME:NAV_SENSORS] = np.array(stored) / np.linalg.norm(stored)
    factor[PHI_N : PHI_D + 1] = [[1e-3, 2e-3, 0.0], [2e-3, 0.0, 1e-3], [0.8 * heading, 0.0, 0.6 * heading]]
    factor[GYRO : GYRO + 3] = bias_axes(nav).as_matrix().T @ [[0.0, 3e-8, 1e-8], [0.0, 0.0, 2e-8], [1e-3, 0.0, 0.0]]
    # three-point rule of Gauss and Hermite: exact for fourth moments
    points = [
        (z, np.prod(w))
        for z, w in zip(product((0.0, root, -root), repeat=3), product((4 / 6, 1 / 6, 1 / 6), repeat=3), strict=True)
    ]
    p, before, turned = factor @ factor.T, nav.copy(), Rotation.from_rotvec(turn)
    nav[NAV_QUAT:NAV_BIAS_FRAME] = (rotation(nav) * turned).as_quat(scalar_first=True)
    old, grown = nav.copy(), p.copy()
    gaussian_sum._set_bias_axes(nav, grown, before[NAV_QUAT:NAV_BIAS_FRAME].copy(), 0.1, np.empty((3, 3)))
    old[NAV_BIAS_FRAME:NAV_SENSORS] = nav[NAV_BIAS_FRAME:NAV_SENSORS]
    found = []
    for z, _ in points:
        truth = retract(kind, before, factor @ z)
        truth[NAV_QUAT:NAV_BIAS_FRAME] = (rotation(truth) * turned).as_quat(scalar_first=True)
        found.append(own(truth, old)[GYRO : GYRO + 3])
    weights, x = np.array([w for _, w in points]), np.array(found)
    mean, level = weights @ x, bias_axes(before).as_matrix()[:2]
    wanted = (x - mean).T @ (weights[:, None] * (x - mean)) - (factor @ factor.T)[GYRO : GYRO + 3, GYRO : GYRO + 3]
    wanted, more = (level @ m @ level.T for m in (wanted, (grown - p)[GYRO : GYRO + 3, GYRO : GYRO + 3]))
    np.testing.assert_allclose((nav - old)[NAV_SENSORS : NAV_SENSORS + 3], mean, atol=1e-3 * abs(mean).max())
    np.testing.assert_allclose(more, wanted, atol=0.02 * abs(wanted).max())


def test_the_exponential() -> None:
    x = -np.concatenate([np.linspace(0.0, 2.0, 400), np.geomspace(1e-20, 700.0, 400)])
    ours = np.array([exp_of_negative(v) for v in x])
    np.testing.assert_allclose(ours, np.exp(x), rtol=4e-16)
    assert exp_of_negative(0.0) == 1.0
    assert exp_of_negative(-709.0) == 0.0
    assert exp_of_negative(-np.inf) == 0.0
    assert np.isnan(exp_of_negative(np.nan))


def test_one_component_is_a_tfg_filter() -> None:
    """Where nothing is divided and no gyro bias is known better than the others, until the corner: from there on the
    sum alone holds axes, since `tfg` does so only beyond 4 degrees of heading."""
    gentle = ("imu.gyro.drift_deg_h=20", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=80")
    one = case(*gentle, "filter.kind=gaussian-sum", "filter.gaussian_sum.split_heading_sigma_deg=90").fly(1, 0)
    other = case(*gentle, "filter.kind=tfg").fly(1, 0)
    for name in ("error", "sigma", "nees", "innovation_squared", "status"):
        a, b = getattr(one, name)[:59], getattr(other, name)[:59]
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.nanmax(np.abs(b)), err_msg=name)


def test_a_flight_in_two_pieces_goes_on_with_its_components() -> None:
    """The state between them holds the components: the second piece ends where the whole flight does, and heading
    known leaves one."""
    c = case("filter.kind=gaussian-sum", "receiver.rate_hz=2", name="landing_gnss_only")
    run, world, model = c.fly(1, 0), c.shared, c.flight.model
    noise = np.tile(np.diag([16.0, 16.0, 100.0, 0.0025, 0.0025, 0.0025]), (run.fix_llh.shape[0], 1, 1))
    times = world.filter_time[1:]
    nav = exact_start(world.at_filter)
    nav[6:10] = 0.9961946980917455, 0.0, 0.0, 0.08715574274765817  # 10 degrees
    covariance_ = c.flight.covariance.copy()
    covariance_[PHI_D, PHI_D] = np.radians(10.0) ** 2

    def flown(state: estimate.State, first: float, last: float) -> None:
        now = (times > first) & (times <= last)
        imu = (world.imu_time >= first) & (world.imu_time <= last)
        steps = np.flatnonzero(imu)[:-1]
        fixes = FixTable(run.fix_llh[now], run.fix_velocity[now], noise[now], np.zeros(3))
        estimate.estimate(
            ImuData(world.imu_time[imu], world.dtheta[steps], world.dv[steps]), Measurements.of({FIX: fixes}),
            schedule(times[now], (FIX, times[now], times[now])), state, model,
        )  # fmt: skip

    whole, pieces = start(nav, covariance_, model.components), start(nav, covariance_, model.components)
    flown(whole, 0.0, 20.0)
    flown(pieces, 0.0, 10.0)
    between = pieces.components.weight.copy()
    flown(pieces, 10.0, 20.0)
    assert np.sum(between > 0.0) > 2
    np.testing.assert_allclose(pieces.components.weight, whole.components.weight, atol=1e-6)
    np.testing.assert_allclose(pieces.navigation, whole.navigation, atol=1e-6)
    flown(whole, 20.0, 110.0)
    np.testing.assert_array_equal(whole.components.weight > 0.0, np.arange(model.components) == 0)
    assert np.sqrt(whole.covariance[states.PHI_D, states.PHI_D]) < WIDEST
