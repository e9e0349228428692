"""Noise of the accelerometers is no information about heading (`filter.steady_force`)."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import records, steady_force
from navsim.filter.states import ATT, N_BASE, PHI_D, POS, VEL
from navsim.landing.study import fly_all
from navsim.runner.executor import threads
from tests.helpers import case, cross, in_brief

DEG = np.pi / 180.0
UNSEEN = 3801
"""A seed by which nothing was chosen."""


class Heading:
    """Heading in straight flight, where nothing shows it: at times (t,) the 1 sigma of the prior, RMS of the errors
    over that of the errors drawn, RMS of error / sigma, mean variance believed, mean square of what the estimate was
    moved by. attitude, drift: 1 sigma of the initial errors, deg, deg/h."""

    def __init__(
        self, runs: int, *assignments: str, times: tuple[float, ...] = (3.0, 10.0, 20.0, 40.0, 59.0),
        attitude: float = 5.0, drift: float = 700.0,
    ) -> None:  # fmt: skip
        drawn_by = (f"initial_errors.attitude_deg={attitude}", f"imu.gyro.drift_deg_h={drift}")
        flown = case("duration_s=59.5", *drawn_by, *assignments)
        ensemble = fly_all(flown, UNSEEN, 0, runs, threads(), keep="errors")
        at = [int(np.argmin(np.abs(flown.shared.filter_time - t))) for t in times]
        every, elapsed = np.asarray(ensemble["error"]), np.asarray(times)
        error, sigma = every[:, at, PHI_D], np.asarray(ensemble["sigma"])[:, at, PHI_D]
        # a gyro that measures too much turns the estimate with it; level, its z axis points down
        drawn = every[:, :1, PHI_D] - elapsed * every[:, :1, PHI_D + 3]
        self.prior = np.hypot(attitude * DEG, drift / 3600.0 * DEG * elapsed)
        self.moved = ((error - drawn) ** 2).mean(axis=0)
        self.ratio = np.sqrt((error**2).mean(axis=0) / (drawn**2).mean(axis=0))
        self.z = np.sqrt(((error / sigma) ** 2).mean(axis=0))
        self.variance = (sigma**2).mean(axis=0)

    @property
    def information(self) -> np.ndarray:
        """What is believed to be known beside the prior (t,), 1/rad2."""
        return 1.0 / self.variance - self.prior**-2


def test_straight_flight_tells_nothing_of_heading() -> None:
    """The default believes next to nothing beside the prior, and errs as the errors drawn."""
    heading = Heading(160)
    assert np.all(heading.information < 2.5), heading.information
    assert heading.ratio[-1] < 1.04
    assert np.all(np.abs(heading.z - 1.0) < 0.07 + 2.5 * np.sqrt(0.5 / 160)), heading.z


@pytest.mark.parametrize(("attitude", "drift", "most"), in_brief([(10.0, 700.0, 1.7), (5.0, 1400.0, 1.05)], 0))
def test_noise_moves_heading_little(attitude: float, drift: float, most: float) -> None:
    """What false information of J moves the mean by has a variance of J prior**4: 2.5 and 1.4 rad-2 by the line alone,
    1.2 and 0.7 by the mean force."""
    heading = Heading(96, attitude=attitude, drift=drift)
    assert heading.moved[-1] / heading.prior[-1] ** 4 < most


@pytest.mark.long
def test_without_it_the_filter_is_too_sure() -> None:
    """The same runs with the measured force: components believe nothing of it, but their weights follow the noise."""
    heading = Heading(160, "filter.steady_force=false")
    assert heading.ratio[-1] > 1.08


@pytest.mark.parametrize(
    ("kind", "before", "now"), in_brief([("eskf", 8.0, 3.5), ("tfg", 7.0, 3.5), ("left-invariant", 8.0, 6.5)], 1)
)
def test_one_gaussian(kind: str, before: float, now: float) -> None:
    """One Gaussian learns less from noise, too; what is left is of the first seconds and, of `left-invariant`, of its
    chart."""
    with_it, without = (Heading(48, f"filter.kind={kind}", f"filter.steady_force={s}") for s in ("true", "false"))
    assert without.information[-1] > before
    assert with_it.information[-1] < now
    assert with_it.ratio[-1] < without.ratio[-1]


def test_a_noisy_accelerometer_does_not_push_components_outwards() -> None:
    """With 30 mg the believed heading is within 3 % of the prior: every component is coupled by its own rotation of the
    noise. By the mean one, sigma grew to 16 degrees."""
    heading = Heading(96, "imu.accelerometer.noise_mg=30")
    assert abs(np.sqrt(heading.variance[-1]) / heading.prior[-1] - 1.0) < 0.03


@pytest.mark.parametrize(
    "settings",
    in_brief(
        [
            ("filter.coupling=tight",),
            ("receiver.latency_s=0.3", "receiver.lever_arm_m=[2,0.5,-1]"),
            ("receiver.rate_hz=1",),
        ],
        0,
        whole=True,
    ),
)
def test_whatever_the_fixes(settings: tuple[str, ...]) -> None:
    heading = Heading(48, *settings)
    assert np.all(heading.information < 2.5), heading.information


@pytest.mark.parametrize(("block", "tilts"), [(VEL, 1.0), (POS, 1.0), (VEL, 0.0)])
def test_coupling(block: int, tilts: float) -> None:
    """T P T' with T of the definition."""
    root = np.random.default_rng(3).standard_normal((N_BASE, N_BASE))
    p, m = root @ root.T, np.array([0.3, -0.2, 0.5])
    t = np.eye(N_BASE)
    t[block : block + 3, ATT : ATT + 3] = -cross(m) @ np.diag([tilts, tilts, 1.0])
    expected = t @ p @ t.T
    steady_force.couple(p, block, m, tilts)
    np.testing.assert_allclose(p, expected, atol=1e-12)
    np.testing.assert_array_equal(p, p.T)


