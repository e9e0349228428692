"""Transmitters on the ground that an aircraft does not run into."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from navsim.scenario.ground_stations import StationSection
from navsim.scenario_files.base import reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.gnss.pseudolite import Track
    from navsim.scenario.landing import Landing
    from navsim.trajectory.kinematics import Frame, Moving


def track_of(landing: Landing, trajectory: Moving) -> Track:
    """Trajectory during the simulation, of the IMU and the antenna."""
    import numpy as np

    from navsim.gnss.pseudolite import TRACK_STEP, Track

    tenths = np.arange(0.0, landing.duration_s, 0.1)
    fastest = np.linalg.norm(trajectory.path.jet(tenths)[:, 1], axis=1).max()
    times = np.linspace(0.0, landing.duration_s, math.ceil(landing.duration_s * fastest / TRACK_STEP) + 1)
    lever_arm = np.array(landing.receiver.lever_arm_m)
    if not lever_arm.any():
        return Track(trajectory.path.jet(times)[:, 0] @ trajectory.frame.axes.T + trajectory.frame.origin)
    from navsim.gnss.signals import antenna_ecef

    motion = trajectory.motion(times)
    return Track(np.concatenate([motion.position_ecef, antenna_ecef(motion, lever_arm)]))


def pseudolite_sites(landing: Landing, frame: Frame, track: Track) -> np.ndarray:
    """Surveyed positions (p, 3), ECEF, m, which `track` keeps clear of. Raises where it does not, or where the
    coordinates are of another frame."""
    from navsim.geodesy.earth import ecef_from_llh

    if landing.pseudolites.frame == "table1" and landing.approach.start is None and landing.pseudolites.placed():
        raise reject("the paper's frame is counted from approach.start, which is not given", "pseudolites", "frame")
    sites = ecef_from_llh(landing.pseudolite_positions(frame))
    names = [f"pseudolite {name}" for name in landing.pseudolites.names()]
    _check_clear(track, sites, names, "pseudolites", "sites" if landing.pseudolites.sites else "s_m")
    return sites


def check_sites(landing: Landing, trajectory: Moving) -> None:
    """Raise where transmitters are in the way of the aircraft."""
    from navsim.geodesy.earth import ecef_from_llh

    track = track_of(landing, trajectory)
    pseudolite_sites(landing, trajectory.frame, track)
    if landing.beacons is not None:
        sites = ecef_from_llh(landing.beacons.model(landing).positions(trajectory.frame))
        _check_clear(track, sites, [f"beacon {name}" for name in landing.beacons.names()], "beacons", "sites")
    for section in landing.aiding_sections().values():
        if isinstance(section, StationSection):
            sites = ecef_from_llh(section.model(landing).llh(trajectory.frame))[None]
            _check_clear(track, sites, ["the antenna"], section.name, section.placing_key())


def _check_clear(track: Track, sites: np.ndarray, names: Sequence[str], *path: str) -> None:
    """Raise, about the key at `path`, where a transmitter at sites (p, 3), ECEF m, is in the way of the aircraft."""
    from navsim.gnss.pseudolite import NEAREST

    for index, excess in enumerate(track.too_near(sites)):
        if excess > 0.0:
            raise reject(
                f"{names[index]} comes within {NEAREST - excess:.1f} m of the aircraft; it must stay {NEAREST:g} m "
                "away", *path, *([index] if path[-1] == "sites" else []),
            )  # fmt: skip
