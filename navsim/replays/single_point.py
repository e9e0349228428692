"""Single-point positioning of recorded pseudoranges with broadcast or precise orbits.

Source: [1] IS-GPS-200, sections 20.3.3.3.3, 20.3.3.4.3. [2] Kaplan & Hegarty (2017), section 11.2. [3] RTKLIB 2.4.3,
`pntpos.c` (the parts of a range's error).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from navsim.formats.recorded_data import Ranges
from navsim.formats.rinex_obs import Observations
from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh, ned_matrix
from navsim.gnss import atmosphere, position_fix
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.dop import MAX_CLOCKS, dops
from navsim.gnss.pseudorange import apparent_velocity, turned_with_earth
from navsim.gnss.sky import azimuth_elevation, enu_matrix
from navsim.replays import outliers

_PASSES = 4
_UNCORRECTED = 20.0
"""Delay of the ionosphere overhead that the test of residuals allows for where nothing corrects it, m."""


@dataclass(frozen=True)
class PositioningOptions:
    """Settings of single-point positioning."""

    mask: float = np.radians(10.0)
    """rad."""
    sigma: float = 1.0
    """1 sigma of a range overhead, m; it grows as 1 / sin(elevation)."""
    klobuchar: tuple[np.ndarray, np.ndarray] | None = None
    """alpha and beta (4,), or None without an ionosphere."""
    troposphere: bool = True
    """Whether to correct with Saastamoinen's model."""
    channels: Mapping[str, int] = field(default_factory=dict)
    """Frequency channels of GLONASS satellites, by name, that neither the orbits nor the observation file contain."""
    weights: Literal["elevation", "budget"] = "elevation"
    """Weights of ranges from the elevation alone, or from an error budget [3]. The budget adds the satellites' own
    accuracy, half of the ionospheric delay, 0.3 m of the troposphere and 0.3 m of biases overhead, and the code
    noise."""
    untold: float = 5.0
    """1 sigma of satellites that broadcast no accuracy, m."""
    most_pdop: float = 100.0
    """Largest PDOP of an accepted fix."""


@dataclass(frozen=True)
class Solution:
    """Fixes at e epochs; nan without a fix."""

    time: np.ndarray
    """(e,) GPS s."""
    llh: np.ndarray
    """(e, 3) rad, rad, m."""
    position: np.ndarray
    """(e, 3) ECEF, m."""
    velocity: np.ndarray
    """(e, 3) NED, m/s, nan with fewer than four Dopplers."""
    clocks: np.ndarray
    """(e, MAX_CLOCKS) m."""
    covariance: np.ndarray
    """(e, 6, 6) of position and velocity, NED."""
    dop: np.ndarray
    """(e, 5)."""
    satellites: np.ndarray
    """(e,) number used."""
    residual: np.ndarray
    """(e, s) m."""
    ranges: Ranges
    """Ranges of the fixes, without those that the outlier test excluded."""
    verdicts: outliers.Verdicts
    """Result of that test."""


