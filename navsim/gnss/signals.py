"""Simulator of satellite and pseudolite signals: sources and signal quality along a motion.

Source: `docs/theory/signals.md`; the effects are those of `gnss.signal_errors`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from navsim.defect import Defect
from navsim.geodesy.earth import RATE as EARTH_RATE
from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss import atmosphere, dll, pseudorange, timescales
from navsim.gnss.antenna import AircraftAntenna, GroundPattern
from navsim.gnss.constellations.constellation import Constellation, carriers
from navsim.gnss.constellations.systems import CLOCKS, GPS, OWN
from navsim.gnss.correction_link import CorrectionMessages, LossesByRun
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.events import PSEUDOLITES, Event, Scene, happened
from navsim.gnss.interference import propagation as interference
from navsim.gnss.interference.horizon import Terrain, behind, horizon_dip, horizon_distance
from navsim.gnss.interference.jamming import TEMPERATURE, Jamming, Received
from navsim.gnss.pseudolite_clock import TransmitterErrors, Transmitters, WanderingClocks
from navsim.gnss.signal_errors import NO_EFFECTS, Effects, directions_from, orbit_clock_sensitivity, propagation
from navsim.gnss.sky import Mask, azimuth_elevation, enu_matrix, unit_vector
from navsim.trajectory.kinematics import Motion

_LISTED_RANGE = 20_000e3
"""Distance given to sources listed by direction, m."""


@dataclass(frozen=True)
class Satellites:
    """A constellation of n satellites, their names, time scales (n,) int, and which of them to use (n,) bool."""

    constellation: Constellation
    names: tuple[str, ...]
    time_scale: np.ndarray
    chosen: np.ndarray


@dataclass(frozen=True)
class FixedDirectionSources:
    """Sources in fixed directions: azimuth, elevation (s,) rad, time scale (s,) int, chosen (s,) bool."""

    names: tuple[str, ...]
    azimuth: np.ndarray
    elevation: np.ndarray
    time_scale: np.ndarray
    chosen: np.ndarray


def time_scales(satellites: Sequence[Satellites], listed: FixedDirectionSources | None) -> set[str]:
    """The time scales that chosen sources in the sky keep."""
    groups: list[Satellites | FixedDirectionSources] = [*satellites, *([] if listed is None else [listed])]
    return {CLOCKS[number] for group in groups for number in group.time_scale[group.chosen]}


@dataclass(frozen=True)
class Radiated:
    """Transmitted power of pseudolites."""

    eirp: float
    """dBW."""
    pattern: GroundPattern | None
    """None: isotropic."""


@dataclass(frozen=True)
class Pseudolites:
    """Pseudolites, p of them."""

    names: tuple[str, ...]
    llh: np.ndarray
    """(p, 3) surveyed, rad, rad, m."""
    survey_error: np.ndarray
    """(3,) NED, true minus surveyed, m."""
    time_scale: int
    """Number of their time scale."""
    delay: float
    """Effect of their clock offset on the pseudorange, m."""
    sigma: float
    """1 sigma of pseudoranges, m."""
    rate_sigma: float
    """1 sigma of range rates, m/s."""
    cn0: float
    """dB-Hz."""
    carrier: float
    """Hz."""
    radiated: Radiated | None = None
    """Transmitted power from which C/N0 follows; None: constant `cn0`."""
    errors: TransmitterErrors = field(default_factory=TransmitterErrors)
    """Sizes of the errors that are drawn for each run."""

    @property
    def calibration_sigma(self) -> float:
        """1 sigma of a range due to drawn errors of position, clock and calibration, m."""
        return math.hypot(self.errors.survey, self.errors.offset, self.errors.bias)


@dataclass(frozen=True)
class ErrorLaw:
    """Ranging errors of satellites, see `pseudorange.sigma_of_elevation`; rate_sigma m/s, cn0 dB-Hz."""

    law: str
    zenith: float
    scale: float
    rate_sigma: float
    cn0: float


@dataclass(frozen=True)
class SignalScenario:
    """All sources of signals, their errors, obstacles, events and jammers, and the receiving antenna."""

    satellites: tuple[Satellites, ...]
    listed: FixedDirectionSources | None
    mask: Mask
    pseudolites: Pseudolites
    law: ErrorLaw
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m."""
    effects: Effects = NO_EFFECTS
    events: tuple[Event, ...] = ()
    jamming: Jamming | None = None
    antenna: AircraftAntenna | None = None
    """Antenna of the aircraft, if a table gives one."""
    terrain: Terrain = field(default_factory=Terrain)
    """What hides sources."""
    ground: float = 0.0
    """Height above the ellipsoid of the smooth Earth that hides sources, m."""

    @property
    def depends_on_pseudolite_sites(self) -> bool:
        """Whether other signals, or the quality of a visible pseudolite's signal, depend on the positions of
        pseudolites."""
        own = self.strength_placed or self.smoothing_placed or self.air_placed
        return self.effects.depends_on_pseudolite_sites or own

    @property
    def sight_placed(self) -> bool:
        """Whether the quality of a visible pseudolite's signal depends on its position."""
        return bool(self.terrain)

    @property
    def air_placed(self) -> bool:
        """Whether drawn errors of its ranges depend on its position."""
        return self.effects.ground_air is not None and self.pseudolites.errors.refractivity > 0.0

    @property
    def smoothing_placed(self) -> bool:
        """Whether the carrier smoothing of its ranges depends on its position."""
        return self.sight_placed and self.effects.smoothing > 0.0

    @property
    def strength_keys(self) -> list[str]:
        """Keys of the scenario by which it matters how strong pseudolites are, and so how far and in which
        direction."""
        masked = self.antenna is not None and self.antenna.mask > -0.5 * np.pi
        differing = {
            "pseudolites.cn0_reference_m": self.effects.cn0_reference is not None,
            "pseudolites.eirp_dbm": self.pseudolites.radiated is not None,
            "pseudolites.multipath": self.effects.reflection is not None,
        }
        using = {"interference": self.jamming is not None, "range_law: cn0": self.effects.thermal_pseudolites}
        matter = any(differing.values()) and any(using.values())
        given = {"receiver.antenna.mask_deg": masked} | (differing | using if matter else {})
        return [key for key, value in given.items() if value]

    @property
    def strength_placed(self) -> bool:
        """Whether it matters how strong pseudolites are."""
        return bool(self.strength_keys)

    @property
    def by_directions(self) -> SignalScenario:
        """The environment with all dependence on pseudolite positions removed, except for directions."""
        station = self.effects.reference
        station = None if station is None else replace(station, link=None)
        effects = replace(self.effects, thermal_pseudolites=False, reference=station)
        return replace(self, jamming=None, antenna=None, effects=effects)

    def in_view(self, azimuth: np.ndarray, elevation: np.ndarray, antenna: np.ndarray) -> np.ndarray:
        """Which directions (e, s), rad, satellites are received from: those that the mask lets pass, above the horizon
        of an antenna (e, 3), ECEF, m."""
        return self.mask.passes(azimuth, elevation) & (elevation >= self.horizon_of(antenna)[:, None])

    def horizon_of(self, antenna: np.ndarray) -> np.ndarray:
        """Elevation (e,), rad, of the horizon of an antenna (e, 3), ECEF, m."""
        return -horizon_dip(llh_from_ecef(antenna)[:, 2] - self.ground)

    def beyond_horizon(self, antenna: np.ndarray) -> np.ndarray:
        """Which pseudolites (e, p) bool are beyond the radio horizon of an antenna (e, 3), ECEF, m."""
        away = np.linalg.norm(ecef_from_llh(self.pseudolites.llh) - antenna[:, None], axis=2)
        here = horizon_distance(llh_from_ecef(antenna)[:, 2] - self.ground)
        there = horizon_distance(self.pseudolites.llh[:, 2] - self.ground)
        return np.asarray(away > here[:, None] + there)

    def behind_terrain(self, antenna: np.ndarray) -> np.ndarray:
        """Which pseudolites (e, p) bool terrain hides from an antenna (e, 3), ECEF, m."""
        there = ecef_from_llh(self.pseudolites.llh)[None]
        return behind(self.terrain, there, antenna)

    def shadowed(self, signals: pseudorange.Signals, c_eb: np.ndarray) -> np.ndarray:
        """Sources (e, s) bool that the aircraft hides: used satellites above the mask, and pseudolites.

        c_eb: (e, 3, 3) body axes in ECEF.
        """
        if self.antenna is None:
            return np.zeros(signals.used.shape, bool)
        away = signals.position - signals.antenna[:, None]
        with np.errstate(invalid="ignore"):  # satellites without a message at the time
            towards = away / np.linalg.norm(away, axis=2, keepdims=True)
            out: np.ndarray = self.antenna.elevation_of(c_eb, towards) < self.antenna.mask
        chosen = [group.chosen for group in self.satellites] + ([] if self.listed is None else [self.listed.chosen])
        satellites = slice(0, sum(map(len, chosen)))
        passed = self.in_view(signals.azimuth, signals.elevation, signals.antenna)[:, satellites]
        out[:, satellites] &= passed & np.concatenate([*chosen, np.empty(0, bool)])
        return out

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sources (s,): satellites, listed ones, pseudolites."""
        listed = () if self.listed is None else self.listed.names
        return (*(name for group in self.satellites for name in group.names), *listed, *self.pseudolites.names)

    @property
    def systems(self) -> tuple[str, ...]:
        """System of each source (s,) by name: satellite system, clock of a listed direction, or `PSEUDOLITES`."""
        of_satellites = [group.constellation.system.name for group in self.satellites for _ in group.names]
        of_listed = [] if self.listed is None else [CLOCKS[clock] for clock in self.listed.time_scale]
        return (*of_satellites, *of_listed, *(PSEUDOLITES for _ in self.pseudolites.names))

    @property
    def chips(self) -> np.ndarray:
        """Chip length of each source (s,), m; sources that are not satellites have GPS chips."""
        of_satellites = [dll.chip_length(g.constellation.system) for g in self.satellites for _ in g.names]
        out = np.full(len(self.systems), dll.chip_length(GPS))
        out[: len(of_satellites)] = of_satellites
        return out

    @property
    def carriers(self) -> np.ndarray:
        """Carrier of each source (s,), Hz; that of GPS in listed directions."""
        listed = 0 if self.listed is None else len(self.listed.names)
        return np.concatenate([
            *(carriers(group.constellation) for group in self.satellites),
            np.full(listed, GPS.carrier), np.full(len(self.pseudolites.names), self.pseudolites.carrier),
        ])  # fmt: skip

    def systems_of(self, names: Sequence[str]) -> tuple[str, ...]:
        """Systems of sources by their names; those that are none of the environment's are pseudolites placed later."""
        known = dict(zip(self.names, self.systems, strict=True))
        return tuple(known.get(name, PSEUDOLITES) for name in names)

    @property
    def scale_offsets(self) -> np.ndarray:
        """Offset of each time scale in the pseudoranges of its sources (MAX_CLOCKS,), m.

        Zero if the receiver treats all as one: each source's offset is then an error.
        """
        if self.effects.single_clock:
            return np.zeros(len(CLOCKS))
        own = self.pseudolites.delay if CLOCKS[self.pseudolites.time_scale] == OWN else 0.0
        return np.array(self.effects.offsets) + np.where(np.array(CLOCKS) == OWN, own, 0.0)

    @property
    def singled_out(self) -> bool:
        """Whether something happens to one pseudolite and not to another."""
        return any(set(event.sources) & set(self.pseudolites.names) for event in self.events)


