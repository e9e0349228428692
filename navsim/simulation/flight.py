"""A landing ready for its runs: the truth common to all, the filter, the schedule of events, and initial estimates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from navsim.compiler.lanes import in_lanes
from navsim.filter import eskf, states
from navsim.filter.design import FilterDesign, clock_sigma
from navsim.filter.estimate import in_all_lanes, is_smoother
from navsim.filter.measurement_kinds import FIX, RANGE
from navsim.filter.records import (
    Events,
    FilterModel,
    State,
    schedule,
    start,
)
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.gnss.dll import ReflectionErrors
from navsim.integrity import monitoring
from navsim.integrity.fix_exclusion import Excluder
from navsim.integrity.gbas_station import StationLevels
from navsim.sensors import imu
from navsim.simulation.correlated_errors import RangeErrors, as_noise, fix_weights
from navsim.simulation.dispersed_trajectory import DispersedTrajectories
from navsim.simulation.range_curvature import (
    NEGLIGIBLE,
    Curvature,
    NearPass,
    has_near_sources,
    near_passes,
)
from navsim.simulation.shared_truth import SharedTruth
from navsim.simulation.transmitter_errors import TransmitterBelief, TransmitterStates
from navsim.statistics.random_streams import generator
from navsim.trajectory.kinematics import Motion


@dataclass(frozen=True)
class InitialErrors:
    """1 sigma per axis of the initial errors, rad, m, m/s; `fixed` (9,) position, velocity, attitude errors
    (truth - estimate) instead of drawn ones."""

    attitude: float
    position: float
    velocity: float
    fixed: np.ndarray | None = None


def initial_errors(flight: Flight, seed: int, run: int) -> np.ndarray:
    """Errors of the navigation states at time 0 (9,), truth - estimate: drawn or fixed."""
    errors = flight.initial
    sigma = np.repeat([errors.position, errors.velocity, errors.attitude], 3)
    drawn = generator(seed, run, "initial").standard_normal(states.SENSORS) * sigma
    return drawn if errors.fixed is None else errors.fixed


def initial_clock_errors(flight: Flight, seed: int, run: int) -> np.ndarray:
    """Errors of the clock's states at time 0 (c,), truth - estimate."""
    sigma = clock_sigma(len(flight.scales))
    return generator(seed, run, "clock", 1).standard_normal(sigma.size) * sigma


def initial_estimate(flight: Flight, errors: np.ndarray, flown: DispersedTrajectories | None = None) -> np.ndarray:
    """Navigation states at time 0 (NAV_N, W) of runs with these `initial_errors` (9, W), on their trajectories."""
    nav = in_all_lanes(exact_start(flight.shared.at_filter))
    if flown is not None:
        nav[states.NAV_LLH : states.NAV_VEL] = flown.llh[0]
        nav[states.NAV_VEL : states.NAV_QUAT] = flown.velocity[0]
        nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = flown.quaternion[0]
    eskf.displace(in_lanes(nav), in_lanes(-errors))
    return nav


