"""Ranging beacons on the ground, by two-way time of flight: the vehicle asks one beacon after the other. Or by one-way
ranges on a time base that the beacons share; these have the receiver's clock in them.

    r = |p_beacon - p_antenna| + b(d) + noise,  b(d) = a + s f(d),  f(d) = 1 - exp(-d / D)

The receiver's clock cancels, since its rate over an exchange of milliseconds is below a millimetre. The bias grows with
distance as the received power falls. The constant part a and the growth s are drawn for each beacon. The error of its
survey is drawn, too, and acts along the line of sight.

Source: `docs/theory/beacons.md`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.filter.error_products import FIRST, SECOND
from navsim.filter.measurement_kinds import BEACON, BEACON_STATES, PRODUCT, BeaconTable
from navsim.filter.states import Block, ReferenceClock, TransmitterClockModel
from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.atmosphere import SCALE_HEIGHT
from navsim.gnss.events import BEACONS, Event, EventEffects, Scene, Silence, happened
from navsim.gnss.interference.horizon import Terrain, behind, horizon_distance
from navsim.gnss.interference.jamming import LinkJamming
from navsim.gnss.pseudolite import runway_position
from navsim.gnss.pseudolite_clock import TransmitterErrors, WanderingClocks
from navsim.gnss.signal_errors import GroundAir
from navsim.sensors.aiding import AidingSensor, SensorError
from navsim.statistics.random_streams import branch
from navsim.trajectory.kinematics import Frame, Moving

RECEIVER_CLOCK = "beacons_clock{}"
"""Name of the states of the receiver's clock in one-way ranges: of the offset, and with `_rate` of the rate."""
NO_REFERENCE = ReferenceClock()
"""Clocks are counted against a time without noise."""
_NO_CHANCE = 1e-6
"""Probability of so many outliers of a beacon in a row that rather the filter is wrong."""
_STATES = ("bias", "bias_growth", "position", "position", "position")
"""Name of the state of each error of a beacon."""
_SOURCES = ("bias", "bias_growth", "survey", "survey", "survey")
"""Name of each in the error budget."""
_AXES = ("", "", "_north", "_east", "_down")
_PRODUCTS = tuple(f"{_AXES[2 + i]}{_AXES[2 + j]}" for i, j in zip(FIRST, SECOND, strict=True))
"""Axes of the products of the position error."""


@dataclass(frozen=True)
class BeaconErrors:
    """Errors of each beacon that last over a run, and where its bias grows."""

    bias: float
    """1 sigma of the constant part of the bias, m."""
    growth: float
    """Mean of the growth of the bias, m."""
    growth_sigma: float
    """1 sigma of the growth, m."""
    growth_distance: float
    """Distance at which the bias has grown to 63 %, m."""
    survey: float
    """1 sigma of the surveyed position along each axis, m."""

    @property
    def sigma(self) -> tuple[float, ...]:
        """1 sigma of the errors of a beacon, in the order of `_STATES`."""
        return self.bias, self.growth_sigma, self.survey, self.survey, self.survey

    def grown(self, distance: np.ndarray) -> np.ndarray:
        """Fraction of the growth at distances (m,), m."""
        return -np.expm1(-distance / self.growth_distance)

    def variance(self, distance: np.ndarray) -> np.ndarray:
        """Variance of their sum in ranges at distances (m,), m2."""
        return np.asarray(self.bias**2 + (self.growth_sigma * self.grown(distance)) ** 2 + self.survey**2)


