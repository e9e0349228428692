"""The geometry of the glide for any placement of pseudolites: what `core.placement` needs, and its results.

Satellites do not care where pseudolites stand, so a scenario is turned into this once, and a placement then costs
tens of nanoseconds an epoch.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from navsim.core.dop import MAX_CLOCKS
from navsim.core.placement import BLOCK, SAT_FIXED, SAT_N, SAT_SHARED, placement_dops
from navsim.models.kinematics import Moving
from navsim.models.signals import Environment, build_signals, clock_unknowns, fixed_with
from navsim.models.sky import enu_matrix

_LOWER = (0, 1, 1, 2, 2, 2), (0, 0, 1, 0, 1, 2)
"""Rows and columns of the lower triangle, in the kernel's order."""
_SHARE = 64 * BLOCK
"""Placements a thread takes at a time."""


@dataclass(frozen=True)
class Geometry:
    """The approach as placements see it.

    receiver: (e, 3) antenna, ECEF m. up: (e, 3). unit, weighted: (e, SAT_N) the satellites' normal matrices with unit
    weights and with 1/variance. ground_weight: (e,) 1/variance of a pseudolite's range, 1/m2.
    """

    receiver: np.ndarray
    up: np.ndarray
    unit: np.ndarray
    weighted: np.ndarray
    ground_weight: np.ndarray

    def dops(self, sites: np.ndarray, workers: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """PDOP, HDOP, VDOP by mean, smallest, largest (3, 3, p), and epochs without a solution (p,).

        sites: (p, k, 3) ECEF of the pseudolites of each placement, m.
        """
        return self._statistics(self.unit, np.ones(len(self.unit)), sites, workers)

    def fix_sigmas(self, sites: np.ndarray, workers: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """The same of the weighted covariance: 1 sigma in space, horizontal, vertical, m ("SKO")."""
        return self._statistics(self.weighted, self.ground_weight, sites, workers)

    def _statistics(
        self, satellites: np.ndarray, weight: np.ndarray, sites: np.ndarray, workers: int
    ) -> tuple[np.ndarray, np.ndarray]:
        count = sites.shape[0]
        by_axis = np.ascontiguousarray(np.moveaxis(sites, 0, 2))
        out, lost = np.empty((3, 3, count)), np.zeros(count, np.int64)

        def share(first: int) -> None:
            last = min(first + _SHARE, count)
            placement_dops(self.receiver, self.up, satellites, by_axis, weight, first, last, out, lost)

        starts = range(0, count, _SHARE)
        if workers == 1 or len(starts) == 1:
            for first in starts:
                share(first)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(share, starts))
        return out, lost


def glide_geometry(
    trajectory: Moving, environment: Environment, utc: np.ndarray, time: np.ndarray, counted: np.ndarray
) -> Geometry:
    """The geometry at chosen fix epochs of the approach, for each start utc (n,), one after the other (n c).

    time: (e,) s, fix epochs from the first one on, so that what the receiver remembers is in it. counted: (e,) bool,
    which of them placements are judged at.
    """
    ground, effects = environment.ground, environment.effects
    alone = replace(environment, ground=replace(ground, names=(), llh=np.empty((0, 3))))
    motion = trajectory.motion(time)
    parts = [build_signals(motion, float(start), alone) for start in np.atleast_1d(utc)]
    axes = enu_matrix(motion.llh)
    shared = int(clock_unknowns(effects, np.array([ground.clock]))[0])
    # pseudolites are heard all the time, all with one sigma
    heard = np.ones((time.size, 1), dtype=bool)
    sigma, _ = fixed_with(effects, time, np.full((time.size, 1), ground.sigma), heard)
    unit = [_normal(s.los, axes, s.clock, np.ones_like(s.fix_sigma), shared)[counted] for s in parts]
    weighted = [_normal(s.los, axes, s.clock, 1.0 / s.fix_sigma**2, shared)[counted] for s in parts]
    return Geometry(
        receiver=np.concatenate([s.antenna[counted] for s in parts]),
        up=np.concatenate([axes[counted, 2]] * len(parts)),
        unit=np.concatenate(unit),
        weighted=np.concatenate(weighted),
        ground_weight=np.tile(1.0 / sigma[counted, 0] ** 2, len(parts)),
    )


def _normal(los: np.ndarray, axes: np.ndarray, clock: np.ndarray, weight: np.ndarray, shared: int) -> np.ndarray:
    """Rows of `core.placement` (e, SAT_N) from unit vectors (e, s, 3) in ENU, nan where a source is not used."""
    used = np.isfinite(los[:, :, 0])
    u = np.einsum("esi,eij->esj", np.where(used[:, :, None], los, 0.0), axes)
    w = np.where(used, weight, 0.0)
    out = np.zeros((los.shape[0], SAT_N))
    for number in range(MAX_CLOCKS):
        member = w * (clock == number)
        a = np.einsum("es,esi,esj->eij", member, u, u)
        b = np.einsum("es,esi->ei", member, u)
        n = member.sum(axis=1)
        if number == shared:
            out[:, SAT_SHARED : SAT_SHARED + 6] = a[:, *_LOWER]
            out[:, SAT_SHARED + 6 : SAT_SHARED + 9] = b
            out[:, SAT_SHARED + 9] = n
        else:
            c = a - b[:, :, None] * b[:, None, :] / np.where(n > 0.0, n, 1.0)[:, None, None]
            out[:, SAT_FIXED : SAT_FIXED + 6] += c[:, *_LOWER]
    return out