def with_clock(flight: Flight, nav: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Navigation states (NAV_N, ...), other sensor states that are zero, and those of the clock (c, ...)."""
    if not flight.scales:
        return nav
    out = np.zeros((states.NAV_SENSORS + flight.covariance.shape[0] - states.SENSORS, *nav.shape[1:]))
    out[: nav.shape[0]], out[-clock.shape[0] :] = nav, clock
    return out


def exact_clock(flight: Flight) -> np.ndarray:
    """True clock states of the filter at its outputs, without noise (o, c)."""
    now, scales = flight.shared.clock_at_filter, list(flight.scales)
    if not scales:
        return np.empty((now.shape[0], 0))
    return np.concatenate([now[:, :1] + flight.shared.scale_offsets[scales], now[:, 1:]], axis=1)


def exact_start(truth: Motion) -> np.ndarray:
    """The navigation state at time 0 without error (NAV_N,)."""
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_VEL] = truth.llh[0]
    nav[states.NAV_VEL : states.NAV_QUAT] = truth.velocity_ned[0]
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = truth.quaternion[0]
    return nav


@dataclass(frozen=True)
class Flight:
    """A landing that a filter can fly any number of times."""

    shared: SharedTruth
    initial: InitialErrors
    """True initial errors."""
    gyro: imu.Triad
    """True gyros."""
    accel: imu.Triad
    """True accelerometers."""
    design: FilterDesign
    """Filter model."""
    covariance: np.ndarray
    """(n, n) initial covariance of the filter."""
    events: Events
    """In the order of the filter."""
    event_of_measurement: np.ndarray
    """(e, 1) event of each fix, or (e, s) of each range; -1 for a range that is not received."""
    model: FilterModel
    """`design` for the kernels."""
    start: InitialErrors
    """1 sigma of the initial errors in the filter model."""
    watching: monitoring.Monitoring | None = None
    """Monitor; None without."""
    transmitters: TransmitterBelief | None = None
    """Filter model of errors of transmitters, None without."""
    second_order: bool = True
    """Whether the filter model includes second-order errors near sources."""

    @cached_property
    def bank(self) -> monitoring.SubfilterMonitor | None:
        """Filters that monitor the filter, None without."""
        return None if self.watching is None or self.watching.bank is None else self.watching.bank(self)

    @cached_property
    def snapshot(self) -> monitoring.Snapshot | None:
        """Monitor of the fixes, None without."""
        return None if self.watching is None or self.watching.bank else self.watching.over(self.shared.signals)

    @cached_property
    def station(self) -> StationLevels | None:
        """GBAS levels of its fixes with drawn B values, None without."""
        if self.watching is None or self.watching.station is None:
            return None
        return self.watching.station.over(self.shared.signals, monitoring.fix_of(self.shared.signals))

    @property
    def monitor(self) -> monitoring.LandingMonitor | None:
        """Monitor of the landing, None without."""
        return self.snapshot or self.bank

    @property
    def expected(self) -> tuple[monitoring.ExpectedFault, ...]:
        """The faults that it expects."""
        return () if self.watching is None else self.watching.expected(self.shared.signals)

    @property
    def limited(self) -> bool:
        """Whether an inertial sensor has a range."""
        return any(math.isfinite(triad.further.largest) for triad in (self.gyro, self.accel))

    @property
    def scales(self) -> tuple[int, ...]:
        """Numbers of the time scales that the filter has a bias of the clock for."""
        return self.design.followed(self.shared.scales)

    @property
    def candidates(self) -> tuple[monitoring.ExpectedFault, ...]:
        """Candidates for exclusion after an alarm."""
        return () if self.watching is None else self.watching.candidates(self.shared.signals)

    @property
    def drops(self) -> bool:
        """Whether its filter does without fixes with an alarm, or their ranges."""
        return self.watching is not None and self.watching.drops

    @cached_property
    def excluder(self) -> Excluder | None:
        """Excludes candidates, None without exclusion."""
        if self.watching is None or self.watching.exclusion == monitoring.NO_EXCLUSION:
            return None
        return Excluder(self.watching, self.shared.signals, self.shared.start, self.shared.antenna_enu)

    @cached_property
    def range_errors(self) -> RangeErrors:
        """Time-correlated errors of ranges as states, where a tightly coupled filter follows them."""
        assert self.design.correlated is not None
        return RangeErrors(self.shared.signals, self.design.correlated)

    @cached_property
    def reflection_sigma(self) -> np.ndarray | None:
        """1 sigma of reflection errors (e, s), m, about their mean, as noise in the filter model; their correlation
        enlarges it.

        None without reflections, or if the filter model neglects them.
        """
        reflections, time = self._reflections, self.shared.signals.time
        if reflections is None or time.size < 2:
            return None
        duration, interval = float(time[-1] - time[0]), float(np.median(np.diff(time)))
        return np.asarray(reflections.sigma * np.sqrt(as_noise(reflections.time, duration, interval)))

    @property
    def _reflections(self) -> ReflectionErrors | None:
        """Reflection errors in the filter model."""
        return self.shared.signals.reflections if self.design.reflections else None

    @cached_property
    def fix_bias(self) -> np.ndarray | None:
        """The errors of fixes (e, MOST) that a loosely coupled filter takes off: the mean of second-order errors, and
        of errors by reflections over all phases; None of none."""
        out = None if self.curvature is None else self.curvature.mean
        if self._reflections is not None:
            mean = np.where(self.shared.signals.used, self._reflections.mean, 0.0)
            by_reflections = np.einsum("ems,es->em", self.shared.fix_errors.by_range, mean)
            out = by_reflections if out is None else out + by_reflections
        return out

    @property
    def range_bias(self) -> np.ndarray:
        """The errors of ranges (e, s), m, that a tightly coupled filter takes off: the mean of those by reflections."""
        reflections = self._reflections
        return np.zeros_like(self.shared.signals.range) if reflections is None else reflections.mean

    @property
    def range_error_sigma(self) -> np.ndarray:
        """1 sigma of the errors of each group (e, s, g), m, that a tightly coupled filter follows; of no size where it
        follows none."""
        correlated = self.design.correlated
        if correlated is None or not correlated.followed or self.shared.signals.correlated is None:
            return np.empty((*self.shared.signals.used.shape, 0))
        return self.range_errors.size

    @cached_property
    def transmitter_states(self) -> TransmitterStates | None:
        """States for errors of transmitters, None if the filter has none."""
        if self.transmitters is None or not self.transmitters.followed:
            return None
        return TransmitterStates(self.shared.signals, self.transmitters.errors)

    @property
    def transmitter_effects(self) -> np.ndarray:
        """Effect (e, MOST, q) of errors of transmitters on fixes in the filter model."""
        mine, errors = self.transmitter_states, self.shared.fix_errors if self.transmitter_states else None
        return (
            np.empty((0, MAX_MEASUREMENT_SIZE, 0))
            if mine is None or errors is None
            else mine.on_fixes(errors.by_range, errors.by_rate)
        )

    @property
    def white_variance(self) -> np.ndarray:
        """White noise of the filter model (2, e, s), ranges and range rates, less the receiver's variances.

        Errors of transmitters are taken off if they are states, and enlarged if the filter inflates them.
        """
        if self.transmitters is None:
            return np.zeros((2, *self.shared.signals.range.shape))
        factor = 0.0 if self.transmitters.followed else self.transmitters.factor
        return (factor - 1.0) * self.shared.signals.transmitter_variance

    @cached_property
    def correlated_roots(self) -> np.ndarray:
        """Effect of estimated time-correlated errors on fixes (e, MOST, k)."""
        correlated = self.design.correlated
        if correlated is None or not correlated.followed:
            return np.empty((0, MAX_MEASUREMENT_SIZE, 0))
        return self.design.sigma_scale * self.shared.fix_errors.roots(correlated.groups)

    @cached_property
    def correlated_projections(self) -> np.ndarray:
        """Effect of errors of each kind and source on those (e, k, kinds, s), if the filter estimates them."""
        assert self.design.correlated is not None
        return self.shared.fix_errors.projections(self.design.correlated.groups) / self.design.sigma_scale

    def correlated_of_states(self, epoch: int) -> np.ndarray:
        """Effect (n, k, s) of time-correlated errors of variance one, of each kind and source, on the filter's states
        for them.

        Of an epoch; states in units of their sigma in the filter model. Empty if the filter estimates none.
        """
        correlated, signals = self.design.correlated, self.shared.signals
        assert signals.correlated is not None
        if correlated is None or not correlated.followed:
            return np.empty((0, *signals.correlated.sigma.shape[::2]))
        if not self.design.tight:
            return np.asarray(self.correlated_projections[epoch])
        return self.range_errors.projections(epoch) / self.design.sigma_scale

    @cached_property
    def uncorrelated_noise(self) -> np.ndarray:
        """Covariance of the white part of each fix (e, MOST, MOST), m2, beside estimated time-correlated errors."""
        assert self.design.correlated is not None
        errors = self.shared.fix_errors
        return self._fix_noise + errors.beside(self.design.correlated.groups)

    @property
    def _fix_noise(self) -> np.ndarray:
        """Covariance of fixes (e, MOST, MOST) by white noise."""
        errors = self.shared.fix_errors
        return errors.noise if self.transmitters is None else errors.white(-self.white_variance)

    @cached_property
    def noise_along_route(self) -> np.ndarray | None:
        """Covariance of fixes (e, MOST, MOST) from the geometry of the route; None if the filter uses the receiver's
        own.

        The receiver computes its covariance at the fix, which near a source depends on the error of the fix.
        """
        correlated, curvature = self.design.correlated, self.curvature
        if correlated is not None and correlated.followed:
            noise = self.uncorrelated_noise
        elif curvature is None and self.transmitters is None:
            return None
        else:
            noise = self._fix_noise
            noise = noise + (0.0 if correlated is None else self.shared.fix_errors.of_kinds(correlated.factor))
        return noise if curvature is None else noise + curvature.noise

    @cached_property
    def _second_order(self) -> Curvature | None:
        """Second-order errors of fixes, None if negligible.

        If the filter uses ranges, only those due to time-correlated errors; the others average out.
        """
        signals = self.shared.signals
        if not has_near_sources(signals):
            return None
        noise, correlated = signals.noise_sigma, np.zeros_like(signals.fix_sigma)
        if signals.smoothing is not None:
            noise, correlated = correlated, signals.fix_sigma
        elif signals.correlated is not None:
            correlated = signals.correlated.total
        noise = np.zeros_like(noise) if self.design.tight else noise
        found = self.shared.fix_errors.curvature(noise, correlated, MAX_MEASUREMENT_SIZE if self.design.velocity else 3)
        return found if found.squares > NEGLIGIBLE else None

    @property
    def _has_second_order(self) -> bool:
        """Whether the filter model includes second-order errors.

        It does not if the sources of a fix may differ from those of the route: monitoring filters have fewer, and
        exclusion removes some.
        """
        watching = self.watching
        other = watching is not None and (watching.bank or (self.excluder and not self.design.tight))
        return self.second_order and not other and self._second_order is not None

    @property
    def curvature(self) -> Curvature | None:
        """Second-order errors of fixes in a loosely coupled filter model; None if negligible."""
        return self._second_order if self._has_second_order and not self.design.tight else None

    @cached_property
    def range_curvature(self) -> Curvature | None:
        """Second-order errors of the ranges (m, 2) of all epochs and sources in a tightly coupled filter model; None if
        negligible.

        They follow from the filter's own position errors, to first order.
        """
        if not self._has_second_order or not self.design.tight:
            return None
        from navsim.simulation.landing_covariance import curvature_of_ranges

        return curvature_of_ranges(replace(self, second_order=False))

    @cached_property
    def near_passes(self) -> tuple[NearPass, ...]:
        """Sources that are passed so near that covariances are not right there: to second order, where the filter knows
        of that part, because the third counts; to first order, where it does not."""
        if self._second_order is None:
            return ()
        signals = self.shared.signals
        sigma = signals.correlated.total if self.design.tight and signals.correlated is not None else signals.fix_sigma
        order = 2 if self._has_second_order else 1
        every = near_passes(signals, self.shared.fix_errors.of_ranges(sigma), order)
        return tuple(one for one in every if one.counts)

    @property
    def range_sigma(self) -> np.ndarray:
        """1 sigma of pseudoranges (e, s), m, as noise in a tightly coupled filter model."""
        signals, correlated = self.shared.signals, self.design.correlated
        sigma = signals.fix_sigma
        if correlated is not None and signals.correlated is not None:
            of_kinds = (
                0.0 if correlated.followed else np.einsum("k,kes->es", correlated.factor, signals.correlated.sigma**2)
            )
            sigma = np.sqrt(signals.noise_sigma**2 + of_kinds)
        if self.transmitters is not None:
            sigma = np.sqrt(np.maximum(sigma**2 + self.white_variance[0], 0.0))
        return sigma if self.reflection_sigma is None else np.hypot(sigma, self.reflection_sigma)

    @cached_property
    def along_route(self) -> Flight:
        """Copy whose runs fly the route."""
        return replace(self, shared=replace(self.shared, dispersion=None))

    @property
    def with_receiver_fixes(self) -> Flight:
        """Copy whose filter takes fixes with the weights of the receiver."""
        signals = replace(self.shared.signals, filter_fix_sigma=None)
        return replace(self, shared=replace(self.shared, signals=signals))

    @cached_property
    def _without(self) -> dict[int, Flight]:
        """Cache of `without`."""
        return {}

    def without(self, candidate: int) -> Flight:
        """The flight without the sources of one of `candidates`, for the filter model of fixes made without them."""
        if candidate not in self._without:
            signals = self.shared.signals
            kept = ~np.isin(signals.names, self.candidates[candidate].sources)
            shared = replace(self.shared, signals=replace(signals, used=signals.used & kept))
            self._without[candidate] = replace(self, shared=shared)
        return self._without[candidate]

    @property
    def rate_sigma(self) -> np.ndarray:
        """1 sigma of range rates (e, s), m/s, as noise in a tightly coupled filter model."""
        sigma = self.shared.signals.fix_rate_sigma
        if self.transmitters is None:
            return sigma
        return np.sqrt(np.maximum(sigma**2 + self.white_variance[1], 0.0))

    def over(self, shared: SharedTruth) -> Flight:
        """Copy of this flight with another world."""
        return prepare(
            shared, self.initial, self.gyro, self.accel, self.design, self.start, self.watching, self.transmitters
        )


def prepare(
    shared: SharedTruth,
    initial: InitialErrors,
    gyro: imu.Triad,
    accel: imu.Triad,
    design: FilterDesign,
    start: InitialErrors,
    watching: monitoring.Monitoring | None = None,
    transmitters: TransmitterBelief | None = None,
) -> Flight:
    """Create a flight; start: 1 sigma of the initial errors in the filter model.

    Fixes that exclusion may change, and those of monitoring filters, have no weights for lasting errors.
    """
    changes = watching is not None and (watching.bank is not None or watching.exclusion != monitoring.NO_EXCLUSION)
    if transmitters is not None and not design.tight and not changes:
        shared = replace(shared, signals=fix_weights(shared.signals, transmitters.errors))
    if transmitters is not None and transmitters.followed:
        design = design.with_transmitter_errors(TransmitterStates(shared.signals, transmitters.errors).blocks())
    if design.tight and design.correlated is not None and design.correlated.followed:
        step = float(shared.imu_time[1] - shared.imu_time[0])
        errors = (
            () if shared.signals.correlated is None else RangeErrors(shared.signals, design.correlated).blocks(step)
        )
        design = design.with_range_errors(errors)
    covariance = design.covariance(start.position, start.velocity, start.attitude, shared.scales)
    model = design.model(scales=shared.scales)
    return Flight(
        shared,
        initial,
        gyro,
        accel,
        design,
        covariance,
        *_schedule_events(shared, design),
        model,
        start,
        watching,
        transmitters,
    )


def _schedule_events(shared: SharedTruth, design: FilterDesign) -> tuple[Events, np.ndarray]:
    """The events of a flight, and those of its fixes or ranges, see `Flight`."""
    # the filter knows the arrival of a fix and its age in the filter model
    arrival = shared.filter_time[1:]
    valid = np.maximum(arrival - design.latency, 0.0)
    smooths = is_smoother(design.kind)
    known = valid if smooths else arrival
    heard = shared.signals.used if design.tight else np.ones((arrival.size, 1), bool)
    epoch, kind = np.nonzero(heard)[0], RANGE if design.tight else FIX
    events = schedule(
        shared.filter_time, (kind, valid[epoch], known[epoch]),
        *((aid.sensor.kind, aid.valid, aid.valid if smooths else aid.arrival) for aid in shared.aids),
    )  # fmt: skip
    weighed = np.full(heard.shape, -1)
    weighed[heard] = events.rows(kind)
    return events, weighed


def initial_state(flight: Flight, nav: np.ndarray, covariance: np.ndarray) -> State:
    """Initial state of a flight's filter; nav (NAV,), covariance (n, n), of one run or of lanes."""
    sources = len(flight.shared.signals.names) if flight.design.tight else 0
    sources += sum(aid.sensor.sources for aid in flight.shared.aids)
    return start(nav, covariance, flight.model.components, sources)
