"""Geometry of ranging beacons along a landing: their DOPs, their mirror image, and warnings about their places."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef
from navsim.gnss.dop import MAX_CLOCKS
from navsim.gnss.pseudorange import Signals
from navsim.gnss.ranging_geometry import (
    inverse_diagonal,
    mirror_image,
    mixed_dops,
    plane_of,
    range_dops,
    without_clock,
)
from navsim.gnss.sky import enu_matrix
from navsim.results.notes import BEACONS, CONSISTENT, SECOND_ORDER, SIGMA_WITH_BEACONS, Note
from navsim.sensors.beacons import Beacons
from navsim.statistics.rounding import digits
from navsim.trajectory.kinematics import Moving

FLAT_VDOP = 5.0
"""VDOP on the glide above which navsim warns that beacons do not show the height."""
_SIGMAS = 3.0
"""Residual of a mirror image, over the sigma of a range, below which the ranges do not tell it from the position."""
_PRIOR = 30.0
"""1 sigma of a position along each axis before ranges, m, in the ranking of placements."""
CURVED = 0.25
"""Second-order error of a range over its noise, above which navsim warns. Along a recorded flight, two beacons, 40 runs
each: at 0.22 the filter's sigma was right, at 0.55 the largest z was 1.7, at 4.4 3.6, at 44 8.9; shipped layouts have
0.13 or less."""
_AT_ONCE = 400_000
"""Ranges of placements that are computed at a time."""


@dataclass(frozen=True)
class BeaconGeometry:
    """Beacons as seen at times of a flight (e,)."""

    sensor: Beacons
    llh: np.ndarray
    """(n, 3) surveyed positions."""
    received: np.ndarray
    """(e, n) bool."""
    dop: np.ndarray
    """(e, 3) PDOP, HDOP, VDOP of the beacons alone, nan without a solution."""
    away: np.ndarray
    """(e, n, 3) from the antenna to the beacons, ENU m, nan where not received."""
    position: np.ndarray
    """(e, 3) antenna, ECEF, m."""

    def at(self, some: np.ndarray) -> BeaconGeometry:
        """The same at some of the times, (e,) bool."""
        of = {name: getattr(self, name)[some] for name in ("received", "dop", "away", "position")}
        return replace(self, **of)

    def dop_with_sources(self, signals: Signals) -> np.ndarray:
        """PDOP, HDOP, VDOP (e, 3) of beacons and sources of the fix together, at the same times."""
        if self.sensor.clock is None:
            return mixed_dops(self.away, signals.los, signals.time_scale)
        free = sorted({*range(MAX_CLOCKS)} - {*signals.time_scale[signals.used.any(axis=0)].tolist()})
        if not free:
            return np.full_like(self.dop, np.nan)
        return mixed_dops(self.away, signals.los, signals.time_scale, free[0])

    def images(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height of the mirror image above the antenna (k,), m, and residual of the ranges there (k,), RMS, m, at some
        of the times (k,) int; nan without an image."""
        sites, height, residual = ecef_from_llh(self.llh), np.full(at.size, np.nan), np.full(at.size, np.nan)
        for k, e in enumerate(at):
            image, residual[k] = mirror_image(sites[self.received[e]], self.position[e])
            if np.isfinite(image).all():
                height[k] = llh_from_ecef(image)[2] - llh_from_ecef(self.position[e])[2]
        return height, residual


