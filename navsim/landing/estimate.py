"""Estimates of landings: runs, and covariance analysis."""

from __future__ import annotations

from dataclasses import dataclass

from navsim.compiler.lanes import WIDTH
from navsim.filter.states import MAX_MEASUREMENT_SIZE, clock_states
from navsim.gnss.constellations.systems import OWN
from navsim.gnss.events import PSEUDOLITES
from navsim.gnss.signals import SignalScenario
from navsim.integrity.fix_exclusion import MOST_KEPT, STRETCH
from navsim.landing.ensemble import HISTORIES, history_bytes
from navsim.landing.simulation_size import ANALYSED_MEMORY, SAMPLE_MEMORY, SIGNAL_MEMORY, simulation_size
from navsim.landing.total_errors import indicator_of
from navsim.results.schema import SKY_TIMES
from navsim.runner.batches import BATCH, TASK_BYTES
from navsim.runner.control_variates import LEAST_RUNS
from navsim.runner.estimate import (
    BASE_MEMORY,
    BATCH_FILE,
    BUILT_IN_MEMORY,
    NUMBER,
    VARIABLE,
    WRITING,
    Budget,
)  # fmt: skip
from navsim.scenario.estimated_errors import correlated_states, gain_states, transmitter_states
from navsim.scenario.filter import SMOOTHERS, SUM
from navsim.scenario.landing import Landing
from navsim.simulation.aiding import followed_errors, measurement_times
from navsim.simulation.error_sources import SOURCES
from navsim.simulation.inertial_states import true_states

STATISTICS = 288
"""Memory for the statistics of a run, bytes; three times while they are computed."""
FIRST_ORDER = 36
"""Numbers that an ensemble keeps of the first-order errors of a run."""
CONTROLLED = 30
"""Variables of controlled estimates; those of each run have 12 numbers."""
COLUMNS = 52
"""Numbers of a run that its result keeps for merging."""
PUSHED = 8
"""Numbers that a result keeps of a pushed run."""
WAY = 40
"""Numbers that a run's own way has at a sample."""
FLOWN = 60
"""Numbers of a run at an epoch during the simulation, besides its measurements and history."""


@dataclass(frozen=True)
class Extent:
    """Sizes of a landing."""

    samples: int
    """Samples of the inertial sensors."""
    epochs: int
    """Fix epochs."""
    sources: int
    """Sources of signals."""
    clocks: int
    """Clock unknowns of a fix."""
    states: int
    """States of the filter."""
    aided: int
    """Measurements of sensors beside the receiver."""
    ahead: float
    """Measurements that are processed again while the filter waits for late fixes."""
    watched: int
    """Monitored fixes."""
    settled: int
    """Fixes with exclusion."""
    ranged: int = 0
    """Sources whose ranges are measurements."""
    tried: int = 0
    """Epochs with monitored innovations."""
    filters: int = 0
    """Approximate number of filters that monitor the filter."""
    deviating: int = 0
    """Random numbers at each sample for trajectories that deviate from the route."""
    limited: int = 0
    """Counters of samples beyond the sensors' ranges."""
    imperfect: bool = False
    """Inertial sensors have errors beyond those that are drawn with the noise."""
    ways: bool = False
    """Each run has its own trajectory. Discrete gusts are not drawn."""
    steered: bool = False
    """Estimates steer the runs."""
    breaks_off: bool = False
    """Alarms break runs off."""
    stated: int = 0
    """Fixes with a state."""
    interfering: int | None = None
    """Signals that interfere with the sources', None without interference."""
    single: int = 0
    """States other than the clock's that belong to no group of three."""
    served: int = 0
    """Fixes with drawn B values of a ground station."""

    def sizes(self) -> dict[str, int]:
        """Sizes of the dimensions of a run's histories."""
        of_clock = clock_states(self.clocks) if self.ranged else 0
        return {
            "epoch": self.epochs, "output": self.epochs + 1, "source": self.sources, "state": self.states,
            "group": (self.states - of_clock - self.single) // 3, "aided": self.aided, "watched": self.watched,
            "settled": self.settled, "served": self.served,
            "ranged": self.ranged, "loose": 0 if self.ranged else self.epochs,
            "tried": self.tried,
            "limited": self.limited, "sample": self.samples, "linear": 0, "steered": int(self.steered),
            "stated": self.stated, "ended": int(self.ways), "broken_off": int(self.breaks_off),
            "deviating": self.epochs + 1 if self.ways else 0, "met": self.epochs if self.ways else 0,
        }  # fmt: skip


