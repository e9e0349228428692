"""The filter model of recorded ranges: its states, its noise, and the states' uncertainty at the start.

Position and its derivatives come first, in local axes (east, north, up). Pseudoranges add a clock of two states for
each source and for the receiver, but for the datum, whose noise all others then share. Two-way ranges add a constant
bias for each source, and a second one that grows with distance if the scenario has it. Further states are
time-correlated errors: a fast and a slow one for each source, one for all ranges.

    two_way   r_i = |p - p_i| + a_i + s_i f(r_i) + w_i + v_i + w + e
    one_way   r_i = |p - p_i| + c (dt_receiver - dt_i) + u_i + e,   du_i/dt = (w_i - u_i) / T

A receiver of continuous signals smooths its pseudoranges by its loops or by the carrier: their wandering error w_i
appears as u_i, without steps. An acceleration fades with a correlation time (Singer 1970).

The white noise and the wandering error of a source have a common sigma times a factor of the source. The logarithm of
this factor is normal, so that a source with few ranges keeps nearly the common sigma [1].

Sources: Brown & Hwang, Introduction to Random Signals and Applied Kalman Filtering, on clocks of two states.

- [1] Gelman et al., Bayesian Data Analysis (2013), chapter 5, on hierarchical models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.ranging.filter import Dynamics, RangeData, RangeNoise, smoothed_variance
from navsim.ranging.recording import RangeLog
from navsim.ranging.scenario import RECEIVER, RecordedRanges

MOTIONS = ("velocity", "acceleration")
"""Models of motion: what is constant but for noise."""
FIRST_ACCELERATION = 3.0
"""1 sigma of the acceleration at the start, m/s2, per axis."""
UNKNOWN_CLOCK = (1e3, 100.0)
"""1 sigma of the receiver's offset, m, and rate, m/s, at the start."""


@dataclass(frozen=True)
class NoiseSetting:
    """A number of the noise: name in the result, unit, value where the tuning starts, bounds of the tuning."""

    name: str
    units: str
    start: float
    low: float
    high: float


SETTINGS = {
    one.name: one
    for one in (
        NoiseSetting("range_sigma", "m", 0.1, 0.01, 100.0),
        NoiseSetting("wander_sigma", "m", 0.05, 1e-3, 30.0),
        NoiseSetting("wander_time", "s", 1.0, 0.05, 300.0),
        NoiseSetting("smoothing_time", "s", 0.5, 0.02, 30.0),
        NoiseSetting("horizontal_noise", "1", 0.5, 0.01, 30.0),
        NoiseSetting("vertical_noise", "1", 0.1, 0.01, 30.0),
        NoiseSetting("motion_time", "s", 10.0, 0.3, 1e4),
        NoiseSetting("source_phase", "m2/s", 1e-3, 1e-8, 10.0),
        NoiseSetting("source_frequency", "m2/s3", 1e-6, 1e-12, 1.0),
        NoiseSetting("receiver_phase", "m2/s", 1e-2, 1e-8, 1e3),
        NoiseSetting("receiver_frequency", "m2/s3", 1e-2, 1e-12, 1e3),
        NoiseSetting("outlier_share", "1", 0.02, 1e-4, 0.3),
        NoiseSetting("outlier_sigma", "m", 2.0, 0.1, 1e3),
        NoiseSetting("long_share", "1", 0.02, 1e-4, 0.3),
        NoiseSetting("long_mean", "m", 0.5, 0.1, 100.0),
    )
}
"""Noise settings, and between which bounds they are tuned."""
_START_ONE_WAY = {"range_sigma": 0.5, "wander_sigma": 0.3, "wander_time": 5.0, "vertical_noise": 0.02}
"""Where the tuning starts for pseudoranges, where that is elsewhere."""
BY_SOURCE = {"range_sigma": "range_spread", "wander_sigma": "wander_spread"}
"""Settings that may differ by source, and the name of their spread: 1 sigma of the logarithm of a source's factor."""
FACTOR_BOUNDS = (0.05, 20.0)
"""Between which a source's factor is tuned."""
USUAL_SPREAD, SPREAD_DEGREES = 0.3, 4.0
"""Prior of a spread: a scaled inverse chi-square distribution about this value, with these degrees of freedom [1]."""
CLOCK_SETTINGS = ("source_phase", "source_frequency", "receiver_phase", "receiver_frequency")


