"""Filter and its model: section `filter`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from navsim.scenario.aiding_sensors import FilterBarometricAltimeter, FilterMagnetometer, FilterRadioAltimeter
from navsim.scenario.beacons import FilterBeacons
from navsim.scenario.ground_stations import FilterAzimuthStation, FilterDme, FilterElevationStation
from navsim.scenario.imu import Accelerometer, Gyro
from navsim.scenario.pseudolites import FilterPseudolites
from navsim.scenario.signals import ClockNoise
from navsim.scenario_files.base import (
    FixLatency,
    Section,
    Sigma,
    Triple,
)


class FilterInitial(Section):
    """1 sigma the filter starts from; omitted keys: those of initial_errors."""

    attitude_deg: Sigma | None = None
    """1 sigma of attitude about each axis"""
    position_m: Sigma | None = None
    """1 sigma of position along each axis"""
    velocity_m_s: Sigma | None = None
    """1 sigma of velocity along each axis"""


class FilterSensors(Section):
    """Sensor errors in the filter model; an omitted sensor is as in `imu`."""

    gyro: Gyro | None = None
    """errors of the gyros in the filter model"""
    accelerometer: Accelerometer | None = None
    """errors of the accelerometers in the filter model"""


class Gate(Section):
    """Rejection of fixes that cannot be true."""

    probability: Annotated[float, Field(ge=0.0, lt=0.5)] = 1e-6
    """chance of rejecting a good fix; 0: no gate"""
    max_rejected: Annotated[int, Field(ge=0, le=1_000_000)] = 10
    """rejections in a row after which a fix, or a source's range, is taken nevertheless"""


class Components(Section):
    """Components of `kind: gaussian-sum`."""

    components: Annotated[int, Field(ge=3, le=99)] = 32
    """most components at once; straight flight leaves three eighths of the room to turns. A run's time grows with those
    it has"""
    split_heading_sigma_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 5.0
    """1 sigma of heading above which a component is divided; in turns down to half of it"""


Kind = Literal[
    "gaussian-sum", "tfg", "eskf", "first-estimates", "observability-constrained", "left-invariant", "rts", "map"
]
Coupling = Literal["loose", "tight"]
"""Coupling of filter and satellite receiver."""
SUM = "gaussian-sum"
"""The kind that is a sum of components."""
SMOOTHERS = ("rts", "map")
"""Kinds whose outputs know the fixes that come after them."""


class FilterSection(Section):
    """Filter and its model; omitted keys follow from the truth."""

    kind: Kind = "gaussian-sum"
    """gaussian-sum: several tfg filters side by side while heading is uncertain; tfg: two-frames group; eskf:
    error-state. For comparison, first-estimates and observability-constrained: eskf with constrained linearisation
    points; left-invariant: SE2(3). All have exact covariance reset. Smoothers, which use all fixes for each output:
    rts with one backward pass, map iterated to the maximum a posteriori"""
    coupling: Coupling = "loose"
    """loose: the receiver's fixes are measurements; tight: pseudoranges and range rates of each source are, with the
    receiver's clock as states, and the filter also uses fewer sources than a fix needs"""
    clock: ClockNoise | None = None
    """noise of the receiver clock in the model of a tightly coupled filter; omitted: that of receiver.clock"""
    velocity: bool = True
    """use the velocity of the fixes as well as their position, or the range rates as well as the pseudoranges"""
    latency_s: FixLatency | None = None
    """latency of the fixes in the filter model; default: receiver.latency_s"""
    lever_arm_m: Triple | None = None
    """lever arm in the filter model; default: receiver.lever_arm_m"""
    fix_errors: Literal["states", "inflate", "none"] | None = None
    """how the filter handles time-correlated errors (`signals.errors`, drawn errors of pseudolites). With states it
    estimates them: six for each group of kinds, or with `coupling: tight` those of each satellite; position and clock
    of each pseudolite. With inflate it increases the assumed noise. With none it treats them as white noise. Omitted:
    inflate if a tightly coupled filter is monitored (`integrity.method: filter`), else states. The filter treats
    reflections (`pseudolites.multipath`) as noise of their size and correlation time; with none it does not know
    them"""
    fix_sigma_scale: Sigma = 1.0
    """factor on the receiver's own 1 sigma, of its fixes or of its ranges"""
    fix_flag: Literal["believe", "ignore", "fixed-only"] = "believe"
    """how the filter takes the flag of a fix (`receiver.fix_states`). With believe it assumes the RMS error of the
    flagged state. With ignore it assumes that of all states together, wrong ones included. With fixed-only it uses
    only fixes that are flagged as fixed"""
    initial: FilterInitial = FilterInitial()
    """1 sigma the filter starts from; omitted keys: those of initial_errors"""
    pseudolites: FilterPseudolites = FilterPseudolites()
    """errors of pseudolites that the filter assumes; omitted keys: those of `pseudolites`"""
    imu: FilterSensors = FilterSensors()
    """sensor errors that the filter assumes; omitted keys: those of `imu`"""
    radio_altimeter: FilterRadioAltimeter = FilterRadioAltimeter()
    """radio altimeter that the filter assumes; omitted keys: those of `radio_altimeter`"""
    barometric_altimeter: FilterBarometricAltimeter = FilterBarometricAltimeter()
    """barometric altimeter that the filter assumes; omitted keys: those of `barometric_altimeter`"""
    magnetometer: FilterMagnetometer = FilterMagnetometer()
    """magnetometer that the filter assumes; omitted keys: those of `magnetometer`"""
    beacons: FilterBeacons = FilterBeacons()
    """beacons that the filter assumes; omitted keys: those of `beacons`"""
    azimuth_station: FilterAzimuthStation = FilterAzimuthStation()
    """azimuth station that the filter assumes; omitted keys: those of `azimuth_station`"""
    elevation_station: FilterElevationStation = FilterElevationStation()
    """elevation station that the filter assumes; omitted keys: those of `elevation_station`"""
    dme: FilterDme = FilterDme()
    """DME that the filter assumes; omitted keys: those of `dme`"""
    scale_factors: bool | None = None
    """estimate the scale factors of gyros and accelerometers, three more states each if they have some; their initial 1
    sigma is that of imu. Omitted: of each sensor whose scale factors are large for this flight"""
    misalignments: bool | None = None
    """estimate the cross-axis gains of gyros and accelerometers, six more states each if they have some; their initial
    1 sigma is that of imu. Omitted: of each sensor whose misalignments are large for this flight"""
    steady_force: bool = True
    """in steady flight, couple attitude errors to velocity errors by the steady part of the specific force alone, so
    that the accelerometers' noise does not look like information about heading; false: by the measured force"""
    gate: Gate = Gate()
    """rejection of fixes, or of ranges, that cannot be true"""
    sigma_tolerance: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.05
    """share by which the RMS of a state's error may differ from the filter's sigma before the verdict on consistency,
    and `--require-consistent`, object to it; larger differences still have to be more than chance"""
    gaussian_sum: Components = Components()
    """the components of `kind: gaussian-sum`"""

    @property
    def tight(self) -> bool:
        """Whether it is tightly coupled."""
        return self.coupling == "tight"

    def states(self, scales: int, others: int) -> int:
        """Number of states for so many time scales of the sources and so many states besides navigation and biases."""
        from navsim.filter import states

        clock = states.clock_states(scales) if self.tight else 0
        return len(states.names(states.biases())) + others + clock