def extent(scenario: Landing, sources: SignalScenario) -> Extent:
    """The numbers of a scenario under a sky."""
    size = simulation_size(scenario, sources)
    fixes, names = size.epochs, size.sources
    clocks = {int(number) for group in sources.satellites for number in group.time_scale[group.chosen]}
    of_ground = len(sources.pseudolites.names)
    if sources.listed is not None:
        clocks |= {int(number) for number in sources.listed.time_scale[sources.listed.chosen]}
    if of_ground:
        clocks.add(sources.pseudolites.time_scale)
    scales = 1 if sources.effects.single_clock else len(clocks)
    jamming = sources.jamming
    correlated = correlated_states(scenario, names // 2)  # about half of a sky is received
    sensors = scenario.aiding()
    watched = 0 if scenario.beacons is None else len(scenario.beacons.sites) + 1
    of_aids = [block.size for block, _ in followed_errors(sensors, 1.0 / scenario.imu.rate_hz)]
    return Extent(
        size.samples, fixes, names, scales,
        scenario.filter.states(
            scales, gain_states(scenario) + correlated + transmitter_states(scenario) + sum(of_aids)
        ),
        sum(measurement_times(sensor, scenario.duration_s, scenario.imu.rate_hz).size for sensor in sensors),
        fixes * _waiting(scenario) * sum(sensor.rate for sensor in sensors),
        0 if scenario.integrity is None else fixes,
        0 if scenario.integrity is None or scenario.integrity.exclusion == "none" else fixes,
        names if scenario.filter.tight else 0,
        0 if scenario.integrity is None or scenario.integrity.innovations is None else fixes,
        # one for each source that is received, about half of a sky, for each system, and some for two at once
        0
        if scenario.integrity is None or scenario.integrity.method != "filter"
        else (names // 2 + 4 + watched) * (1 if scenario.integrity.exclusion == "none" else 1 + watched),
        scenario.trajectory_draws(),
        2 if scenario.imu.limited() else 0,
        any(triad.further.there for triad in scenario.imu.triads()),
        scenario.air() is not None,
        scenario.steered,
        scenario.breaks_off,
        0 if scenario.receiver.fix_states is None else fixes,
        None if jamming is None else len(jamming.jammers) + (0 if jamming.pseudolites is None else of_ground),
        (correlated if scenario.filter.tight else 0)
        + transmitter_states(scenario)
        + sum(size for size in of_aids if size < 3),
        fixes if scenario.draws_b_values else 0,
    )  # fmt: skip


def estimate_landing(
    scenario: Landing, sources: SignalScenario, runs: int = 1, keep: str = "all", workers: int = 1, remote: bool = False
) -> Budget:
    """Estimate for a landing by its own method; runs, keep, workers: only for Monte Carlo.

    remote: whether the workers have memory of their own.
    """
    sizes = extent(scenario, sources)
    if scenario.method == "covariance":
        return _analysed(scenario, sources, sizes)
    if scenario.method == "rare":
        return _pushed(scenario, sizes, runs, workers, remote)
    workers = max(1, min(workers, -(-runs // BATCH)))
    of_run = sum(history_bytes(name, sizes.sizes()) for name in HISTORIES[keep])
    stored = _stored(sizes, keep)
    batches = -(-runs // BATCH)
    sums = (runs // BATCH + _blocks(runs % BATCH)) * sums_bytes(sizes)
    held = of_run * (min(runs, BATCH) * (2 * workers if runs > BATCH else 1)) + workers * flying_memory(scenario, sizes)
    if remote:  # results of a task, twice
        held = 2 * max(TASK_BYTES, of_run * min(runs, BATCH))
    streamed = runs * stored
    # in addition to the sums of each block, once, the entry of each of their numbers
    linear = FIRST_ORDER if runs > 1 else 0
    statistics = STATISTICS + NUMBER * linear
    part = runs * (COLUMNS + linear + (56 if sizes.ways else 0)) * NUMBER + (_blocks(runs) + 1) * sums_bytes(sizes)
    result = _common_bytes(scenario, sizes) + streamed + part + runs * 13 * NUMBER
    result += NUMBER * (5 + sizes.sizes()["group"] + 3 * sizes.states) * (sizes.epochs + 1)
    variables = {"none": 119, "errors": 128, "all": 152}[keep] + (27 if runs > 1 else 0)
    if runs >= LEAST_RUNS:
        variables += CONTROLLED
        result += 12 * NUMBER * runs
    if sizes.ways:
        variables += {"none": 32, "errors": 35, "all": 39}[keep]
        result += 4 * NUMBER * runs
    if sizes.breaks_off:
        variables += 9
        result += 4 * NUMBER * runs
    if indicator_of(scenario) is not None:
        variables += 24
        result += 24 * NUMBER * runs
    correlated = 0 if scenario.filter.tight else correlated_states(scenario, sizes.sources)
    if keep == "all" and correlated:
        result += NUMBER * MAX_MEASUREMENT_SIZE * sizes.epochs * correlated  # their effects on fixes
        variables += 2
    result += variables * VARIABLE + NUMBER * (sizes.epochs + sizes.sources + (sizes.samples if keep == "all" else 0))
    image = WRITING * (result if streamed < BUILT_IN_MEMORY else result - streamed)
    return Budget(
        shared_memory(sizes) + _linear_memory(sizes, runs) + held + 3 * statistics * runs + sums + image,
        result,
        runs * (of_run + statistics) + sums + batches * BATCH_FILE if runs > BATCH else 0.0,
    )


def _blocks(runs: int) -> int:
    """Blocks of powers of two in the tree of sums (`runner.exact_sums`) over runs from 0."""
    return runs.bit_count()


def _waiting(scenario: Landing) -> float:
    """Time for which the filter waits for late measurements, s."""
    assumed = scenario.filter.latency_s
    of_fixes = scenario.receiver.latency_s if assumed is None else assumed
    return max(of_fixes, *(sensor.design_latency for sensor in scenario.aiding()), 0.0)


def flying_memory(scenario: Landing, sizes: Extent) -> float:
    """Memory of a worker for the runs that it processes at once, bytes."""
    kept = sum(history_bytes(name, sizes.sizes()) for name in HISTORIES["all"])
    of_one = 2 * kept + NUMBER * (6 * sizes.samples + FLOWN * sizes.epochs)
    if sizes.imperfect:  # increments that vibrate, drifts, walks, gains, quanta
        of_one += NUMBER * 15 * sizes.samples
    if sizes.ways:
        of_one += NUMBER * ((WAY + sizes.deviating) * sizes.samples + sizes.epochs * (60 + 2 * sizes.sources))
    if scenario.filter.kind in SMOOTHERS:  # its whole flight: five covariances at every time
        of_one += NUMBER * 5 * sizes.states**2 * (2 * sizes.epochs + sizes.aided)
    if scenario.filter.kind == SUM:
        of_one += NUMBER * 2 * sizes.states**2 * scenario.filter.gaussian_sum.components
    if sizes.settled:  # fixes of a stretch without each candidate
        of_one += NUMBER * FLOWN * STRETCH * sizes.sources
    of_one += NUMBER * MAX_MEASUREMENT_SIZE * sizes.filters * sizes.epochs
    return WIDTH * of_one + (MOST_KEPT if sizes.settled else 0)


def shared_memory(sizes: Extent) -> float:
    gains = (
        NUMBER
        * MAX_MEASUREMENT_SIZE
        * sizes.states
        * sizes.filters
        * (sizes.epochs * max(1, sizes.ranged // 2) + sizes.aided)
    )
    return BASE_MEMORY + SAMPLE_MEMORY * sizes.samples + SIGNAL_MEMORY * sizes.epochs * sizes.sources + 2 * gains


def _linear_memory(sizes: Extent, runs: int) -> float:
    """Memory of the linearised filter that computes first-order errors, and of the covariance analysis, bytes."""
    if runs == 1:
        return 0.0
    route = (
        NUMBER
        * sizes.epochs
        * (2 * sizes.states**2 + 2 * MAX_MEASUREMENT_SIZE * (sizes.states + max(1, sizes.sources)))
    )
    return route + NUMBER * 13 * sizes.samples + (ANALYSED_MEMORY * sizes.epochs if runs >= LEAST_RUNS else 0.0)


def sums_bytes(sizes: Extent) -> int:
    """Size of the sums over a block of runs at every output of the filter, bytes.

    Three for each group of states; for each state the squared error in sigmas, the number of runs, and the numbers
    beyond two limits.
    """
    return (3 + sizes.sizes()["group"] + 4 * sizes.states) * NUMBER * (sizes.epochs + 1)


def _stored(sizes: Extent, keep: str) -> float:
    """Size of a run in the result file, bytes, by the data kept of it."""

    def of(*names: str) -> int:
        return sum(history_bytes(name, sizes.sizes()) for name in names)

    if keep == "none":
        return 0
    errors = (
        of("error", "sigma", "nees", "nees_position_velocity", "innovation_squared", "aided_squared")
        + of("deviation", "monitor_statistic", "watched_error", "monitor_level", "innovation_ratio")
        + of("station")
        + sizes.epochs
        + sizes.aided
        + sizes.watched
        + 2 * sizes.settled
    )
    if keep == "errors":
        return errors
    # the carrier to noise ratio has the shape of the ranges
    ranges = of("pseudorange", "range_rate", "pseudorange")
    return (
        errors
        + ranges
        + sizes.epochs * sizes.ranged
        + of("fix_llh", "fix_velocity", "aided", "antenna", "gust", "delta_angle", "delta_velocity")
        + of("start_llh", "start_velocity", "start_rpy")
        + of("filter_fix_llh", "filter_fix_velocity", "filter_fix_covariance")
        + NUMBER * sizes.epochs * sizes.clocks
    )


def _common_bytes(scenario: Landing, sizes: Extent) -> float:
    """Size of truth, geometry and messages, which every result of a landing has, bytes."""
    truth = (14 if scenario.wind.blows else 10) * (sizes.samples + 1)
    geometry = sizes.epochs * (16 + 3 * sizes.sources) + SKY_TIMES * (1 + 2 * sizes.sources) + 2 * sizes.sources
    messages = 16 * sizes.sources * (1 + int(scenario.duration_s / 1800.0))
    result = NUMBER * (truth + geometry + messages) + 7000
    if scenario.terrain:  # at how many epochs it hides each source
        result += VARIABLE + NUMBER * sizes.sources
    if sizes.interfering is not None:  # its ratio and its effect on the sources, and which are tracked
        result += sizes.epochs * sizes.sources * (NUMBER * (sizes.interfering + 1) + 1)
    return result


def further(scenario: Landing, sources: SignalScenario) -> int:
    """Sources of error besides `SOURCES` in the covariance analysis of a scenario under a sky."""
    gyro, accel = scenario.imu.triads()
    pseudolites, signals, sensors = scenario.pseudolites, scenario.signals, scenario.aiding()
    errors = pseudolites.errors()
    drawn = [errors.survey, errors.offset, errors.bias, errors.refractivity] if pseudolites.placed() else []
    wander = errors.wanders and bool(pseudolites.placed())
    if len(set(sources.systems) - {PSEUDOLITES, OWN}) > 1:
        drawn.append(signals.system_offset_sigma_ns)
    return (
        len({state.source for state in true_states(gyro, accel)} - set(SOURCES))
        + sum(sigma > 0.0 for sigma in drawn)
        + wander
        + scenario.filter.tight
        + len(signals.errors.models())
        + len(sensors)
        + sum(len({error.name for error in sensor.errors if error.sigma > 0.0}) for sensor in sensors)
    )


def _analysed(scenario: Landing, sources: SignalScenario, sizes: Extent) -> Budget:
    """A covariance analysis."""
    outputs = sizes.epochs + 1
    errors = 1 + len(SOURCES) + further(scenario, sources)  # and the systematic ones
    # those of the budget, the mean, the root mean square of all, the filter sigma, and error over that
    of_states = (errors + 4) * sizes.states
    result = _common_bytes(scenario, sizes) + NUMBER * outputs * (8 + of_states) + 110 * VARIABLE
    return Budget(
        shared_memory(sizes) + ANALYSED_MEMORY * (outputs + 2.0 * (sizes.aided + sizes.ahead)) + WRITING * result,
        result,
    )


def _pushed(scenario: Landing, sizes: Extent, runs: int, workers: int, remote: bool) -> Budget:
    """Runs that are pushed to the edge of a box."""
    workers = max(1, min(workers, -(-runs // BATCH)))
    inputs = NUMBER * ((6 + sizes.deviating) * sizes.samples + 3 * sizes.epochs * sizes.sources + sizes.aided)
    # each worker's inputs are there before and after the push, slopes and shifts of three errors once
    pushes = inputs * (3 * WIDTH * workers + 6)
    flying = 2 * TASK_BYTES if remote else workers * flying_memory(scenario, sizes) + pushes
    numbers = (NUMBER * PUSHED + STATISTICS) * runs
    batches = -(-runs // BATCH)
    return Budget(
        shared_memory(sizes) + ANALYSED_MEMORY * sizes.epochs + flying
        + 3 * STATISTICS * runs + WRITING * numbers,
        numbers + 24 * VARIABLE,
        runs * STATISTICS + batches * BATCH_FILE if runs > BATCH else 0.0,
    )  # fmt: skip