def solve(
    observations: Observations, constellations: Sequence[Constellation], settings: PositioningOptions
) -> Solution:
    """Single-point fix at every epoch from L1 code, with one receiver clock a constellation, after the test of
    `outliers`.

    constellations: satellites without a known position or clock are omitted, as are those below the mask.

    Raises ValueError, with their names, for GLONASS satellites without a frequency channel: neither the constellation
    (SP3 has none), the observation file (`GLONASS SLOT / FRQ #`) nor the settings contain it.
    """
    columns, members, clock, ratio2 = _columns(observations, constellations, settings)
    code = _observed(observations, columns, [c.system.codes for c in constellations])
    doppler = _observed(observations, columns, [c.system.dopplers for c in constellations])
    wavelength = SPEED_OF_LIGHT / (atmosphere.L1 * np.sqrt(1.0 / ratio2))
    position, velocity, offset, drift = _at_transmission(observations.time, code, constellations, members)
    ranges = code + SPEED_OF_LIGHT * offset
    rates = -doppler * wavelength + SPEED_OF_LIGHT * drift
    told = [c.accuracy(observations.time - 0.075)[:, own] for c, own in zip(constellations, members, strict=True)]
    accuracy = np.concatenate(told, axis=1)
    accuracy[np.isnan(accuracy)] = settings.untold
    measured = _Measured(observations.time, position, velocity, ranges, rates, code, accuracy, clock, ratio2)
    possible = np.isfinite(ranges) & np.isfinite(position[..., 0])

    def solve_rows(rows: np.ndarray, kept: np.ndarray) -> outliers.TestedFixes:
        return _fixes(measured.take(rows), settings, kept)[0]

    def of_rates(given: outliers.TestedFixes) -> tuple[np.ndarray, np.ndarray]:
        return _rates_at(measured, given.position)

    with np.errstate(all="ignore"):  # far from the Earth, where a wrong range may put a fix
        fixes, travel, dop = _fixes(measured, settings, np.ones(ranges.shape, dtype=bool))
        verdicts = outliers.evaluate_fixes(observations.time, fixes, possible, solve_rows, of_rates, settings.most_pdop)
        changed = np.flatnonzero(verdicts.excluded.any(axis=1))
        if changed.size:
            kept = ~verdicts.excluded[changed]
            _, travel[changed], dop[changed] = _fixes(measured.take(changed), settings, kept)
    dop[~fixes.fixed] = np.nan
    tested = np.where(verdicts.excluded | verdicts.contradictory[:, None], np.nan, ranges)
    tested_rates = np.where(verdicts.excluded_rates, np.nan, rates)
    return Solution(
        observations.time, fixes.llh, fixes.position, fixes.velocity, fixes.clocks, fixes.covariance, dop,
        np.where(fixes.fixed, fixes.used.sum(axis=1), 0), fixes.residual,
        _ranges(observations.time, fixes.llh, fixes.velocity, (position, velocity, tested, tested_rates), travel, clock,
                ratio2, settings, (tuple(observations.satellites[i] for own in columns for i in own),
                                   tuple(c.system.name for c in constellations))),
        verdicts,
    )  # fmt: skip


@dataclass(frozen=True)
class _Measured:
    """Measurements at e epochs to s satellites: positions and velocities at transmission, ranges corrected for their
    clocks, range rates, raw pseudoranges, broadcast accuracies, clock and (L1 / f)^2 (s,)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    ranges: np.ndarray
    rates: np.ndarray
    code: np.ndarray
    accuracy: np.ndarray
    clock: np.ndarray
    ratio2: np.ndarray

    def take(self, rows: np.ndarray) -> _Measured:
        """The measurements at some epochs."""
        own = ("time", "position", "velocity", "ranges", "rates", "code", "accuracy")
        return replace(self, **{name: getattr(self, name)[rows] for name in own})


def _fixes(
    m: _Measured, settings: PositioningOptions, allowed: np.ndarray
) -> tuple[outliers.TestedFixes, np.ndarray, np.ndarray]:
    """Fixes from the allowed ranges (e, s), travel times (e, s), s, and DOPs (e, 5)."""
    e, s = m.ranges.shape
    llh, speed, clocks = np.empty((e, 3)), np.empty((e, 3)), np.empty((e, MAX_CLOCKS))
    covariance = np.empty((e, 6, 6))
    travel = m.code / SPEED_OF_LIGHT
    sigma, delay, visible = np.full((e, s), settings.sigma), np.zeros((e, s)), allowed
    budget = sigma
    los = np.full((e, s, 3), np.nan)
    turned, assumed = m.position, np.full((e, 3), np.nan)
    start = np.zeros(3)
    for round_ in range(_PASSES):
        turned, moving = turned_with_earth(m.position, travel), turned_with_earth(m.velocity, travel)
        if round_:
            moving = apparent_velocity(turned, moving, assumed, np.einsum("eji,ej->ei", ned_matrix(llh), speed))
        usable = np.isfinite(m.ranges - delay) & np.isfinite(turned[..., 0]) & visible
        position_fix.fixes(
            start, *map(np.ascontiguousarray, (turned, moving, sigma)), np.full((e, s), outliers.RATE_SIGMA), m.clock,
            *map(np.ascontiguousarray, (np.where(usable, m.ranges - delay, np.nan), m.rates)),
            llh, speed, clocks, covariance,
        )  # fmt: skip
        assumed = ecef_from_llh(llh)
        distance, los, azimuth, elevation = _sights(llh, turned)
        travel = np.where(np.isfinite(distance), distance / SPEED_OF_LIGHT, travel)
        visible = allowed & (elevation >= settings.mask)
        # both nan where the direction is, and the delay below the horizon: satellites that are not visible
        ionosphere, troposphere = _delays(m.time, llh, azimuth, elevation, m.ratio2, settings)
        delay = ionosphere + troposphere
        sigma = settings.sigma * _slant(elevation)
        unknown = ionosphere if settings.klobuchar is not None else _UNCORRECTED * np.sqrt(_slant(elevation))
        budget = _budget(m.accuracy, unknown, elevation)
        if settings.weights == "budget":
            sigma = _budget(m.accuracy, ionosphere, elevation)
    usable = np.isfinite(m.ranges - delay) & visible & np.isfinite(assumed[:, :1])
    los[~usable] = np.nan
    residual = m.ranges - delay - np.linalg.norm(turned - assumed[:, None], axis=2) - clocks[:, m.clock]
    dop = dops(los, m.clock)
    received = np.where(np.isfinite(assumed[:, :1]), usable, np.isfinite(m.ranges) & allowed)
    scales = np.stack([received[:, m.clock == c].any(axis=1) for c in range(MAX_CLOCKS)], axis=1)
    fixes = outliers.TestedFixes(
        llh, speed, clocks, covariance, assumed, dop[:, 1], usable, np.where(usable, residual, np.nan), budget,
        3 + scales.sum(axis=1),
    )  # fmt: skip
    return fixes, travel, dop


def _rates_at(m: _Measured, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (e, s, 3) of satellites from positions (e, 3), ECEF, and range rates (e, s), m/s.

    The rates exclude the effect of the satellites' motion, except at most 3 mm/s that depend on the receiver's motion.
    """
    travel = m.code / SPEED_OF_LIGHT
    for _ in range(2):
        away = turned_with_earth(m.position, travel) - place[:, None]
        distance = np.linalg.norm(away, axis=2)
        travel = distance / SPEED_OF_LIGHT
    turned, los = turned_with_earth(m.position, travel), away / distance[..., None]
    moving = apparent_velocity(turned, turned_with_earth(m.velocity, travel), place, np.zeros_like(place))
    return los, m.rates - np.einsum("esi,esi->es", los, moving)


