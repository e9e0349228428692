"""Whether an aircraft can fly the route of a landing in its wind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from navsim.scenario.air import beside
from navsim.scenario.approach import SLOWEST, FileApproach, PadApproach, WaypointApproach
from navsim.scenario_files.base import reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.scenario.landing import Landing
    from navsim.trajectory.air import Air
    from navsim.trajectory.kinematics import Trajectory
    from navsim.trajectory.path import AnyPath

_WIND_STEP = 0.1
"""Interval of the comparison of wind and airspeed, s."""


def checked_path(landing: Landing) -> AnyPath:
    """The path. Raises if there is none, or none in this wind."""
    import numpy as np

    from navsim.trajectory.air import HIGHEST, AirError

    try:
        path = landing.path()
    except AirError as error:
        raise reject(str(error), "wind", error.key) from error
    except ValueError as error:
        raise reject(f"no path meets these numbers: {error}", "approach", *_at_waypoint(landing, error)) from error
    by_law = landing.wind.profile == "log" and landing.wind.blows
    if by_law or landing.wind.turbulence is not None:
        highest = float(np.max(-path.jet(np.linspace(0.0, landing.duration_s, 400))[:, 0, 2]))
        up = f"the path is {highest:.0f} m up"
        if by_law and highest > HIGHEST + 1e-6:
            text = f"the logarithmic law holds up to {HIGHEST:g} m above the runway, {up}; use power or table"
            raise reject(text, "wind", "profile")
        if landing.wind.turbulence is not None and highest > HIGHEST + 1e-6:
            text = f"the turbulence of low altitude ends {HIGHEST:g} m (1000 ft) above the runway, {up}"
            raise reject(text, "wind", "turbulence")
    for i, gust in enumerate(landing.wind.gusts):
        if gust.start_s >= landing.duration_s:
            raise reject(f"is not within duration_s, {landing.duration_s:g} s", "wind", "gusts", i, "start_s")
    return path


def _at_waypoint(landing: Landing, error: ValueError) -> tuple[str | int, ...]:
    """The key, below `approach`, of the waypoint that a path fails at."""
    if not isinstance(landing.approach, WaypointApproach):
        return ()
    if landing.approach.circuit is not None:
        return ("circuit",)
    number = getattr(error, "waypoint", None)
    return () if number is None else ("points", number)


def check_speed(landing: Landing, path: AnyPath) -> None:
    import numpy as np

    from navsim.trajectory.approach import ROLL_OUT

    times = np.linspace(0.0, landing.duration_s, 400)
    if (air := landing.air()) is not None:
        slowest = np.min(np.linalg.norm(path.jet(times)[:, 1], axis=1))
        if slowest < SLOWEST:
            text = f"a route that falls to {slowest:.1f} m/s within duration_s has no course to be off; 2 m/s has"
            raise reject(text + beside(air[1]), *air[1][0])
    if isinstance(landing.approach, PadApproach):
        return
    # on the ground the nose does not turn
    times = times[times < path.events.get(ROLL_OUT, math.inf)]
    slowest = np.min(np.linalg.norm(path.jet(times)[:, 1], axis=1))
    if slowest < SLOWEST:
        raise reject(
            f"the aircraft falls to {slowest:.1f} m/s within duration_s, {landing.duration_s:g} s. Its attitude "
            "follows from its path, so it must keep 2 m/s. Give a shorter duration_s, or `speed_is: ground`, with "
            "which an aircraft stops and remains at rest, or `profile: pad`, which hovers",
            "approach",
            "profile",
        )


def check_airspeed(landing: Landing, trajectory: Trajectory) -> None:
    """Raise where the aircraft would go backwards through the air, or where gusts are as fast as it."""
    if trajectory.body is not None or not (landing.wind.blows or landing.wind.buffets):
        return
    import numpy as np

    from navsim.trajectory.air import triangle_along
    from navsim.trajectory.airspeed_path import SLOWEST
    from navsim.trajectory.approach import ROLL_OUT

    end = min(landing.duration_s, trajectory.path.events.get(ROLL_OUT, math.inf))
    times = np.arange(0.0, end, _WIND_STEP)
    flown = triangle_along(trajectory, times)
    ahead = flown.airspeed * np.cos(flown.crab)
    worst = int(np.argmin(np.where(np.isnan(ahead), math.inf, ahead)))  # straight up there is no course
    if ahead[worst] < SLOWEST:
        over_ground = ahead[worst] - flown.headwind[worst]
        raise reject(
            f"at {times[worst]:.1f} s the wind blows with {-flown.headwind[worst]:.1f} m/s along the course, the "
            f"aircraft moves at {over_ground:.1f} m/s over ground. Its airspeed ahead would be "
            f"{ahead[worst]:.1f} m/s, {SLOWEST:g} m/s are needed; give less wind from behind"
            + ("" if isinstance(landing.approach, FileApproach) else ", or `approach.speed_is: air`"),
            "wind",
            "levels" if landing.wind.profile == "table" else "speed_m_s",
        )
    if (air := landing.air()) is not None and landing.wind.buffets:
        _check_gusts(landing, air[0], trajectory, times)


def _check_gusts(landing: Landing, air: Air, trajectory: Trajectory, grid: np.ndarray) -> None:
    """Raise where gusts that blow at the same time, and turbulence at 3 sigma, are as fast as the aircraft."""
    import numpy as np

    from navsim.trajectory.gust_response import gust_components
    from navsim.trajectory.track_frame import Course

    course = Course.of(trajectory, grid)
    tops = [g.start + g.rise_time(1.0 / float(np.interp(g.start, grid, course.slowness[0]))) for g in air.gusts]
    peaks = np.array([t for top, g in zip(tops, air.gusts, strict=True) for t in (top, top + g.hold)])
    times = np.union1d(grid, peaks[peaks < grid[-1]])
    airspeed = 1.0 / np.interp(times, grid, course.slowness[0])
    gusts = np.linalg.norm(gust_components(air.gusts, trajectory, times, course, grid), axis=1)
    rough = np.zeros(times.size)
    if air.turbulence is not None:
        height = np.interp(times, grid, course.height[0])
        airborne = np.interp(times, grid, course.airborne[0])
        rough = 3.0 * air.turbulence.sigmas(height).max(axis=1) * airborne
    worst = int(np.argmax(gusts + rough - airspeed))
    if gusts[worst] + rough[worst] < airspeed[worst]:
        return
    parts = [f"gusts of {gusts[worst]:.1f} m/s"] if gusts[worst] > 0.0 else []
    parts += [f"turbulence of {rough[worst]:.1f} m/s (3 sigma)"] if rough[worst] > 0.0 else []
    raise reject(
        f"at {times[worst]:.1f} s there are {' and '.join(parts)}, and the airspeed is {airspeed[worst]:.1f} m/s: "
        "no aircraft flies in air that moves as fast as it does; give less, or gusts at different times",
        "wind",
        "gusts" if gusts[worst] >= rough[worst] else "turbulence",
    )