Q, VARIANCE, STEP = 1e-4, np.full(3, 4e-4), 0.1
MEMORY = VARIANCE[0] / Q


def through(
    velocities: np.ndarray,
    times: np.ndarray | None = None,
    pitch: np.ndarray | None = None,
    uses: list[float] | None = None,
) -> np.ndarray:
    """What is added to the couplings (k, 3) of intervals that end with velocities (k, 3), which fixes leave at times
    (k,), s, by default every `STEP`; with pitch (k,), rad, by default level. uses: out, whether by the mean force."""
    times = STEP * np.arange(1.0, len(velocities) + 1.0) if times is None else times
    line, m = np.zeros(records.STEADY_N), np.zeros((len(velocities), 3))
    before, then = np.zeros(3), times[0] - STEP
    steady_force.start_line(line, before, then)
    pitch = np.zeros(len(velocities)) if pitch is None else pitch
    for k, (v, now) in enumerate(zip(velocities, times, strict=True)):
        attitude = np.array([np.cos(0.5 * pitch[k]), 0.0, np.sin(0.5 * pitch[k]), 0.0])
        steady_force.begin_interval(line, before, VARIANCE, Q, then)
        steady_force.end_interval(line, v, VARIANCE, attitude, Q, now, m[k])
        before, then = v, now
        if uses is not None:
            uses.append(line[records.STEADY_USES_FORCE])
    return m


def noisy_line(count: int, slope: float = 0.2) -> np.ndarray:
    """Velocities on a line, with a noise that fixes keep small."""
    rng, out, noise = np.random.default_rng(5), [], np.zeros(3)
    for k in range(1, count + 1):
        noise = 0.97 * noise + np.sqrt(Q * STEP) * rng.standard_normal(3)
        out.append(slope * STEP * k + noise)
    return np.array(out)


def test_noise_is_left_out() -> None:
    """In steady flight what is coupled is the change of the line: much smoother than that of the velocity."""
    velocities = noisy_line(600)
    m = through(velocities)
    change = np.diff(velocities, axis=0, prepend=0.0)
    assert not m[:20].any()
    coupled = change[100:] + m[100:]
    np.testing.assert_allclose(coupled.mean(axis=0), 0.2 * STEP, atol=2e-3)
    assert coupled.std() < 0.3 * change[100:].std()


def test_rounding_of_times_does_not_decide_when_it_begins() -> None:
    """More than 2 s are so many fixes, whatever the hour: not one more or less."""
    velocities, times = noisy_line(200), STEP * np.arange(1.0, 201.0)
    begun = {
        int(np.flatnonzero(through(velocities, times + late).any(axis=1))[0]) for late in np.arange(0.0, 40.0, 0.7)
    }
    assert len(begun) == 1, begun


def test_a_manoeuvre_gives_back_what_was_left_out() -> None:
    """At the jump, all of the felt change of velocity is coupled, and of what was left out before as much as fixes
    have not corrected within the memory of the velocity; then each interval as it was felt."""
    velocities = noisy_line(600)
    velocities[500:] += 1.0
    m = through(velocities)
    uncorrected = (1.0 - STEP / MEMORY) ** np.arange(499.0, -1.0, -1.0)
    assert np.abs(m[499]).max() > 0.0
    np.testing.assert_allclose(m[500], -uncorrected @ m[:500], atol=1e-12)
    assert not m[501:520].any()


