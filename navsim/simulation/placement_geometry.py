"""Geometry of the glide for any placement of pseudolites: inputs of `simulation.placement_dops`, and its results.

The satellites' part does not depend on the pseudolites. It is computed once for a scenario, and a placement then costs
nanoseconds an epoch.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.geodesy.earth import llh_from_ecef
from navsim.geodesy.horizon import upright_planes
from navsim.gnss.dop import MAX_CLOCKS, normals
from navsim.gnss.interference.horizon import Terrain, behind, horizon_distance
from navsim.gnss.signals import SignalScenario, build_signals
from navsim.gnss.sky import enu_matrix
from navsim.simulation.placement_dops import (
    EDGE_ACROSS,
    EDGE_ALONG,
    EDGE_FIRST,
    EDGE_N,
    EDGE_RISE,
    EDGE_UP,
    SAT_A,
    SAT_B,
    SAT_N,
    SAT_WEIGHT,
    placement_dops,
)
from navsim.trajectory.kinematics import Moving

_LOWER = (0, 1, 1, 2, 2, 2), (0, 0, 1, 0, 1, 2)
"""Rows and columns of the lower triangle, in the kernel's order."""
_SHARE = 16384
"""Registers of placements, times epochs, that a thread takes at a time: half a millisecond."""
_OVERHEAD = 1e5
"""Height over touchdown of the pseudolite that represents all placements, m: the flight never comes near it."""


