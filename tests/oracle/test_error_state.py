"""Filters against an error-state filter of textbooks in ECEF axes, which shares no code with navsim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navsim.landing.study import fly_all
from navsim.runner.executor import threads
from tests.conftest import Within
from tests.helpers import case, in_brief
from tests.oracle.textbook_filter import Sensors, SteadyForce, TextbookFilter, attitude, ecef

DEG, G = np.pi / 180.0, 9.80665
LIGHT, H0, H_MINUS2 = 299792458.0, 2e-19, 2e-20
"""Speed of light, m/s, and the noise of the receiver's clock."""
RUNS, SEED = 4, 3811
TRUTH = ("initial_errors.attitude_deg", "imu.gyro.drift_deg_h", "imu.accelerometer.noise_mg", "receiver.lever_arm_m")
"""What a case may change of the shipped scenarios; they have the values of the landing paper."""

HISTORIES = (
    "delta_angle", "delta_velocity", "start_llh", "start_velocity", "start_rpy", "filter_fix_llh",
    "filter_fix_velocity", "filter_fix_covariance", "pseudorange", "range_rate", "error", "sigma",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A flight: scenario, what is set, and the part of TRUTH that is not the paper's."""

    scenario: str
    settings: tuple[str, ...]
    attitude_deg: float = 5.0
    drift_deg_h: float = 700.0
    noise_mg: float = 10.0
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def assignments(self) -> tuple[str, ...]:
        values = (self.attitude_deg, self.drift_deg_h, self.noise_mg, list(self.lever_arm_m))
        clock = (f"receiver.clock.h0={H0}", f"receiver.clock.h_minus2={H_MINUS2}")
        return (*self.settings, *clock, *(f"{key}={value}" for key, value in zip(TRUTH, values, strict=True)))

    def sensors(self) -> Sensors:
        start = (10.0, 1.0, self.attitude_deg * DEG, self.drift_deg_h / 3600.0 * DEG, 1e-3 * G)
        clock = (LIGHT**2 * H0 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * H_MINUS2)
        noise = (30.0 / 3600.0 * DEG, 1e-3 * self.noise_mg * G)
        return Sensors(start, *noise, 0.01, np.array(self.lever_arm_m), clock)


class Evaluated:
    """Ratio of navsim's sigmas to the textbook filter's, and how far their errors are apart, in those, (run, fix,
    state): position, velocity and attitude along north, east and down, biases of gyros and accelerometers."""

    def __init__(self, flight: Case, kind: str, steady: bool, coupling: str = "loose") -> None:
        words = (f"filter.kind={kind}", f"filter.steady_force={str(steady).lower()}", f"filter.coupling={coupling}")
        made = case(*words, *flight.assignments, name=flight.scenario)
        ensemble = fly_all(made, SEED, 0, RUNS, threads(), keep="all")
        self.kept = {name: np.asarray(ensemble[name]) for name in HISTORIES}
        self.signals, self.truth = made.shared.signals, made.shared.at_filter
        self.tight, self.sensors = coupling == "tight", flight.sensors()
        sigma, error = self._fly(steady)
        self.ratio = self.kept["sigma"][:, 1:, :15] / sigma
        self.apart = (self.kept["error"][:, 1:, :15] - error) / sigma

    def _fly(self, steady: bool) -> tuple[np.ndarray, np.ndarray]:
        kept, step = self.kept, self.sensors.step
        judge = self._begun()
        rule = SteadyForce.begun(self.sensors.accel_noise**2 * step, judge.velocity_ned)
        sigma, error, before = [], [], 0
        intervals = np.diff(self.signals.time, prepend=0.0)
        for epoch, now in enumerate(np.rint(self.signals.time / step).astype(int)):
            if steady:
                rule.after_measurement(judge.velocity_ned, judge.velocity_variance)
            judge.predict(kept["delta_angle"][:, before:now], kept["delta_velocity"][:, before:now])
            if steady:
                velocity, variance = judge.velocity_ned, judge.velocity_variance
                judge.couple(rule.before_measurement(velocity, variance, judge.to_level, intervals[epoch]))
            self._weigh(judge, epoch)
            sigma.append(np.sqrt(np.einsum("rii->ri", judge.in_level_axes(judge.p)))[:, :15])
            error.append(self._error(judge, epoch + 1))
            before = now
        return np.stack(sigma, axis=1), np.stack(error, axis=1)

    def _begun(self) -> TextbookFilter:
        kept = self.kept
        clock: tuple[np.ndarray, tuple[float, ...]] | tuple[()] = ()
        if self.tight:
            # nothing is known of the clock: any start serves that is near beside its sigma
            at = ecef(kept["start_llh"])
            heard = self.signals.used[0]
            distance = np.linalg.norm(self.signals.position[0, heard] - at[:, None], axis=2)
            bias = np.mean(kept["pseudorange"][:, 0, heard] - distance, axis=1)
            clock = (np.stack([bias, 0.0 * bias], axis=1), (1e4, 1e2))
        return TextbookFilter.begun(self.sensors, kept["start_llh"], kept["start_velocity"], kept["start_rpy"], *clock)

    def _weigh(self, judge: TextbookFilter, epoch: int) -> None:
        kept, signals = self.kept, self.signals
        if self.tight:
            heard = signals.used[epoch]
            sigma = np.stack([signals.fix_sigma[epoch, heard], signals.fix_rate_sigma[epoch, heard]])
            judge.weigh_ranges(
                signals.position[epoch, heard], signals.velocity[epoch, heard], kept["pseudorange"][:, epoch, heard],
                kept["range_rate"][:, epoch, heard], sigma,
            )  # fmt: skip
        else:
            judge.weigh_fix(*(kept[f"filter_fix_{part}"][:, epoch] for part in ("llh", "velocity", "covariance")))

    def _error(self, judge: TextbookFilter, output: int) -> np.ndarray:
        axes, truth = judge.axes, self.truth
        turned = attitude(truth.rpy[output]) @ judge.to_level.swapaxes(1, 2)
        bias = self.kept["error"][:, 0, 9:15]  # the filter begins without an estimate of it
        return np.concatenate(
            [
                ((ecef(truth.llh[output]) - judge.r)[:, None] @ axes)[:, 0],
                truth.velocity_ned[output] - judge.velocity_ned,
                Rotation.from_matrix(turned).as_rotvec(),
                bias - np.concatenate([judge.gyro, judge.accel], axis=1),
            ],
            axis=1,
        )


LANDING = ("duration_s=64",)
ARM = (2.0, 0.5, -1.0)
TURN = ("duration_s=30", "receiver.rate_hz=10", "filter.velocity=true")
WELL_ALIGNED = Case("landing", LANDING, attitude_deg=0.5, drift_deg_h=50.0)
"""A sum of Gaussians has one component, and charts are alike."""
JUDGE = "independent script: an error-state filter in ECEF axes after Groves (2013), in numpy"
WHAT = "of a sigma, all states at all outputs"


@pytest.mark.validates(
    "Sigma and estimates of `eskf`, from fixes and from ranges, with `filter.steady_force` and without it",
    JUDGE, WHAT, sigma="1e-3", estimate="5e-3")  # fmt: skip
@pytest.mark.parametrize(
    ("flight", "coupling", "steady"),
    in_brief(
        [
            (Case("landing", LANDING, lever_arm_m=ARM), "loose", True),
            (Case("landing", LANDING, lever_arm_m=ARM), "loose", False),
            (Case("landing", LANDING, noise_mg=30.0), "loose", True),
            (Case("landing", LANDING), "tight", True),
            (Case("s_turn", TURN), "loose", True),
        ],
        0,
        4,
    ),
    ids=["landing", "landing, measured force", "noisy", "ranges", "turns"],
)
def test_one_gaussian(flight: Case, coupling: str, steady: bool, within: Within) -> None:
    judged = Evaluated(flight, "eskf", steady, coupling)
    assert np.abs(judged.ratio - 1.0).max() < within["sigma"]
    assert np.abs(judged.apart).max() < within["estimate"]


@pytest.mark.validates("Sigma and estimates of `gaussian-sum` where one Gaussian, a `tfg` filter, is enough, with "
                       "`filter.steady_force`", JUDGE, WHAT, sigma="1e-2", estimate="5e-2")  # fmt: skip
@pytest.mark.parametrize("coupling", in_brief(["loose", "tight"], 1))
def test_one_gaussian_is_enough(coupling: str, within: Within) -> None:
    judged = Evaluated(WELL_ALIGNED, "gaussian-sum", True, coupling)
    assert np.abs(judged.ratio - 1.0).max() < within["sigma"]
    assert np.abs(judged.apart).max() < within["estimate"]