@dataclass(frozen=True)
class BeaconGlide:
    """The glide as placements of beacons see it: what `placement_geometry.Geometry` is for pseudolites."""

    sensor: Beacons
    threshold: np.ndarray
    """(3,) rad, rad, m."""
    receiver: np.ndarray
    """(e, 3) antenna at epochs, ECEF, m."""

    @classmethod
    def of(cls, sensor: Beacons, trajectory: Moving, time: np.ndarray) -> BeaconGlide:
        """The glide at times (e,), s."""
        return cls(sensor, sensor.threshold(trajectory.frame), sensor.antenna(trajectory, time))

    def at(self, epochs: np.ndarray) -> BeaconGlide:
        """The same at some of the epochs, (n,) int or (e,) bool."""
        return replace(self, receiver=self.receiver[epochs])

    def dops(self, sites: np.ndarray, median: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """PDOP, HDOP, VDOP by mean, smallest, largest (3, 3, p), nan without, and epochs without a solution (p,).

        sites: (p, k, 3) ECEF of the beacons of each placement, m. median: it is the fourth, (3, 4, p).
        """
        return self._statistics(sites, lambda away: self._variances(away, np.ones(away.shape[1:])), median)

    def _variances(self, away: np.ndarray, weight: np.ndarray, prior: float = 0.0) -> np.ndarray:
        """`inverse_diagonal` of the ranges, for one-way ranges after their clock is eliminated."""
        return inverse_diagonal(*(without_clock(away, weight) if self.sensor.clock else (away, weight)), prior)

    def fix_sigmas(self, sites: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma of positions from a range of each beacon in space, horizontal, vertical, m, by the filter model of a
        range and `_PRIOR`; an order of placements, not an error of the filter."""
        errors = self.sensor.design.errors

        def variances(away: np.ndarray) -> np.ndarray:
            distance = np.sqrt((away * away).sum(axis=0))
            variance = self.sensor.noise_variance(distance) + errors.variance(distance)
            return self._variances(away, 1.0 / variance, 1.0 / _PRIOR**2)

        return self._statistics(sites, variances)

    def _statistics(
        self, sites: np.ndarray, variances: Callable[[np.ndarray], np.ndarray], median: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `dops`. variances: along east, north and up (3, e, p), nan without a solution, from the vectors to the
        beacons (3, k, e, p), nan where one is not received."""
        count, each = sites.shape[:2]
        epochs, axes = len(self.receiver), enu_matrix(llh_from_ecef(self.receiver))
        out, lost = np.full((3, 3 + median, count), np.nan), np.full(count, float(epochs))
        step = max(_AT_ONCE // max(epochs * each, 1), 1)
        for first in range(0, count if each and epochs else 0, step):
            some = sites[first : first + step].swapaxes(0, 1)
            away, received = self.sensor.away_from(self.receiver, llh_from_ecef(some).reshape(-1, 3), self.threshold)
            enu = np.where(received[..., None], away @ np.swapaxes(axes, 1, 2), np.nan)
            by_beacon = np.ascontiguousarray(enu.reshape(epochs, each, -1, 3).transpose(3, 1, 0, 2))
            east, north, up = variances(by_beacon)
            found = np.sqrt(np.stack([east + north + up, east + north, up]))
            part, solved = slice(first, first + step), np.isfinite(up)
            lost[part] = epochs - solved.sum(axis=0)
            with np.errstate(invalid="ignore"):  # 0 / 0 without a solution
                out[:, 0, part] = np.where(solved, found, 0.0).sum(axis=1) / solved.sum(axis=0)
            out[:, 1, part] = np.where(solved, found, np.inf).min(axis=1)
            out[:, 2, part] = np.where(solved, found, -np.inf).max(axis=1)
            if median:
                out[:, 3, part] = _median(np.where(solved, found, np.inf), solved.sum(axis=0))
        return np.where(lost < epochs, out, np.nan), lost


def _median(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Median (3, p) of the smallest `count` (p,) of values (3, e, p)."""
    ordered = np.sort(values, axis=1)
    low, high = (
        np.take_along_axis(ordered, np.broadcast_to(np.maximum(at, 0), (3, 1, count.size)), axis=1)[:, 0]
        for at in ((count - 1) // 2, count // 2)
    )
    return 0.5 * (low + high)


def beacon_geometry(sensor: Beacons, trajectory: Moving, time: np.ndarray) -> BeaconGeometry:
    """Geometry of beacons at times (e,) of a flight, s."""
    away, received = sensor.away(trajectory, time)
    llh = sensor.positions(trajectory.frame)
    position = ecef_from_llh(llh)[0] - away[:, 0]
    there = np.where(received[..., None], away @ np.swapaxes(enu_matrix(llh_from_ecef(position)), 1, 2), np.nan)
    return BeaconGeometry(sensor, llh, received, range_dops(there, sensor.clock is not None), there, position)


def second_order(geometry: BeaconGeometry, of_fix: np.ndarray) -> np.ndarray:
    """Mean second-order errors of ranges (e, n), m, that the filter neglects, as `neglected`, while there are fixes.

    P: covariance of the position from a fix and one range of each received beacon, with lasting errors as noise.
    of_fix: (e, 3, 3) covariance of the fix, NED, m2.
    """
    sensor = geometry.sensor
    u, distance = _directions(geometry)
    weight = geometry.received / (sensor.noise_variance(distance) + sensor.design.errors.variance(distance))
    rows = np.append(u, np.full((*distance.shape, 1), float(sensor.design.clock is not None)), axis=2)
    known = np.einsum("en,enj,enk->ejk", weight, rows, rows)
    known[:, :3, :3] += np.linalg.inv(of_fix)
    known[:, 3, 3] += known[:, 3, 3] == 0.0  # no clock, or no range of it
    return neglected(geometry, np.linalg.inv(known)[:, :3, :3])


def _directions(geometry: BeaconGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (e, n, 3) to the beacons, NED, and distances (e, n), m; of those not received any."""
    away = np.where(geometry.received[..., None], geometry.away, 1.0)[..., [1, 0, 2]] * [1.0, 1.0, -1.0]
    distance = np.linalg.norm(away, axis=2)
    return away / distance[..., None], distance


def neglected(geometry: BeaconGeometry, p: np.ndarray) -> np.ndarray:
    """Mean second-order errors of ranges (e, n), m, tr((I - u u') P) / (2 d) with the covariance of the position p (e,
    3, 3), NED m2; nan where none is received.

    Source: `docs/theory/beacons.md`, section 3.
    """
    u, distance = _directions(geometry)
    across = np.trace(p, axis1=1, axis2=2)[:, None] - np.einsum("enj,ejk,enk->en", u, p, u)
    return np.where(geometry.received, across / (2.0 * distance), np.nan)


@dataclass(frozen=True)
class CurvedRange:
    """The range of a flight that is least linear in the position error."""

    name: str
    """Its beacon."""
    distance: float
    """m."""
    height: float
    """Height of the antenna above the beacon, m."""
    longer: float
    """Mean second-order error, m."""
    ratio: float
    """That over the noise."""

    @classmethod
    def of(cls, geometry: BeaconGeometry, longer: np.ndarray, asked: np.ndarray | None = None) -> CurvedRange | None:
        """The worst of those whose second-order errors (e, n), m, exceed `CURVED` of the noise; None without. asked:
        (e,) the one beacon asked at each time; None: all."""
        distance = np.linalg.norm(geometry.away, axis=2)
        ratio = np.where(geometry.received, longer / np.sqrt(geometry.sensor.noise_variance(distance)), 0.0)
        if asked is not None:
            ratio = np.where(np.arange(ratio.shape[1]) == asked[:, None], ratio, 0.0)
        if not (ratio > CURVED).any():
            return None
        e, n = np.unravel_index(np.argmax(ratio), ratio.shape)
        return cls(
            geometry.sensor.names[n], float(distance[e, n]), -float(geometry.away[e, n, 2]), float(longer[e, n]),
            float(ratio[e, n]),
        )  # fmt: skip

    @property
    def _where(self) -> str:
        """Where it is, and by how much it is not linear."""
        side = "above" if self.height > 0.0 else "below"
        return (
            f"at {digits(self.distance)} m, {abs(self.height):.0f} m {side} it, they are {digits(self.longer)} m off "
            f"on average, {digits(self.ratio)} times their noise"
        )

    @property
    def followed(self) -> str:
        """Note that the filter estimates the second order by itself, with the worst beacon."""
        return Note(
            "beacons: the filter estimates the second order of ranges, because they are not linear in the position "
            f"error. The worst are those of {self.name}: {self._where}. `filter.beacons.second_order: false` leaves it "
            "out", SECOND_ORDER,
        )  # fmt: skip

    def warning(self, cure: str) -> str:
        """Warning that the filter takes it as linear. cure: what helps beside larger noise and other places."""
        return Note(
            f"beacons: the filter takes ranges of {self.name} as linear in the position error, which they are not: "
            f"{self._where}. So sigma may be far too small. {cure}. Or check "
            "beacons.height_m; put beacons where they show the position, far above or below the path; set "
            f"filter.beacons.sigma_m to {digits(1.1 * self.longer / CURVED, 2)}",  # more noise also leaves P larger
            SIGMA_WITH_BEACONS, (CONSISTENT,),
        )  # fmt: skip


def beacon_warnings(geometry: BeaconGeometry, glide: np.ndarray) -> list[str]:
    """Warnings of beacons that are never received, and of layouts that do not show the height on the glide, (e,)
    bool."""
    out: list[str] = []
    names = geometry.sensor.names
    why = "out of reach, beyond the horizon, behind terrain or silent"
    if geometry.received.size and not geometry.received.any():
        nearest = np.linalg.norm(ecef_from_llh(geometry.llh) - geometry.position[:, None], axis=2).min()
        return [Note(
            f"beacons: none is ever received, so they change nothing: {why}. They reach "
            f"{digits(geometry.sensor.reach)} m, and the nearest passes at {digits(nearest)} m", BEACONS,
        )]  # fmt: skip
    for name, times in zip(names, geometry.received.T, strict=True):
        if not times.any():
            out.append(Note(f"beacons: {name} is never received: it is {why}", BEACONS))
    far = np.where(geometry.received, np.linalg.norm(geometry.away, axis=2), 0.0).max(initial=0.0)
    its, assumed = geometry.sensor, geometry.sensor.design
    drawn = 0.0 if assumed.air_sigma else 1e-6 * its.air_sigma * float(far)
    needed = math.hypot(its.true_errors.bias, drawn)
    if drawn > 0.5 * math.hypot(assumed.errors.bias, assumed.sigma) and assumed.errors.bias < 0.99 * needed:
        out.append(Note(
            f"beacons.air: its drawn part reaches {digits(drawn)} m (1 sigma) at {digits(far)} m, and the filter has "
            "no state for it. So sigma is too small: use filter.beacons.errors: states and leave out "
            f"filter.beacons.refractivity_sigma_n, or set filter.beacons.bias_sigma_m to {digits(needed)}",
            SIGMA_WITH_BEACONS, (CONSISTENT,),
        ))  # fmt: skip
    if not glide.any():
        return out
    vdop = geometry.dop[glide, 2]
    if np.isnan(vdop).all():
        return [*out, Note(f"beacons: {_no_position(geometry, glide)}: their ranges alone give no position", BEACONS)]
    if float(np.nanmax(vdop)) > FLAT_VDOP:
        out.append(Note(_flat(geometry, glide), BEACONS))
    return out


def _no_position(geometry: BeaconGeometry, glide: np.ndarray) -> str:
    """Why ranges of beacons give no position at any time of the glide, (e,) bool."""
    one_way = geometry.sensor.clock is not None
    needed, most = 3 + one_way, int(geometry.received[glide].sum(axis=1).max())
    if most < needed:
        return f"at most {most} of them are received at a time on the glide, and a position needs {needed}"
    if one_way:
        return "seen from the glide they lie on one cone or in one plane, as pairs symmetric to it do; move one"
    return "seen from the glide they lie in one plane, as all in one line do; move one of them out of it"


def _flat(geometry: BeaconGeometry, glide: np.ndarray) -> str:
    """That ranges of beacons hardly show the height on the glide, (e,) bool, why, and their mirror solution."""
    vdop, plane = geometry.dop[glide, 2], plane_of(ecef_from_llh(geometry.llh))
    many = f"{np.sum(vdop > FLAT_VDOP)} of {np.sum(np.isfinite(vdop))} fix epochs"
    flat = (
        f"nearly in one plane: RMS distance {plane.thickness:.1f} m from it, {plane.width:.0f} m along its shorter axis"
        if plane.is_flat
        else "badly placed for it"
    )
    text = (f"beacons: their ranges alone hardly show the height on the glide: VDOP up to {digits(np.nanmax(vdop))}, "
            f"above {FLAT_VDOP:g} at {many} ({flat})")  # fmt: skip
    height, residual = geometry.images(np.flatnonzero(glide)[[0, -1]])
    if (fits := residual < _SIGMAS * geometry.sensor.sigma).any():
        places = [
            f"{abs(h):.0f} m {'above' if h > 0.0 else 'below'} the aircraft where the glide {when}"
            for h, when, fit in zip(height, ("begins", "ends"), fits, strict=True)
            if fit
        ]
        text += (f". A mirror solution {' and '.join(places)} fits them within {residual[fits].max():.2f} m; it counts "
                 "only if the filter starts from them alone")  # fmt: skip
    east, north, up = np.moveaxis(geometry.away[glide], -1, 0)
    under = (-up > np.hypot(east, north)).any()  # seen below 45 degrees: one stands there already
    return (f"{text}. Judge the layout by the filter's sigma; if it is too large, put one much higher, "
            f"{'' if under else 'or one under the glide path, '}or keep another source of height")  # fmt: skip