@dataclass(frozen=True)
class Geometry:
    """Geometry of the approach for placement studies."""

    receiver: np.ndarray
    """(e, 3) antenna, ECEF, m."""
    up: np.ndarray
    """(e, 3) unit vectors."""
    reach: np.ndarray
    """(e,) distance to the horizon, m."""
    spare: np.ndarray
    """(e,) int, satellites minus the unknowns without pseudolites."""
    unit: np.ndarray
    """(e, SAT_N) normal matrices of the satellites with unit weights."""
    weighted: np.ndarray
    """(e, SAT_N) with weights 1/variance."""
    pseudolite_unit: np.ndarray
    """(e,) unit weight of a pseudolite's range; 0 where the receiver does not track it."""
    pseudolite_weighted: np.ndarray
    """(e,) weight 1/variance, 1/m2; 0 likewise."""
    ridges: np.ndarray
    """(w, EDGE_N) ridges that hide pseudolites."""
    terrain: Terrain
    """The ridges again, and grids of heights."""
    ground: float
    """See `SignalScenario`."""

    def find_lone_pseudolite(self, count: int) -> np.ndarray:
        """Epochs (e,) bool at which a single pseudolite has no satellite on its time scale, see
        `signals.find_lone_pseudolite`."""
        heard = self.pseudolite_unit > 0.0
        return np.asarray(heard & (self.unit[:, SAT_WEIGHT] == 0.0) & (count == 1))

    def has_beyond_horizon(self, sites: np.ndarray) -> bool:
        """Whether one of sites (..., 3), ECEF m, may be beyond the radio horizon at an epoch; a quick bound."""
        if not sites.size or not self.receiver.size:
            return False
        middle = self.receiver.mean(axis=0)
        away, spread = (np.linalg.norm(points - middle, axis=-1).max() for points in (sites, self.receiver))
        return bool(away + spread > self.reach.min() + horizon_distance(0.0))

    def at(self, epochs: np.ndarray) -> Geometry:
        """The geometry at some of the epochs, (n,) int or (e,) bool."""
        return replace(self, **{name: getattr(self, name)[epochs] for name in _OF_EPOCHS})

    def dops(self, sites: np.ndarray, workers: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """PDOP, HDOP, VDOP by mean, smallest, largest (3, 3, p), and epochs without a solution (p,).

        sites: (p, k, 3) ECEF of the pseudolites of each placement, m.
        """
        return self._statistics(self.unit, self.pseudolite_unit, sites, workers)

    def fix_sigmas(self, sites: np.ndarray, workers: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma of fixes in space, horizontal, vertical, m ("SKO"), from the weighted covariance."""
        return self._statistics(self.weighted, self.pseudolite_weighted, sites, workers)

    def visible_share(self, sites: np.ndarray) -> np.ndarray:
        """Share of the epochs (p,) at which the antenna sees a source at places (p, 3), ECEF, m: over the horizon, and
        not behind terrain."""
        far = horizon_distance(llh_from_ecef(sites)[:, 2] - self.ground)
        away = np.linalg.norm(sites - self.receiver[:, None], axis=2)
        return np.mean((away <= self.reach[:, None] + far) & ~behind(self.terrain, sites[None], self.receiver), axis=0)

    def _clear(self, sites: np.ndarray, first: int, last: int) -> np.ndarray:
        """`clear` of `placement_dops` (last - first, e, k, W)."""
        lanes = np.minimum(np.arange(first * WIDTH, last * WIDTH), len(sites) - 1)
        hidden = behind(Terrain(grids=self.terrain.grids), sites[lanes].reshape(1, -1, 3), self.receiver)
        shaped = hidden.reshape(len(self.receiver), last - first, WIDTH, -1)
        return np.ascontiguousarray(1.0 - np.moveaxis(shaped, (0, 1, 2, 3), (1, 0, 3, 2)))

    def _statistics(
        self, satellites: np.ndarray, weight: np.ndarray, sites: np.ndarray, workers: int
    ) -> tuple[np.ndarray, np.ndarray]:
        count, each = sites.shape[:2]
        groups = -(-count // WIDTH)
        sites = np.ascontiguousarray(sites)
        far = np.empty((0, each))
        if self.has_beyond_horizon(sites):
            far = horizon_distance(llh_from_ecef(sites)[..., 2] - self.ground)
        values, missed = np.empty((3, 3, groups, WIDTH)), np.empty((groups, WIDTH))
        out, lost = in_lanes(values), in_lanes(missed)
        step = max(_SHARE // max(len(weight), 1), 1)

        def share(first: int) -> None:
            room, last = np.empty((each, 4, WIDTH)), min(first + step, groups)
            clear = self._clear(sites, first, last) if self.terrain.grids else np.empty((0, 0, 0, WIDTH))
            placement_dops(
                self.receiver, self.up, self.reach, self.spare, satellites, weight, self.ridges, in_lanes(clear), sites,
                far, room, in_lanes(room), first, last, out, lost,
            )  # fmt: skip

        starts = range(0, groups, step)
        if workers == 1 or len(starts) == 1:
            for first in starts:
                share(first)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(share, starts))
        return values.reshape(3, 3, -1)[..., :count], missed.ravel()[:count].astype(np.int64)


_OF_EPOCHS = tuple(f.name for f in fields(Geometry) if f.name not in ("ridges", "terrain", "ground"))
"""Fields with one row for each epoch."""


def glide_geometry(
    trajectory: Moving, environment: SignalScenario, utc: np.ndarray, time: np.ndarray, counted: np.ndarray
) -> Geometry:
    """Geometry at chosen fix epochs of the approach, for each start utc (n,), one after the other (n c).

    - `time` (e,): fix epochs from the first one on, s, so that the receiver's memory is included.
    - `counted` (e,) bool: epochs at which placements are evaluated.

    Signals are those of a landing. A distant pseudolite supplies the quantities that do not depend on the position,
    so without drawn errors of the air.
    """
    motion = trajectory.motion(time)
    axes = enu_matrix(motion.llh)[counted]
    place = llh_from_ecef(trajectory.frame.origin) + np.array([0.0, 0.0, _OVERHEAD])
    errors = replace(environment.pseudolites.errors, refractivity=0.0)
    anywhere = replace(environment.pseudolites, names=("any",), llh=place[None], errors=errors)
    sources = replace(environment, pseudolites=anywhere)
    ridges, parts = _edges(environment.terrain.tops), []
    for start in np.atleast_1d(utc):
        s = build_signals(motion, float(start), sources)
        clock, shared = s.time_scale[:-1], int(s.time_scale[-1])
        los = np.einsum("esi,eij->esj", s.los[counted, :-1], axes)
        heard, weight = s.used[counted, -1], 1.0 / s.fix_sigma[counted] ** 2
        counts = normals(los, clock, np.ones(los.shape[:2]))
        in_clock = np.diagonal(counts, axis1=1, axis2=2)[:, 3:]
        parts.append(
            Geometry(
                receiver=s.antenna[counted],
                up=axes[:, 2],
                reach=horizon_distance(llh_from_ecef(s.antenna[counted])[:, 2] - environment.ground),
                spare=(in_clock.sum(axis=1) - (in_clock > 0.0).sum(axis=1) - 3.0).astype(np.int64),
                unit=rows(counts, shared),
                weighted=rows(normals(los, clock, weight[:, :-1]), shared),
                pseudolite_unit=heard.astype(float),
                pseudolite_weighted=np.where(heard, weight[:, -1], 0.0),
                ridges=ridges,
                terrain=environment.terrain,
                ground=environment.ground,
            )
        )
    every: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _OF_EPOCHS}
    return replace(parts[0], **every)


def _edges(tops: np.ndarray) -> np.ndarray:
    """Ridges (w, 2, 3), ECEF, m, as the rows of `simulation.placement_dops` (w, EDGE_N)."""
    first, along, up, level = upright_planes(tops)
    out = np.empty((len(tops), EDGE_N))
    out[:, EDGE_FIRST : EDGE_FIRST + 3] = first
    out[:, EDGE_ACROSS : EDGE_ACROSS + 3] = np.cross(along, up)
    out[:, EDGE_ALONG : EDGE_ALONG + 3] = level / np.sum(level**2, axis=1, keepdims=True)
    out[:, EDGE_UP : EDGE_UP + 3] = up
    out[:, EDGE_RISE] = np.sum(along * up, axis=1)
    return out


def rows(normal: np.ndarray, shared: int) -> np.ndarray:
    """Rows of `simulation.placement_dops` (e, SAT_N) from the satellites' `normals` (e, 6, 6) in ECEF, all clocks
    eliminated but number `shared`, which the pseudolites keep."""
    b, n = -normal[:, 3:, :3], np.diagonal(normal, axis1=1, axis2=2)[:, 3:]
    out = np.empty((len(normal), SAT_N))
    out[:, SAT_A:SAT_B] = normal[:, *_LOWER]
    for other in range(MAX_CLOCKS):
        if other != shared:
            square = b[:, other, _LOWER[0]] * b[:, other, _LOWER[1]]
            out[:, SAT_A:SAT_B] -= square / np.where(n[:, other] > 0.0, n[:, other], 1.0)[:, None]
    out[:, SAT_B:SAT_WEIGHT] = b[:, shared]
    out[:, SAT_WEIGHT] = n[:, shared]
    return out