def _sights(llh: np.ndarray, sources: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """From places (e, 3) to sources (e, s, 3) ECEF: distance (e, s), unit vector (e, s, 3) ENU, azimuth, elevation (e,
    s)."""
    away = sources - ecef_from_llh(llh)[:, None]
    distance = np.linalg.norm(away, axis=2)
    los = np.einsum("eij,esj->esi", enu_matrix(llh), away / distance[..., None])
    return distance, los, *azimuth_elevation(los)


def _slant(elevation: np.ndarray) -> np.ndarray:
    """By how much more the noise of a range is than overhead."""
    return 1.0 / np.sin(np.maximum(elevation, 0.03))


def _ranges(
    time: np.ndarray, llh: np.ndarray, speed: np.ndarray, measured: tuple[np.ndarray, ...], travel: np.ndarray,
    clock: np.ndarray, ratio2: np.ndarray, settings: PositioningOptions, named: tuple[tuple[str, ...], ...],
) -> Ranges:  # fmt: skip
    """The ranges of all epochs, those without a fix corrected for a place between the ones before and after; measured:
    positions and velocities at transmission, pseudoranges, range rates; named: sources and clocks."""
    position, velocity, pseudorange, range_rate = measured
    names, scales = named
    fixed = np.isfinite(llh[:, 0])
    if not fixed.any():
        nothing = np.full(pseudorange.shape, np.nan)
        return Ranges(time, names, clock, scales, position, velocity, nothing, nothing, range_rate, nothing)
    here = np.stack([np.interp(time, time[fixed], np.unwrap(llh[fixed, i])) for i in range(2)], axis=1)
    here = np.column_stack([here, np.interp(time, time[fixed], llh[fixed, 2])])
    turned = turned_with_earth(position, travel)
    for _ in range(2):
        distance, _, azimuth, elevation = _sights(here, turned)
        travel = np.where(np.isfinite(distance), distance / SPEED_OF_LIGHT, travel)
        turned = turned_with_earth(position, travel)
    # at most 3 mm/s depend on the receiver's own motion, and nothing on a position without a velocity
    moving = np.einsum("eji,ej->ei", ned_matrix(here), np.where(np.isfinite(speed), speed, 0.0))
    apparent = apparent_velocity(turned, turned_with_earth(velocity, travel), ecef_from_llh(here), moving)
    delay = np.add(*_delays(time, here, azimuth, elevation, ratio2, settings))
    there = (elevation >= settings.mask) & np.isfinite(turned[..., 0])
    return Ranges(
        time, names, clock, scales, turned, apparent, distance, np.where(there, pseudorange - delay, np.nan),
        range_rate, _slant(elevation),
    )  # fmt: skip


def _columns(
    observations: Observations, constellations: Sequence[Constellation], settings: PositioningOptions
) -> tuple[list[list[int]], list[list[int]], np.ndarray, np.ndarray]:
    """Observed satellites that a constellation knows: for each constellation their columns, and its members in that
    order; the clock of each, and (L1 / f)^2 of each."""
    columns: list[list[int]] = []
    members: list[list[int]] = []
    clock: list[int] = []
    ratio2: list[float] = []
    unknown: list[str] = []
    for number, constellation in enumerate(constellations):
        known = {name: i for i, name in enumerate(constellation.names)}
        here = [(i, known[name]) for i, name in enumerate(observations.satellites) if name in known]
        columns.append([i for i, _ in here])
        members.append([k for _, k in here])
        clock += [number] * len(here)
        # messages know the channels of their satellites, tables of orbits do not
        told = {**settings.channels, **observations.channels, **constellation.channels}
        system = constellation.system
        for i, _ in here:
            name = observations.satellites[i]
            if system.by_channel and name not in told:
                unknown.append(name)
                continue
            ratio2.append((atmosphere.L1 / system.frequency(told[name] if system.by_channel else 0)) ** 2)
    if unknown:
        raise ValueError(
            f"no frequency channel is known of {', '.join(unknown)}: the orbits have none and the observation file's "
            "GLONASS SLOT / FRQ # neither; take those of messages (`glonass_broadcast.StateVectorEphemerides.channels`)"
        )
    return columns, members, np.array(clock, dtype=np.int64), np.array(ratio2)


def _observed(observations: Observations, columns: list[list[int]], codes: list[tuple[str, ...]]) -> np.ndarray:
    """Values (e, s) of the satellites of each constellation, from the best available code of its system."""
    return np.concatenate([observations.of(*best)[:, own] for best, own in zip(codes, columns, strict=True)], axis=1)


def _at_transmission(
    time: np.ndarray, code: np.ndarray, constellations: Sequence[Constellation], members: list[list[int]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities (e, s, 3) in the axes of transmission, clock offsets (s) and rates (e, s) of satellites.

    The time of reception by the receiver's clock less the pseudorange is the time of transmission by the satellite's.
    All nan where the satellite was not received, or the constellation does not know its place or its clock.
    """
    position: list[np.ndarray] = []
    velocity: list[np.ndarray] = []
    offsets: list[np.ndarray] = []
    drifts: list[np.ndarray] = []
    first = 0
    for constellation, chosen in zip(constellations, members, strict=True):
        mine = code[:, first : first + len(chosen)]
        first += len(chosen)
        # constellations compute all their satellites at finite times; unused results are removed
        whole = np.full((time.size, len(constellation.names)), time[:, None] - 0.075)
        whole[:, chosen] = np.where(np.isfinite(mine), time[:, None] - mine / SPEED_OF_LIGHT, whole[:, chosen])
        offset, _ = constellation.clock(whole)
        sent = whole - np.where(np.isfinite(offset), offset, 0.0)
        p, v = constellation.state(sent)
        lost = ~np.isfinite(offset[:, chosen]) | ~np.isfinite(mine)
        offset, drift = constellation.clock(sent)
        for out, values in ((position, p), (velocity, v), (offsets, offset), (drifts, drift)):
            taken = values[:, chosen]
            taken[lost] = np.nan
            out.append(taken)
    return (
        np.concatenate(position, axis=1),
        np.concatenate(velocity, axis=1),
        np.concatenate(offsets, axis=1),
        np.concatenate(drifts, axis=1),
    )


def _delays(
    time: np.ndarray,
    llh: np.ndarray,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    ratio2: np.ndarray,
    settings: PositioningOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Delays of the ionosphere and the troposphere (e, s), m."""
    ionosphere, troposphere = np.zeros_like(elevation), np.zeros_like(elevation)
    if settings.klobuchar is not None:
        alpha, beta = settings.klobuchar
        ionosphere += ratio2 * atmosphere.klobuchar(alpha, beta, time[:, None], llh[:, None], azimuth, elevation)
    if settings.troposphere:
        troposphere += atmosphere.saastamoinen(llh[:, None], elevation)
    return ionosphere, troposphere


def _budget(accuracy: np.ndarray, ionosphere: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """1 sigma of ranges (e, s), m, by their parts [3]."""
    sine = np.sin(np.maximum(elevation, np.radians(5.0)))
    noise2 = 0.3**2 * (1.0 + 1.0 / sine)
    return np.sqrt(accuracy**2 + (0.5 * ionosphere) ** 2 + (0.3 / (sine + 0.1)) ** 2 + 0.3**2 + noise2)