@dataclass(frozen=True)
class Outliers:
    """Answers that are not the usual: none, wrong to both sides, or too long by a reflection or an obstruction."""

    loss: float = 0.0
    """Fraction of the questions without an answer."""
    share: float = 0.0
    """Fraction of the ranges that are wrong to both sides."""
    sigma: float = 0.0
    """1 sigma of these, m."""
    long_share: float = 0.0
    """Fraction of the ranges that are too long."""
    long: float = 0.0
    """Mean of the exponential distribution of how much they are too long, m."""

    def mixture(self) -> np.ndarray:
        """Shares, sizes and number in a row (5,) as `filter.outliers.excess` takes them; sizes without a share have no
        effect."""
        in_a_row = math.log(_NO_CHANCE) / math.log(self.share + self.long_share)
        return np.array([self.share, self.sigma**2, self.long_share, self.long if self.long_share else 1.0, in_a_row])

    def applied(self, measured: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Ranges (m, 1) with outliers, nan where the answer is lost."""
        lost, kind, size, far = draw.random(measured.shape), draw.random(measured.shape), *(
            draw.standard_normal(measured.shape), draw.standard_exponential(measured.shape),
        )  # fmt: skip
        off = np.where(kind < self.share, self.sigma * size, 0.0)
        off = np.where((kind >= self.share) & (kind < self.share + self.long_share), self.long * far, off)
        return np.where(lost < self.loss, np.nan, measured + off)


@dataclass(frozen=True)
class BeaconDesign:
    """Filter model of `Beacons`, whose fields it shares. It estimates the errors whose sigma is not 0."""

    sigma: float
    weak_sigma: float
    latency: float
    lever_arm: np.ndarray
    errors: BeaconErrors
    outliers: Outliers | None = None
    """Outliers of the filter's mixture; None: the gate alone."""
    clock: TransmitterErrors | None = None
    """Errors of the receiver's clock, None for two-way ranges."""
    air_sigma: float = 0.0
    """1 sigma of the refractivity that the correction leaves, N-units; 0: no state."""
    second_order: bool = False
    """It estimates products of the position error (`filter.error_products`)."""


@dataclass(frozen=True)
class Beacons(AidingSensor):
    """Ranging beacons, asked in turn."""

    name, kind, numbers, unit = "beacons", BEACON, ("range",), "m"
    varies = True

    names: tuple[str, ...]
    """Names of the beacons."""
    plane: np.ndarray
    """(n, 2) s and l1 in runway axes, m (`gnss.pseudolite.runway_position`); nan where a beacon has coordinates."""
    llh: np.ndarray
    """(n, 3) surveyed coordinates and heights above the ellipsoid; coordinates nan for those in runway axes."""
    aim_point: float
    """Touchdown point beyond the threshold, m."""
    height: float
    """Height of the runway above the ellipsoid, m."""
    heading: float
    """Of landing, rad."""
    rate: float
    """Questions a second, to all beacons together, Hz."""
    latency: float
    """s."""
    sigma: float
    """1 sigma of the white noise of a strong signal, m."""
    weak_sigma: float
    """1 sigma of the further noise at `reach`, m; it grows with distance."""
    reach: float
    """Largest range, m."""
    terrain: Callable[[np.ndarray], Terrain]
    """What hides beacons, by the threshold of the runway (3,), rad, rad, m."""
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m."""
    true_errors: BeaconErrors
    outliers: Outliers
    design: BeaconDesign
    """Filter model."""
    events: tuple[Event, ...] = ()
    """What happens to beacons: silence, and errors of ranges."""
    jamming: LinkJamming | None = None
    """Jammers that reach the links, None without."""
    true_clock: TransmitterErrors | None = None
    """Errors of the receiver's clock against the beacons' time in one-way ranges; None for two-way ranges."""
    air: GroundAir | None = None
    """Residual delay by the air, None for none."""
    air_sigma: float = 0.0
    """1 sigma of the refractivity from run to run, N-units."""
    weakened: np.ndarray | None = None
    """(m,) factor on the noise of weak signals by jammers along the route; None without."""

    @property
    def clock(self) -> WanderingClocks | None:  # type: ignore[override]  # likewise
        """Clock of the receiver of one-way ranges."""
        return None if self.true_clock is None else WanderingClocks(self.true_clock, np.ones(1, bool))

    @property
    def sources(self) -> int:  # type: ignore[override]  # a field of the base class, derived here
        """Number of beacons."""
        return len(self.names)

    @property
    def has_outliers(self) -> bool:  # type: ignore[override]  # likewise
        """Whether some ranges are outliers."""
        return self.outliers.share > 0.0 or self.outliers.long_share > 0.0

    def threshold(self, frame: Frame) -> np.ndarray:
        """Threshold of the runway (3,), rad, rad, m."""
        out = llh_from_ecef(frame.origin - self.aim_point * frame.axes[:, 0])
        out[2] = self.height
        return out

    def positions(self, frame: Frame) -> np.ndarray:
        """Surveyed positions (n, 3), rad, rad, m."""
        threshold, out = self.threshold(frame), self.llh.copy()
        for row, (s, l1) in zip(out, self.plane, strict=True):
            if not math.isnan(s):
                row[:] = runway_position(threshold, self.heading, s, l1, row[2] - self.height)
        return out

    def transmitter_at(self, time: np.ndarray) -> np.ndarray:
        """Number of the beacon asked at times (m,), s, those of measurements."""
        return self.beacon_of(np.rint(time * self.rate).astype(np.int64) - 1)

    def beacon_of(self, question: np.ndarray) -> np.ndarray:
        """Number of the beacon asked by questions (m,) int, counted from 0."""
        return question % len(self.names)

    def away(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`away_from` the antenna at times (t,), s, of a flight, without beacons that are silent then."""
        antenna = self.antenna(flight, time)
        out, received = self.away_from(antenna, self.positions(flight.frame), self.threshold(flight.frame))
        if self.jamming is not None:
            # the signal is as strong, over noise and jammers, as without jammers from farther away
            worse = np.sqrt(np.maximum(*self._noise_of_links(flight.frame, time, antenna)))
            received &= worse * np.linalg.norm(out, axis=2) <= self.reach
        return out, received & ~self._happened(time, antenna, out).silent if self.events else received

    def _noise_of_links(self, frame: Frame, time: np.ndarray, antenna: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Noise with jammers over that without, of answers (t, 1) and of questions (t, n), for an antenna (t, 3) at
        times (t,), s."""
        assert self.jamming is not None
        threshold = self.threshold(frame)
        answers = self.jamming.noise(time, antenna[:, None], threshold)
        if self.true_clock is not None:  # nobody asks
            return answers, np.repeat(answers, len(self.names), axis=1)
        return answers, self.jamming.noise(time, ecef_from_llh(self.positions(frame)), threshold)

    def on_route(self, flight: Moving, time: np.ndarray) -> Beacons:
        """With the noise by jammers; half of the noise of a range is that of the question, half that of the answer."""
        if self.jamming is None:
            return self
        answers, questions = self._noise_of_links(flight.frame, time, self.antenna(flight, time))
        both = 0.5 * (answers[:, 0] + questions[np.arange(time.size), self.transmitter_at(time)])
        return replace(self, weakened=np.sqrt(both))

    def _happened(self, time: np.ndarray, antenna: np.ndarray, away: np.ndarray) -> EventEffects:
        """Effect of events on the ranges (t, n) at times (t,), s, from an antenna (t, 3) to beacons (t, n, 3) away."""
        axes, still = ned_matrix(llh_from_ecef(antenna)), np.zeros_like(away)
        systems = (BEACONS,) * len(self.names)
        return happened(self.events, Scene(time, self.names, systems, antenna[:, None] + away, still, antenna,
                                           np.zeros_like(antenna), axes))  # fmt: skip

    def antenna(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """The antenna (t, 3), ECEF, m, at times (t,), s."""
        from navsim.gnss.signals import antenna_ecef

        return antenna_ecef(flight.motion(time), self.lever_arm)

    def away_from(self, antenna: np.ndarray, llh: np.ndarray, threshold: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vectors (t, n, 3) from an antenna (t, 3) to beacons, ECEF, m; llh: of the beacons (n, 3), rad, rad, m.

        Also which of them the antenna receives (t, n) bool: those in reach, within the radio horizon and not behind
        terrain."""
        beacons = ecef_from_llh(llh)[None]
        out = beacons - antenna[:, None]
        here, there = llh_from_ecef(antenna)[:, 2] - self.height, llh[:, 2] - self.height
        horizon = horizon_distance(here)[:, None] + horizon_distance(there)
        received = np.linalg.norm(out, axis=2) <= np.minimum(self.reach, horizon)
        return out, received & ~behind(self.terrain(threshold), beacons, antenna)

    def line_of_sight(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vectors (m, 3) to the beacons asked, and whether they are received (m,), as `away`."""
        (away, received), of = self.away(flight, time), (np.arange(time.size), self.transmitter_at(time))
        return away[of], received[of]

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Ranges (m, 1) with the mean bias and errors by events, m; nan where the beacon asked is not received."""
        (away, received), of = self.away(flight, time), (np.arange(time.size), self.transmitter_at(time))
        distance, its = np.linalg.norm(away[of], axis=1), self.true_errors
        longer = self._happened(time, self.antenna(flight, time), away).longer[of] if self.events else 0.0
        if self.air is not None:
            longer = longer + self._delay(self.air, flight, time, distance)
        return np.where(received[of], distance + its.growth * its.grown(distance) + longer, np.nan)[:, None]

    def _delay(self, air: GroundAir, flight: Moving, time: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Delay (m,) by the air, m, over distances (m,) to the beacons asked at times (m,), s."""
        heights = self.positions(flight.frame)[self.transmitter_at(time), 2]
        return air.delay(llh_from_ecef(self.antenna(flight, time))[:, 2], heights, distance)

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 1) of the white noise, m; that of a strong signal where it measures nothing."""
        range_ = np.where(np.isnan(exact), 0.0, exact)  # nan: no measurement follows, its range stays nan
        further = self.weak_sigma / self.reach * range_
        return np.hypot(self.sigma, further if self.weakened is None else further * self.weakened[:, None])

    def spoiled(self, measured: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Ranges (m, 1) of a run with lost answers and outliers."""
        if self.outliers == Outliers():
            return measured
        return self.outliers.applied(measured, branch(draw, 1 + len(self.errors)))

    def table(self, frame: Frame, measured: np.ndarray) -> BeaconTable:
        """Ranges as the filter takes them."""
        its, llh = self.design, self.positions(frame)
        return BeaconTable(
            measured[:, 0].copy(), self.beacon_of(np.arange(len(measured))), ecef_from_llh(llh),
            ned_matrix(llh), its.sigma, its.weak_sigma / self.reach, its.errors.growth,
            its.errors.growth_distance, its.lever_arm,
            np.empty(0) if its.outliers is None else its.outliers.mixture(),
            np.empty(0) if self.weakened is None else self.weakened,
            (llh[:, 2] - self.height) / SCALE_HEIGHT if its.air_sigma else np.empty(0), self.height,
            SCALE_HEIGHT,
        )  # fmt: skip

    def noise_variance(self, distance: np.ndarray) -> np.ndarray:
        """Variance of the noise of ranges at distances (m,), m2, in the filter model, without jammers."""
        return np.asarray(self.design.sigma**2 + (self.design.weak_sigma / self.reach * distance) ** 2)

    @property
    def design_latency(self) -> float:
        """Age of a measurement on arrival in the filter model, s."""
        return self.design.latency

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the beacons."""
        its = self.design
        mine = self.sigma, self.weak_sigma, self.latency, self.true_errors, self.true_clock
        same = mine == (its.sigma, its.weak_sigma, its.latency, its.errors, its.clock)
        same &= self.air is None and self.outliers == Outliers()
        same &= all(isinstance(event.what, Silence) for event in self.events)
        return same and np.array_equal(self.lever_arm, its.lever_arm)

    @property
    def errors(self) -> tuple[SensorError, ...]:
        """The errors of each beacon that last over a run: bias, its growth, and survey along north, east and down; then
        the air and the clock of all."""
        own = zip(_SOURCES, self.true_errors.sigma, strict=True)
        each = [SensorError(name, sigma, math.inf) for name, sigma in own]
        air = [SensorError("air", self.air_sigma, math.inf)] if self._draws_air else []
        clock = [] if self.true_clock is None else [SensorError("clock", self.true_clock.offset, math.inf)]
        return (*each * len(self.names), *air, *clock)

    def effects(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Derivatives (m, 1, 1) of the ranges by each of these errors."""
        its, asked = self.true_errors, self.transmitter_at(time)
        away, _ = self.line_of_sight(flight, time)
        distance = np.linalg.norm(away, axis=1)
        # a longer way also has a larger bias
        steeper = 1.0 + its.growth / its.growth_distance * np.exp(-distance / its.growth_distance)
        along = np.einsum("mj,mkj->mk", away, ned_matrix(self.positions(flight.frame))[asked])
        along *= (steeper / distance)[:, None]
        each = np.column_stack([np.ones_like(distance), its.grown(distance), along])
        of_beacons = (
            np.where(asked == beacon, each[:, k], 0.0)[:, None, None]
            for beacon in range(len(self.names))
            for k in range(BEACON_STATES)
        )
        common = [] if self.true_clock is None else [np.ones((asked.size, 1, 1))]
        if self.air is not None and self._draws_air:
            of_one_unit = replace(self.air, truth=1.0, corrected=0.0)
            common.insert(0, self._delay(of_one_unit, flight, time, distance)[:, None, None])
        return (*of_beacons, *common)

    @property
    def _draws_air(self) -> bool:
        """Whether the refractivity is an error of runs or of the filter model."""
        return bool(self.air_sigma or self.design.air_sigma)

    @property
    def mean_errors(self) -> np.ndarray:
        """Mean of each error beyond the filter's own: `noise_free` includes the mean bias, and the filter takes off
        that of its model."""
        out = np.zeros(len(self.errors))
        count = BEACON_STATES * len(self.names)
        out[1:count:BEACON_STATES] = self.true_errors.growth - self.design.errors.growth
        if self.air is not None and self._draws_air:
            out[count] = self.air.residual
        return out

    @property
    def followed(self) -> tuple[int, ...]:
        """The errors that the filter estimates."""
        air = [BEACON_STATES * len(self.names)] if self.design.air_sigma else []
        clock = [] if self.design.clock is None else [len(self.errors) - 1]
        return (*(block.first for block, _ in blocks_of(self.names, self.design.errors)), *air, *clock)

    def states(self, step: float) -> tuple[tuple[Block, float], ...]:
        """States for these errors, m."""
        out, first = list(blocks_of(self.names, self.design.errors)), BEACON_STATES * len(self.names)
        if self.design.air_sigma:
            own = Block(f"{self.name}_refractivity", "1", BEACON, first=first + 2, size=1)
            out.append((own, self.design.air_sigma))
        if (clock := self.design.clock) is not None:
            out += clock_blocks(RECEIVER_CLOCK, first, clock.density, (clock.offset, clock.rate))
        if self.design.second_order:
            each = (f"{self.name}_product{axes}" for axes in _PRODUCTS)
            out += [(Block(name, "m2", PRODUCT, first=k, size=1), 1.0) for k, name in enumerate(each)]
        return tuple(out)


def blocks_of(names: Sequence[str], errors: BeaconErrors) -> Iterator[tuple[Block, float]]:
    """The state of each error of these beacons that a filter estimates, and its 1 sigma, m."""
    for number, beacon in enumerate(names):
        for k, sigma in enumerate(errors.sigma):
            if sigma > 0.0:
                name = f"{Beacons.name}_{_STATES[k]}_{beacon}{_AXES[k]}"
                yield Block(name, "m", BEACON, first=BEACON_STATES * number + k, size=1), sigma


def clock_blocks(
    name: str, first: int, density: tuple[float, float], sigma: tuple[float, float],
    reference: ReferenceClock = NO_REFERENCE,
) -> list[tuple[Block, float]]:  # fmt: skip
    """Offset and rate of a clock in one-way ranges, with their 1 sigma, m, m/s.

    first: number of the offset among the errors of beacons. density: of the clock's white noises of phase and
    frequency, m2/s, m2/s3.
    """
    model = TransmitterClockModel(*density, 0.0, reference)
    offset = Block(name.format(""), "m", BEACON, first=first, size=1, clock=model)
    rate = Block(name.format("_rate"), "m/s", BEACON, first=first + 1, size=1)
    return [(offset, sigma[0]), (rate, sigma[1])]


def largest_range(radiated: float, gain: float, sensitivity: float, carrier: float) -> float:
    """Largest range in free space, m: where the received power is the sensitivity.

    radiated: equivalent isotropically radiated power, dBm. gain: of the receiving antenna, dBi. sensitivity: dBm.
    carrier: Hz.
    """
    return float(SPEED_OF_LIGHT / (4.0 * np.pi * carrier) * 10.0 ** ((radiated + gain - sensitivity) / 20.0))