def find_lone_pseudolite(signals: pseudorange.Signals, pseudolites: int) -> np.ndarray:
    """Fixes (e,) bool at which a pseudolite is the only received source of its time scale, beside sources of another.

    Its range then determines its clock unknown and nothing else. The pseudolites are the last so many sources.
    """
    if not pseudolites:
        return np.zeros(len(signals.used), bool)
    same = signals.used[:, signals.time_scale == signals.time_scale[-1]].sum(axis=1)
    ground = signals.used[:, -pseudolites:].sum(axis=1)
    return np.asarray((same == 1) & (ground == 1) & (signals.used.sum(axis=1) > 1))


def antenna_ecef(motion: Motion, lever_arm: np.ndarray) -> np.ndarray:
    """Position of the antenna along a motion, m (n, 3); lever_arm (3,) IMU to antenna, body, m."""
    arm = np.einsum("nij,j->ni", motion.c_nb, lever_arm)
    return motion.position_ecef + np.einsum("nji,nj->ni", motion.c_ne, arm)


def antenna_motion(motion: Motion, lever_arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the antenna along a motion, ECEF (n, 3), m, m/s; lever_arm as of `antenna_ecef`."""
    c_ne = motion.c_ne
    # the antenna swings around the IMU as the body turns against the Earth
    about = [motion.c_nb[:, j] * c_ne[:, j, 2:] * EARTH_RATE for j in range(3)]
    earth_rate_b = about[0] + about[1] + about[2]
    swing = np.einsum("nij,nj->ni", motion.c_nb, np.cross(motion.angular_rate - earth_rate_b, lever_arm))
    return antenna_ecef(motion, lever_arm), motion.velocity_ecef + np.einsum("nji,nj->ni", c_ne, swing)


def true_positions(environment: SignalScenario, position: np.ndarray) -> np.ndarray:
    """True positions of sources (e, s, 3), ECEF, m, from those in the receiver's data, pseudolites last."""
    out, pseudolites = position.copy(), environment.pseudolites
    for i, llh in enumerate(pseudolites.llh):
        out[:, position.shape[1] - len(pseudolites.names) + i] += ned_matrix(llh).T @ pseudolites.survey_error
    return out


def build_signals(motion: Motion, utc: float, environment: SignalScenario) -> pseudorange.Signals:
    """All sources at the times of `motion`, s after `utc` (POSIX s), seen from the antenna; see
    `pseudorange.Signals`."""
    e = motion.time.size
    when = timescales.gps_from_utc(utc) + motion.time
    listed, pseudolites, law = environment.listed, environment.pseudolites, environment.law
    c_ne = ned_matrix(motion.llh)
    antenna, antenna_velocity = antenna_motion(motion, environment.lever_arm)
    c_ue = enu_matrix(motion.llh)

    names: list[str] = []
    clocks: list[int] = []
    chosen: list[bool] = []
    # of each source (e, 3): assumed position, velocity, true position
    position: list[np.ndarray] = []
    velocity: list[np.ndarray] = []
    true_position: list[np.ndarray] = []

    def add(name: str, clock: int, use: bool, assumed: np.ndarray, moving: np.ndarray, there: np.ndarray) -> None:
        names.append(name)
        clocks.append(clock)
        chosen.append(use)
        position.append(assumed)
        velocity.append(moving)
        true_position.append(there)

    for group in environment.satellites:
        p, v = pseudorange.satellites_at_reception(group.constellation, when, antenna)
        v = pseudorange.apparent_velocity(p, v, antenna, antenna_velocity)
        for i, name in enumerate(group.names):
            add(name, int(group.time_scale[i]), bool(group.chosen[i]), p[:, i], v[:, i], p[:, i])
    if listed is not None:
        for i, name in enumerate(listed.names):
            direction = np.einsum("nji,j->ni", c_ue, unit_vector(listed.azimuth[i], listed.elevation[i]))
            p = antenna + _LISTED_RANGE * direction
            # the source keeps its direction: it moves along, without range rate
            add(name, int(listed.time_scale[i]), bool(listed.chosen[i]), p, antenna_velocity, p)
    for i, name in enumerate(pseudolites.names):
        surveyed = ecef_from_llh(pseudolites.llh[i])
        true = surveyed + ned_matrix(pseudolites.llh[i]).T @ pseudolites.survey_error
        still = np.zeros((e, 3))
        add(name, pseudolites.time_scale, True, still + surveyed, still, still + true)

    s = len(names)
    assumed = np.stack(position, axis=1) if s else np.empty((e, 0, 3))
    speed = np.stack(velocity, axis=1) if s else np.empty((e, 0, 3))
    true = np.stack(true_position, axis=1) if s else np.empty((e, 0, 3))
    is_pseudolite = np.arange(s) >= s - len(pseudolites.names)

    offset = true - antenna[:, None]
    distance = np.linalg.norm(offset, axis=2)
    rate = np.sum(offset * (speed - antenna_velocity[:, None]), axis=2) / distance
    offset = assumed - antenna[:, None]
    los = np.einsum("nij,nsj->nsi", c_ue, offset / np.linalg.norm(offset, axis=2, keepdims=True))
    azimuth, elevation = azimuth_elevation(los)
    used = np.array(chosen, dtype=bool) & (is_pseudolite | environment.in_view(azimuth, elevation, antenna))
    used[:, is_pseudolite] &= ~environment.beyond_horizon(antenna)
    used &= np.isfinite(distance)  # a satellite without a message at the time
    los[~used] = np.nan
    sigma = pseudorange.sigma_of_elevation(law.law, law.zenith, elevation, law.scale)
    built = pseudorange.Signals(
        time=motion.time,
        antenna=antenna,
        antenna_velocity=antenna_velocity,
        names=tuple(names),
        time_scale=np.array(clocks, dtype=np.int64),
        used=used,
        position=assumed,
        velocity=speed,
        range=distance,
        range_rate=rate,
        range_bias=np.broadcast_to(np.where(is_pseudolite, pseudolites.delay, 0.0), (e, s)).copy(),
        sigma=np.where(is_pseudolite, pseudolites.sigma, sigma),
        rate_sigma=np.broadcast_to(np.where(is_pseudolite, pseudolites.rate_sigma, law.rate_sigma), (e, s)).copy(),
        los=los,
        azimuth=azimuth,
        elevation=elevation,
        cn0=np.where(used, np.where(is_pseudolite, pseudolites.cn0, law.cn0), np.nan),
        divergence=np.zeros((e, s)),
        source_errors=None,
        correlated=None,
        fix_sigma=np.empty((e, s)),
        fix_rate_sigma=np.empty((e, s)),
        smoothing=None,
        js=np.empty((0, e, s)),
    )
    if environment.antenna is not None:
        with np.errstate(invalid="ignore"):  # satellites without a message at the time
            over = environment.antenna.elevation_of(motion.c_eb, offset / np.linalg.norm(offset, axis=2, keepdims=True))
            used &= over >= environment.antenna.mask
    if environment.terrain:
        used &= ~behind(environment.terrain, assumed, antenna)
    if environment.events:
        scene = Scene(motion.time, built.names, environment.systems, assumed, speed, antenna, antenna_velocity, c_ne)
        effects = happened(environment.events, scene)
        built = replace(
            built, used=used & ~effects.silent, range_bias=built.range_bias + effects.longer,
            range_rate=built.range_rate + effects.faster, divergence=effects.apart,
        )  # fmt: skip
    finished = _affected(built, when, motion, environment, is_pseudolite)
    unfinished = finished.unfinished()
    if unfinished:
        raise UndefinedSignal("; ".join(f"the {field} of {name}" for name, field in unfinished))
    return finished


class UndefinedSignal(Defect):
    """A model gives no number for a signal that is received; the message names signals and quantities."""


def _affected(
    signals: pseudorange.Signals, when: np.ndarray, motion: Motion, environment: SignalScenario,
    is_pseudolite: np.ndarray,
) -> pseudorange.Signals:  # fmt: skip
    """The signals with all effects of the environment; when: (e,) GPS s, motion: of the receiver, is_pseudolite:
    (s,)."""
    effects, pseudolites, llh = environment.effects, environment.pseudolites, motion.llh
    e, s = signals.range.shape
    sky = ~is_pseudolite
    used, los = signals.used.copy(), signals.los.copy()
    delay, cn0, sigma = signals.range_bias.copy(), signals.cn0.copy(), signals.sigma.copy()
    chip, ratio2 = environment.chips, (atmosphere.L1 / environment.carriers) ** 2
    air, ionosphere = propagation(effects, when, llh, signals.azimuth, signals.elevation, ratio2)
    delay += np.where(sky, air, 0.0) + np.array(effects.offsets)[signals.time_scale]
    ionosphere = np.where(sky, ionosphere, 0.0)
    away = signals.position - signals.antenna[:, None]
    distance = np.linalg.norm(away, axis=2)
    path_air = None
    if effects.ground_air is not None:
        path_air, heights = np.zeros((e, s)), pseudolites.llh[:, 2]
        path_air[:, is_pseudolite] = effects.ground_air.unit_delay(llh[:, 2:], heights, distance[:, is_pseudolite])
        delay[:, is_pseudolite] += effects.ground_air.residual * path_air[:, is_pseudolite]
    space = None
    if effects.signal_in_space is not None:
        space = np.zeros((e, s, 4))
        unit = away[:, sky] / distance[:, sky, None]
        space[:, sky] = orbit_clock_sensitivity(
            effects.signal_in_space, unit, signals.position[:, sky], signals.velocity[:, sky]
        )
    age, station_noise, losses = None, np.zeros((e, 1)), None
    if (station := effects.reference) is not None:
        # corrections of a reference station remove its own errors, at its position and some time ago
        messages, lost = _messages(signals, when, motion, environment, is_pseudolite)
        age = np.full(e, station.latency) if messages is None else messages.ages(signals.time, lost)
        there_are = np.isfinite(age)[:, None]
        earlier = when - np.where(there_are[:, 0], age, 0.0)
        station_noise = np.where(there_are, station.noise, 0.0)
        rows = np.arange(e)
        there, part, of_station, known = _corrections(signals, environment, earlier, rows, ratio2, is_pseudolite)
        # the station does not track it, or has no data: no correction, no use
        used &= ~there_are | known
        delay -= np.where(there_are, there, 0.0)
        ionosphere -= np.where(there_are, part, 0.0)
        if space is not None and of_station is not None:
            space -= np.where(there_are[..., None], of_station, 0.0)
        if messages is not None and station.link is not None and station.link.loss > 0.0 and e:
            gpst = when[0] + (messages.numbers * messages.interval - signals.time[0])
            rows = np.clip(np.searchsorted(signals.time, messages.numbers * messages.interval), 0, e - 1)
            there, part, of_station, known = _corrections(signals, environment, gpst, rows, ratio2, is_pseudolite)
            losses = LossesByRun(
                station.link.loss, messages, messages.in_use(lost), np.where(known, there, np.nan), part,
                None if space is None else of_station, np.where(sky, station.noise, 0.0),
            )  # fmt: skip
        sigma = np.where(sky, np.hypot(sigma, station_noise), sigma)
    if pseudolites.calibration_sigma > 0.0 and is_pseudolite.any():
        own = _calibrations(pseudolites, away[:, is_pseudolite] / distance[:, is_pseudolite, None])
        of_sky, space = space, np.zeros((e, s, own.shape[2]))
        if of_sky is not None:
            space[:, :, : of_sky.shape[2]] = of_sky
        space[:, is_pseudolite] = own
    los[~used], cn0[~used] = np.nan, np.nan
    # carrier to noise by antenna and distance, then the noise that the code loop has of it
    to_sky, to_ground = _gains(environment, motion.c_eb, away / distance[..., None], signals.elevation)
    cn0 += np.where(sky, to_sky, 0.0)
    if pseudolites.radiated is not None:
        strength = _by_link(pseudolites, effects, signals.antenna, distance[:, is_pseudolite])
        cn0[:, is_pseudolite] = np.where(used[:, is_pseudolite], strength + to_ground[:, is_pseudolite], np.nan)
    if effects.cn0_reference is not None:
        cn0 += np.where(is_pseudolite, 20.0 * np.log10(effects.cn0_reference / distance), 0.0)
    reflections = None
    if effects.reflection is not None:
        mean, size, time = np.zeros((e, s)), np.zeros((e, s)), np.full((e, s), np.inf)
        # the ray by the runway's plane, per pseudolite
        for i in np.flatnonzero(is_pseudolite):
            transmitter = pseudolites.llh[i - (s - len(pseudolites.names))]
            above, own = llh[:, 2] - effects.reflection.height, transmitter[2] - effects.reflection.height
            across = np.sqrt(np.maximum(distance[:, i] ** 2 - (above - own) ** 2, 1.0))
            ray = dll.reflection(effects.reflection, pseudolites.carrier, above, float(own), across)
            delay[:, i] += dll.multipath_error(effects.loop.spacing, float(chip[i]), *ray)
            mean[:, i], size[:, i] = dll.over_phases(effects.loop.spacing, float(chip[i]), *ray[:2])
            if e > 1:
                turns = np.abs(np.gradient(ray[1], signals.time)) * pseudolites.carrier / SPEED_OF_LIGHT
                time[:, i] = 1.0 / np.maximum(2.0 * np.pi * turns, 1e-9)
            cn0[:, i] += dll.fade(ray[0], ray[2])
        reflections = dll.ReflectionErrors(mean, size, time)
    if effects.thermal:
        thermal = effects.loop.sigma(cn0, chip)
        sigma = np.where(sky, np.hypot(thermal, station_noise), sigma)
    if effects.thermal_pseudolites:
        sigma = np.where(sky, sigma, effects.loop.sigma(cn0, chip))
    rate_sigma, js, jamming = signals.rate_sigma, signals.js, environment.jamming
    if jamming is not None:
        carrier = atmosphere.L1 / np.sqrt(ratio2)
        received = Received(signals.time, signals.antenna, llh, used, cn0, chip, carrier, is_pseudolite, motion.c_eb)
        js = jamming.js(received)
        effective, held = jamming.effective_cn0(received, js)
        more, faster = jamming.noise(received, effective)
        sigma = np.where(used, np.sqrt(sigma**2 + more), sigma)
        rate_sigma = np.where(used, np.sqrt(rate_sigma**2 + faster), rate_sigma)
        used = used & held
        los[~used], cn0 = np.nan, np.where(used, effective, np.nan)
    fix_sigma, smoothing = fixed_with(effects, signals.time, sigma, used)
    fix_sigma = np.where(sky, fix_sigma, np.hypot(fix_sigma, pseudolites.calibration_sigma))
    if path_air is not None and pseudolites.errors.refractivity:
        fix_sigma = np.hypot(fix_sigma, pseudolites.errors.refractivity * path_air)
    wandering, fix_rate_sigma = None, rate_sigma
    if pseudolites.errors.wanders and is_pseudolite.any():
        wandering = WanderingClocks(pseudolites.errors, is_pseudolite)
        of_ranges, of_rates = wandering.sigmas(signals.time)
        fix_sigma, fix_rate_sigma = np.hypot(fix_sigma, of_ranges), np.hypot(rate_sigma, of_rates)
    correlated = None
    if effects.correlated:
        each = [one.at(signals.elevation, environment.systems) for one in effects.correlated]
        sizes = np.stack([np.where(sky & used, size, 0.0) for size in each])
        correlated = CorrelatedErrors(
            tuple(one.name for one in effects.correlated), np.array([one.time for one in effects.correlated]), sizes
        )
        # a receiver weights ranges by all their known errors
        fix_sigma = np.hypot(fix_sigma, correlated.total)
    return replace(
        signals,
        time_scale=clock_unknowns(effects, signals.time_scale),
        used=used,
        los=los,
        range_bias=delay,
        cn0=cn0,
        sigma=sigma,
        rate_sigma=rate_sigma,
        js=js,
        # the ionosphere delays the code as much as it advances the carrier
        divergence=2.0 * ionosphere + signals.divergence,
        source_errors=space,
        correlated=correlated,
        reflections=reflections,
        fix_sigma=fix_sigma,
        fix_rate_sigma=fix_rate_sigma,
        smoothing=smoothing,
        offset=_drawn_offsets(environment, signals.time_scale),
        air=path_air,
        wandering=wandering,
        transmitters=None if not is_pseudolite.any() else Transmitters(
            is_pseudolite, pseudolites.errors, pseudolites.survey_error, pseudolites.delay,
            0.0 if effects.ground_air is None else effects.ground_air.residual,
        ),
        correction_age=age,
        losses=losses,
    )  # fmt: skip


def _messages(
    signals: pseudorange.Signals, when: np.ndarray, motion: Motion, environment: SignalScenario,
    is_pseudolite: np.ndarray,
) -> tuple[CorrectionMessages | None, np.ndarray]:  # fmt: skip
    """Messages of the station's link, None without one, and which of them the nominal flight loses; arguments as of
    `_affected`.

    Whether their senders are received does not depend on corrections for satellites.
    """
    station = environment.effects.reference
    assert station is not None
    if station.link is None:
        return None, np.empty(0, bool)
    without = replace(environment, effects=replace(environment.effects, reference=None))
    senders = is_pseudolite & np.isin(signals.names, station.link.senders)
    received = np.any(_affected(signals, when, motion, without, is_pseudolite).used[:, senders], axis=1)
    messages = station.link.messages(signals.time, received, station.latency)
    return messages, station.link.lost_on_route(messages)


def _corrections(
    signals: pseudorange.Signals, environment: SignalScenario, gpst: np.ndarray, rows: np.ndarray, ratio2: np.ndarray,
    is_pseudolite: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:  # fmt: skip
    """What a station measures at times (m,), GPS s, rows (m,) of epochs.

    Returns the delay of each source (m, s), m; the ionosphere in it (m, s), m; the effect (m, s, 4) of drawn errors,
    None without; and whether the source has a correction (m, s).
    Sources in fixed directions, and their errors, are the same for station and receiver.
    """
    effects = environment.effects
    assert effects.reference is not None
    llh = effects.reference.llh
    delay, ionosphere = np.zeros((gpst.size, len(signals.names))), np.zeros((gpst.size, len(signals.names)))
    known, first = np.ones(delay.shape, bool), 0
    space = None if effects.signal_in_space is None else np.zeros((*delay.shape, 4))
    place = np.broadcast_to(llh, (gpst.size, 3))
    for group in environment.satellites:
        here = slice(first, first + len(group.names))
        first = here.stop
        unit, azimuth, elevation = directions_from(group.constellation, gpst, llh)
        delay[:, here], ionosphere[:, here] = propagation(effects, gpst, place, azimuth, elevation, ratio2[here])
        known[:, here] = np.isfinite(delay[:, here]) & np.isfinite(elevation)
        if space is not None and effects.signal_in_space is not None:
            position, velocity = signals.position[rows][:, here], signals.velocity[rows][:, here]
            space[:, here] = orbit_clock_sensitivity(effects.signal_in_space, unit, position, velocity)
    if environment.listed is not None:
        here = slice(first, first + len(environment.listed.names))
        azimuth, elevation = signals.azimuth[rows][:, here], signals.elevation[rows][:, here]
        delay[:, here], ionosphere[:, here] = propagation(effects, gpst, place, azimuth, elevation, ratio2[here])
        known[:, here] = np.isfinite(delay[:, here])
        if space is not None and effects.signal_in_space is not None:
            away = signals.position[rows][:, here] - signals.antenna[rows][:, None]
            unit = away / np.linalg.norm(away, axis=2, keepdims=True)
            space[:, here] = orbit_clock_sensitivity(
                effects.signal_in_space, unit, signals.position[rows][:, here], signals.velocity[rows][:, here]
            )
    return delay, ionosphere, space, known


def _calibrations(pseudolites: Pseudolites, towards: np.ndarray) -> np.ndarray:
    """Change of the pseudoranges of pseudolites (e, p, 4 or 5), m, by one sigma of each error.

    Errors: positions north, east, down; clocks; range biases if there are any. towards: (e, p, 3) unit vectors, ECEF.
    """
    errors = pseudolites.errors
    out = np.full((*towards.shape[:2], 5 if errors.bias > 0.0 else 4), errors.offset)
    out[..., 4:] = errors.bias
    for i, llh in enumerate(pseudolites.llh):
        out[:, i, :3] = pseudolites.errors.survey * (towards[:, i] @ ned_matrix(llh).T)
    return out


def _drawn_offsets(environment: SignalScenario, clock: np.ndarray) -> np.ndarray | None:
    """`Signals.offset` of sources by their time scales (s,), for all systems of the sky except the first."""
    sky = {CLOCKS.index(name) for name in environment.systems if name not in (PSEUDOLITES, OWN)}
    drawn = sorted(sky)[1:]
    if environment.effects.offset_sigma == 0.0 or not drawn:
        return None
    return environment.effects.offset_sigma * (clock[:, None] == np.array(drawn)).astype(float)


def _gains(
    environment: SignalScenario, c_eb: np.ndarray, towards: np.ndarray, elevation: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gains of the aircraft's antenna (e, s), dB: towards satellites as it changes their carrier to noise density,
    which is stated of the zenith, and towards pseudolites, over an isotropic one.

    c_eb: (e, 3, 3) body axes in ECEF. towards: (e, s, 3) unit vectors, ECEF. elevation: (e, s) rad.
    """
    effects, antenna = environment.effects, environment.antenna
    if antenna is not None:
        gain = antenna.gain_at(antenna.elevation_of(c_eb, towards))
        return gain - antenna.zenith, gain
    gain = dll.antenna_gain(elevation, effects.horizon_db)
    return gain if effects.thermal else np.zeros_like(gain), gain


def _by_link(pseudolites: Pseudolites, effects: Effects, antenna: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Carrier to noise density (e, p), dB-Hz, that pseudolites have at distances (e, p), m, without the gain of the
    receiver's antenna, which is at (e, 3), ECEF, m."""
    assert pseudolites.radiated is not None
    noise = interference.noise_density(TEMPERATURE) + effects.noise_figure
    out = pseudolites.radiated.eirp - interference.path_loss(distance, pseudolites.carrier) - noise
    if pseudolites.radiated.pattern is not None:
        for i, llh in enumerate(pseudolites.llh):
            away = (antenna - ecef_from_llh(llh)) / distance[:, i, None]
            out[:, i] += pseudolites.radiated.pattern.gain_at(*azimuth_elevation(away @ enu_matrix(llh).T))
    return out


def fixed_with(
    effects: Effects, time: np.ndarray, sigma: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """1 sigma of the pseudoranges (e, s), m, that fixes are made from, and the counts of their smoothing, if any.

    time: (e,) s. sigma: (e, s) m, of the bare code. used: (e, s) bool.
    """
    if effects.smoothing <= 0.0 or time.size < 2:
        return sigma, None
    variance, counts = dll.smoothed_variance(sigma**2, used, dll.smoothing_memory(effects.smoothing, time))
    return np.sqrt(variance), counts


def clock_unknowns(effects: Effects, clock: np.ndarray) -> np.ndarray:
    """The clock unknowns (s,) the receiver gives to sources by their time scales (s,)."""
    return np.zeros_like(clock) if effects.single_clock else clock