@dataclass(frozen=True)
class RangeModel:
    """State space of a ranging recording: its states, motion, clocks and settings."""

    scenario: RecordedRanges
    log: RangeLog
    names: tuple[str, ...]
    """Of the states (n,)."""
    units: tuple[str, ...]
    order: int
    """Of the motion model."""
    datum: str
    """The reference clock."""
    clocks: tuple[str, ...]
    """Clocks that are states."""
    first_clock: int
    """Index of the first state of clocks, as below of biases and of time-correlated errors."""
    first_bias: int
    first_markov: int
    given: dict[str, float]
    """Settings of the scenario."""
    data: RangeData
    """Input of the filter."""

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.names)

    @property
    def has_no_clock(self) -> bool:
        """Whether the ranges have no clock."""
        return self.scenario.ranges.measurement == "two_way"

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the settings that are tuned."""
        left_out = set(CLOCK_SETTINGS) if self.has_no_clock else set()
        if not self.smoothed:
            left_out.add("smoothing_time")
        if self.order < 3:
            left_out.add("motion_time")
        return tuple(name for name in SETTINGS if name not in self.given and name not in left_out)

    @property
    def smoothed(self) -> int:
        """Number of errors that the receiver smooths."""
        names = self.log.sources.names
        return len(names) if f"smoothed error {names[0]}" in self.names else 0

    @property
    def by_source(self) -> tuple[str, ...]:
        """Names of the settings that differ by source."""
        differ = self.scenario.tuning == "likelihood" and self.scenario.ranges.noise == "by_source"
        return tuple(name for name in BY_SOURCE if differ and name not in self.given)

    def factors(self, name: str) -> tuple[str, ...]:
        """Names of the factors (s,) by source of a setting."""
        return tuple(f"{name} {source}" for source in self.log.sources.names)

    def of_sources(self, settings: dict[str, float], name: str) -> np.ndarray:
        """Values (s,) by source of a setting, not below its bound."""
        factors = np.array([settings.get(factor, 1.0) for factor in self.factors(name)])
        return np.maximum(settings[name] * factors, min(settings[name], SETTINGS[name].low))

    def settings(self) -> dict[str, float]:
        """Settings where the tuning starts, those given as they are."""
        start = {name: one.start for name, one in SETTINGS.items()} | ({} if self.has_no_clock else _START_ONE_WAY)
        for name in self.by_source:
            start |= dict.fromkeys(self.factors(name), 1.0) | {BY_SOURCE[name]: USUAL_SPREAD}
        return start | self.given

    def dynamics(self, settings: dict[str, float]) -> Dynamics:
        """Motion and noise of the states."""
        motion = np.array([settings["horizontal_noise"]] * 2 + [settings["vertical_noise"]]) ** 2
        noise = np.zeros((len(self.clocks), len(self.clocks), 2))
        own = {name: _of_clock(settings, name) for name in (*self.clocks, self.datum)} if self.clocks else {}
        for i, name in enumerate(self.clocks):
            noise[i, i] = own[name]
        if self.clocks:
            noise += own[self.datum]
        wandering = self.size - self.first_markov - self.smoothed
        place, common = self.scenario.bias.place, self.scenario.bias.common
        time, sigma = np.full(wandering, settings["wander_time"]), np.empty(wandering)
        count = len(self.log.sources.names)
        sigma[:count] = self.of_sources(settings, "wander_sigma")
        if self.has_no_clock:
            time[count:], sigma[count:] = place.correlation_time_s, place.sigma_m
            time[-1], sigma[-1] = common.correlation_time_s, common.sigma_m
        return Dynamics(
            self.order, motion, settings["motion_time"] if self.order > 2 else np.inf, len(self.clocks), noise,
            self.first_markov, time, sigma, self.smoothed, settings["smoothing_time"],
        )  # fmt: skip

    def noise(self, settings: dict[str, float]) -> RangeNoise:
        """Noise of a range."""
        share, long = settings["outlier_share"], settings["long_share"]
        usual, far = self.of_sources(settings, "range_sigma"), settings["long_mean"]
        return RangeNoise(
            np.array([1.0 - share - long, share, long]),
            np.array([0.0, 0.0, far]),
            np.column_stack([usual, np.hypot(usual, settings["outlier_sigma"]), np.hypot(usual, far)]),
        )

    def covariance(self, settings: dict[str, float], position_sigma: Sequence[float]) -> np.ndarray:
        """Covariance (n, n) of the states at the start; position_sigma: horizontal per axis, vertical, m."""
        section, s = self.scenario, np.zeros(self.size)
        s[:3] = position_sigma[0], position_sigma[0], position_sigma[1]
        s[3:6] = section.motion.speed_sigma_m_s
        s[6 : 3 * self.order] = FIRST_ACCELERATION
        if settings["vertical_noise"] == 0.0:
            s[5 : 3 * self.order : 3] = 0.0
        p = np.diag(s**2)
        if self.clocks:
            own = dict.fromkeys(self.log.sources.names, (section.clocks.offset_sigma_m, section.clocks.rate_sigma_m_s))
            own[RECEIVER] = UNKNOWN_CLOCK
            for k in range(2):
                at = self.first_clock + k + 2 * np.arange(len(self.clocks))
                p[np.ix_(at, at)] += own[self.datum][k] ** 2
                p[at, at] += np.array([own[name][k] ** 2 for name in self.clocks])
        count = len(self.log.sources.names)
        if self.has_no_clock:
            at = self.first_bias + np.arange(count)
            p[at, at] = section.bias.sigma_m**2
            if section.bias.growth is not None:
                p[at + count, at + count] = section.bias.growth.sigma_m**2
        at = np.arange(self.first_markov, self.size - self.smoothed)
        dynamics = self.dynamics(settings)
        p[at, at] = dynamics.markov_sigma**2
        for i, error in enumerate(at[: self.smoothed]):
            of = smoothed_variance(p[error, error], dynamics.markov_time[i], dynamics.smoothing_time)
            last = self.size - self.smoothed + i
            p[error, last] = p[last, error] = p[last, last] = of
        return p


def build_model(scenario: RecordedRanges, log: RangeLog) -> RangeModel:
    """The states of a recording and how its ranges depend on them."""
    sources, two_way = log.sources.names, scenario.ranges.measurement == "two_way"
    order = 2 + MOTIONS.index(scenario.motion.model)
    axes = ("east", "north", "up") if log.sources.origin is not None else ("x", "y", "z")
    names = [f"{what}{axis}" for what in ("", *(f"{name} " for name in MOTIONS))[:order] for axis in axes]
    units = [unit for unit in ("m", "m/s", "m/s2")[:order] for _ in axes]
    datum, clocks = "", tuple[str, ...]()
    first_clock = len(names)
    if not two_way:
        datum = scenario.clocks.datum or sources[0]
        clocks = tuple(name for name in (RECEIVER, *sources) if name != datum)
        for name in clocks:
            names += [f"clock offset {name}", f"clock rate {name}"]
            units += ["m", "m/s"]
    first_bias = len(names)
    if two_way:
        names += [f"bias {name}" for name in sources]
        if scenario.bias.growth is not None:
            names += [f"bias growth {name}" for name in sources]
        units += ["m"] * (len(names) - first_bias)
    first_markov = len(names)
    names += [f"wandering error {name}" for name in sources]
    has_place = two_way and scenario.bias.place.sigma_m > 0.0
    if has_place:
        names += [f"slow error {name}" for name in sources]
    if two_way:
        names += ["wandering error of all"]
    first_smoothed = len(names)
    wander = scenario.bias.wander
    if not two_way and scenario.bias.smoothing_s != 0.0 and (wander is None or wander.sigma_m > 0.0):
        names += [f"smoothed error {name}" for name in sources]
    units += ["m"] * (len(names) - first_markov)
    row = np.zeros((log.time.size, len(names)))
    every = np.arange(log.time.size)
    for k, name in enumerate(clocks):
        row[:, first_clock + 2 * k] = 1.0 if name == RECEIVER else -(log.source == sources.index(name)).astype(float)
    if two_way:
        row[every, first_bias + log.source] = 1.0
        growth = scenario.bias.growth
        if growth is not None:
            row[every, first_bias + len(sources) + log.source] = -np.expm1(
                -np.maximum(log.range, 0.0) / growth.distance_m
            )
        row[:, -1] = 1.0
    row[every, (first_markov if first_smoothed == len(names) else first_smoothed) + log.source] = 1.0
    if has_place:
        row[every, first_markov + len(sources) + log.source] = 1.0
    known = np.isfinite(log.sigma)
    usual = float(np.median(log.sigma[known])) if known.any() else 1.0
    scale = np.where(known, log.sigma / usual, 1.0)
    data = RangeData(log.time, log.source, log.range, scale, log.sources.position, row)
    return RangeModel(
        scenario, log, tuple(names), tuple(units), order, datum, clocks, first_clock, first_bias, first_markov,
        _settings(scenario), data,
    )  # fmt: skip


def _settings(scenario: RecordedRanges) -> dict[str, float]:
    """Settings that the scenario gives."""
    out: dict[str, float] = {}
    if scenario.ranges.sigma_m is not None:
        out["range_sigma"] = scenario.ranges.sigma_m
    if scenario.bias.smoothing_s is not None:
        out["smoothing_time"] = scenario.bias.smoothing_s
    if scenario.motion.correlation_time_s is not None:
        out["motion_time"] = scenario.motion.correlation_time_s
    if (wander := scenario.bias.wander) is not None:
        out |= {"wander_sigma": wander.sigma_m, "wander_time": wander.correlation_time_s}
    if (noise := scenario.motion.noise) is not None:
        out |= {"horizontal_noise": noise[0], "vertical_noise": noise[1]}
    if scenario.motion.height == "constant":
        out["vertical_noise"] = 0.0
    for name, clock in (("source", scenario.clocks.sources), ("receiver", scenario.clocks.receiver)):
        if clock is not None:
            out |= dict(zip((f"{name}_phase", f"{name}_frequency"), clock.densities(), strict=True))
    outliers = scenario.outliers
    for name, value in (
        ("outlier_share", outliers.share), ("outlier_sigma", outliers.sigma_m), ("long_share", outliers.long_share),
        ("long_mean", outliers.long_m),
    ):  # fmt: skip
        if value is not None:
            out[name] = value
    return out


def _of_clock(settings: dict[str, float], name: str) -> np.ndarray:
    """Noise densities (2,) of a clock."""
    who = RECEIVER if name == RECEIVER else "source"
    return np.array([settings[f"{who}_phase"], settings[f"{who}_frequency"]])