@pytest.mark.parametrize("pitch", [0.1 * np.pi / 180.0 * STEP * np.arange(600), 0.03 * (np.arange(600) > 300)])
def test_a_turn_of_the_body_is_no_force(pitch: np.ndarray) -> None:
    """The aircraft pitches, slowly or at once, and its velocity stays on the line: the line says what is left out."""
    velocities, uses = noisy_line(600), []
    m = through(velocities, pitch=pitch, uses=uses)
    assert not uses[310]
    coupled = np.diff(velocities, axis=0)[350:] + m[351:]
    np.testing.assert_allclose(coupled.mean(axis=0), 0.2 * STEP, atol=2e-3)
    assert coupled.std() < 0.3 * np.diff(velocities, axis=0)[350:].std()


def test_the_mean_force_is_smoother_than_a_young_line() -> None:
    """10 to 20 s after the start: with fixes' noise in the velocity, as the filter leaves it."""
    velocities = noisy_line(600)
    by_force, by_line = (
        np.diff(velocities, axis=0)[100:200] + through(velocities, pitch=pitch)[101:201]
        for pitch in (None, 0.03 * (np.arange(600) > 75))
    )
    assert by_force.std() < 0.5 * by_line.std()


def test_steady_flight_ends_later_than_it_begins() -> None:
    """Fixes a second apart: as the memory shrinks, flight is steady 2 s after it is below 24 s before a fix, and stays
    so until 36 s. A fix that makes the memory shorter than 24 s does not begin it alone."""
    line, still, m = np.zeros(records.STEADY_N), np.zeros(3), np.zeros(3)
    attitude, steady = np.array([1.0, 0.0, 0.0, 0.0]), []
    steady_force.start_line(line, still, 0.0)
    before = [25.0] * 20 + [23.0] * 20 + [35.0] * 20 + [37.0]
    for k, memory in enumerate(before):
        steady_force.begin_interval(line, still, np.full(3, 22.0 * Q), Q, float(k))
        steady_force.end_interval(line, still, np.full(3, memory * Q), attitude, Q, k + 1.0, m)
        steady.append(line[records.STEADY_IS])
    assert steady == [0.0] * 22 + [1.0] * 38 + [0.0]


def test_after_a_hole_of_fixes_the_line_is_new() -> None:
    """A minute without a fix ends steady flight, and does not make the next line a minute old: that one has to age
    for 2 s before it is used."""
    before = noisy_line(300)
    after = before[-1] - 0.5 * 60.0 + noisy_line(300, -0.5)
    times = STEP * np.arange(1.0, 601.0) + np.where(np.arange(600) < 300, 0.0, 60.0)
    m = through(np.concatenate([before, after]), times)
    assert m[300].any()
    begun = 301 + int(np.flatnonzero(m[301:].any(axis=1))[0])
    assert 0.0 < times[begun] - times[300] - 2.0 < 0.5
    coupled = np.diff(after, axis=0)[-150:] + m[-150:]
    np.testing.assert_allclose(coupled.mean(axis=0), -0.5 * STEP, atol=2e-3)


def test_another_rate_of_fixes_is_no_hole() -> None:
    """Steady flight goes on, and so does the line, by the spacing that fixes have now."""
    first, spaced = noisy_line(300), noisy_line(3000)[300::10]
    times = np.concatenate([STEP * np.arange(1.0, 301.0), 30.0 + 10.0 * STEP * np.arange(1.0, 271.0)])
    m = through(np.concatenate([first, spaced + (first[-1] - spaced[0]) + 0.2]), times)
    assert (m[300:] != 0.0).any(axis=1).mean() > 0.9
    coupled = np.diff(spaced, axis=0)[-100:] + m[-100:]
    np.testing.assert_allclose(coupled.mean(axis=0), 10.0 * 0.2 * STEP, atol=2e-2)


def test_weak_gusts_end_steady_flight() -> None:
    """Changes a quarter as large again as noise makes them, none of which is seen by itself."""
    velocities = noisy_line(600)
    gusts = 0.8 * np.sqrt(Q * STEP) * np.random.default_rng(7).standard_normal((600, 3))
    shaken = velocities + np.cumsum(gusts, axis=0)
    still, moving = (np.abs(through(v)[300:]).max(axis=1) > 0.0 for v in (velocities, shaken))
    assert still.mean() > 0.9
    assert moving.mean() < 0.2
