"""Profiles of the approach: section `approach`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.scenario.guidance import AutopilotSection, FlightTechnicalErrorSection, IndicatorSection
from navsim.scenario.runway import Point, Reach
from navsim.scenario_files.base import (
    DEG,
    KMH,
    Azimuth,
    Checksum,
    FlightTime,
    Latitude,
    ListOf,
    LogTime,
    Longitude,
    NonNegative,
    Section,
    Sigma,
    Stretch,
    reject,
)

if TYPE_CHECKING:
    import numpy as np

    from navsim.trajectory.approach import Taxi
    from navsim.trajectory.go_around import AlarmGoAround, PullUp
    from navsim.trajectory.path import Path
    from navsim.trajectory.waypoints import Waypoint

SLOWEST = 2.0
"""Least speed over ground at which a path has a course, m/s."""


STEEPEST_GLIDE = 15.0
"""Largest angle of a glide path onto a runway, deg."""


class _Approach(Section):
    start: Point | None = None
    """where the simulation begins; leave out to derive it from runway.threshold"""
    start_height_m: Annotated[float, Field(ge=0.1, le=5000.0)] = 153.0
    """height above the runway at the start"""
    glide_slope_deg: Annotated[float, Field(ge=1.0, le=STEEPEST_GLIDE)] = 5.0
    """angle of the glide path below the horizontal"""
    speed_start_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 130.0
    """speed at the start, along the path, over ground, or through the air by speed_is"""
    speed_touchdown_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] = 80.0
    """speed at touchdown, along the path, over ground, or through the air by speed_is"""
    speed_is: Literal["ground", "air"] = "ground"
    """reference of speeds: ground, whatever the wind; or air, in which case the airspeed along the path is kept"""
    angle_of_attack_deg: Annotated[float, Field(ge=-10.0, le=30.0)] = 3.0
    """constant angle of attack; pitch = path angle relative to the air + angle of attack"""
    pitch: Literal["path", "level"] = "path"
    """path: the nose follows the path; level: it keeps angle_of_attack_deg above the horizon"""
    flight_technical_error: FlightTechnicalErrorSection | None = None
    """deviation of each run from the route; null: all fly the route"""
    guidance: Literal["reference", "estimate"] = "reference"
    """what steers the aircraft: the route itself, whatever the filter estimates; or an autopilot by the filter's
    estimate of each run, so that navigation errors take the aircraft off the route and change its measurements"""
    autopilot: AutopilotSection = AutopilotSection()
    """the autopilot of guidance by the estimate"""
    indicator: IndicatorSection | None = None
    """deviations from localizer and glide path in parts of full scale; null: none"""

    @model_validator(mode="before")
    @classmethod
    def _gentle(cls, data: Any) -> Any:
        """Say what flies a slope that is too steep for a runway."""
        slope = data.get("glide_slope_deg") if isinstance(data, dict) and data.get("profile") != "pad" else None
        if isinstance(slope, int | float) and slope > STEEPEST_GLIDE:
            text = f"must be at most {STEEPEST_GLIDE:g} deg onto a runway, not {slope:g}; `profile: pad` flies up to 80"
            raise reject(f"{text} deg to a hover, and descends vertically", "glide_slope_deg")
        return data

    @model_validator(mode="after")
    def _steered(self) -> Self:
        # a stored scenario has every default written out
        if self.guidance == "reference" and self.autopilot.model_dump() != AutopilotSection().model_dump():
            raise reject("is for `guidance: estimate`", "autopilot")
        return self


class PadApproach(_Approach):
    """Decelerated glide to a hover, and a vertical descent onto a pad. The aircraft keeps its attitude, in any wind."""

    profile: Literal["pad"]
    """glide to a hover and vertical descent onto a pad, at the place of the touchdown point"""
    glide_slope_deg: Annotated[float, Field(ge=1.0, le=80.0)] = 9.0
    """angle of the glide path below the horizontal, to the hover"""
    speed_touchdown_kmh: Annotated[float, Field(ge=0.0, le=0.0)] = 0.0
    """0: the aircraft hovers before it touches down"""
    speed_is: Literal["ground"] = "ground"
    """reference of speeds"""
    angle_of_attack_deg: Annotated[float, Field(ge=-10.0, le=30.0)] = 0.0
    """pitch all the way"""
    pitch: Literal["level"] = "level"
    """level: the nose keeps angle_of_attack_deg above the horizon"""
    guidance: Literal["reference"] = "reference"
    """reference: the route itself steers the aircraft"""
    nose_deg: Azimuth | None = None
    """heading of the nose all the way, clockwise from true north; null: runway.heading_deg"""
    lead_in_s: Stretch = 10.0
    """level flight before the capture of the glide slope"""
    capture_s: Stretch = 4.0
    """duration of the transition onto the slope"""
    hover_height_m: Annotated[float, Field(ge=0.5, le=1000.0)] = 15.0
    """height of the hover above the pad"""
    hover_s: NonNegative = 5.0
    """duration of the hover"""
    sink_m_s: Annotated[float, Field(ge=0.05, le=20.0)] = 1.0
    """rate of the vertical descent; it ends at 0 on the pad"""
    descent_ease_s: Stretch = 2.0
    """time in which the vertical descent begins, and ends"""

    @model_validator(mode="after")
    def _of_the_route(self) -> Self:
        if self.flight_technical_error is not None:
            raise reject("at rest there is no course to be off: leave it out", "flight_technical_error")
        if self.indicator is not None:
            raise reject("the glide path does not lead to the touchdown point: leave it out", "indicator")
        return self

    def path(self) -> Path:
        """Path in the tangent plane of the pad. Raises ValueError if there is none."""
        from navsim.trajectory.approach import Hover, pad_profile

        hover = Hover(self.hover_height_m, self.hover_s, self.sink_m_s, self.descent_ease_s)
        start, slope = self.speed_start_kmh * KMH, self.glide_slope_deg * DEG
        return pad_profile(start, self.start_height_m, slope, self.lead_in_s, self.capture_s, hover)

    def body(self, runway_heading: float) -> np.ndarray:
        """Body axes (3, 3) in those of the path, whose x axis has a heading, rad."""
        import numpy as np

        from navsim.geodesy.attitude import dcm_from_rpy

        nose = 0.0 if self.nose_deg is None else self.nose_deg * DEG - runway_heading
        return dcm_from_rpy(np.array([0.0, self.angle_of_attack_deg * DEG, nose]))


S_TURN_LASTS = 3600.0
"""Turns of `profile: s-turn`, s."""


class STurn(_Approach):
    """Level flight turning right and left, not a landing: for filters to prove themselves in."""

    profile: Literal["s-turn"]
    """level turns to the right and to the left, no landing"""
    turn_rate_deg_s: Annotated[float, Field(ge=1e-3, le=45.0)] = 6.0
    """largest rate of turn"""
    period_s: Stretch = 30.0
    """time of one turn to the right and one to the left"""
    roll_s: Stretch = 2.0
    """time to roll from one side to the other"""

    def path(self, rise: float = 0.0) -> Path:
        """Path in the tangent plane of its first point, an hour long. Raises ValueError if there is none."""
        from navsim.trajectory.approach import s_turn

        return s_turn(
            self.speed_start_kmh * KMH,
            self.start_height_m,
            self.turn_rate_deg_s * DEG,
            self.period_s,
            self.roll_s,
            S_TURN_LASTS,
        )


class GoAroundSection(Section):
    """A landing that is broken off: a pull-up by a load factor, thrust for a constant speed, a climb straight ahead."""

    height_m: Annotated[float, Field(ge=0.1, le=5000.0)] | None = None
    """height above the runway at which it begins during the descent; null: use at_s"""
    at_s: FlightTime | None = None
    """time at which it begins; null: use height_m"""
    on_alarm: bool = False
    """each run goes around after its own first alarm of the integrity monitor, or epoch without a fix, on the glide"""
    delay_s: Annotated[float, Field(ge=0.0, le=60.0)] = 1.0
    """with on_alarm: time from the alarm to the pull-up, of the crew or the autopilot"""
    decision_height_m: NonNegative = 0.0
    """with on_alarm: height above the runway below which an alarm breaks no landing off"""
    load_factor: Annotated[float, Field(ge=1.01, le=5.0)] = 1.2
    """lift by weight in the pull-up; less where easing on and off turns it to the climb already"""
    climb_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 5.0
    """angle of the climb above the horizontal"""
    ease_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    """time in which the load comes on, and off, and thrust takes up the deceleration of the glide"""

    @model_validator(mode="after")
    def _one_begin(self) -> Self:
        if (self.height_m is not None) + (self.at_s is not None) + self.on_alarm != 1:
            raise reject("give exactly one of height_m, at_s and on_alarm: true", "height_m")
        fields = type(self).model_fields
        for key in ("delay_s", "decision_height_m"):
            if not self.on_alarm and getattr(self, key) != fields[key].default:
                raise reject("is for on_alarm: true", key)
        return self

    @property
    def _pull_up(self) -> PullUp:
        from navsim.trajectory.go_around import PullUp

        return PullUp(self.load_factor, self.climb_deg * DEG, self.ease_s)

    def by_alarm(self) -> AlarmGoAround | None:
        """The go-around after an alarm; None if it begins at a height or time."""
        from navsim.trajectory.go_around import AlarmGoAround

        return AlarmGoAround(self._pull_up, self.delay_s, self.decision_height_m) if self.on_alarm else None

    def broken_off(self, path: Path) -> Path:
        """A landing with this go-around, where no alarm decides. Raises NoSuchPath."""
        from navsim.trajectory.go_around import time_at, with_go_around

        if self.on_alarm:
            return path
        at = self.at_s
        if at is None:
            assert self.height_m is not None
            at = time_at(path, self.height_m)
        return with_go_around(path, at, self._pull_up)


class _ToTheGround(_Approach):
    """A landing, that may be broken off."""

    go_around: GoAroundSection | None = None
    """where the landing is broken off; null: it touches down"""

    @model_validator(mode="after")
    def _of_its_own_time(self) -> Self:
        if self.go_around is not None and self.go_around.at_s is not None and self.speed_is == "air":
            raise reject("times follow from the wind where airspeed is held: give height_m", "go_around", "at_s")
        return self

    def _ended(self, path: Path) -> Path:
        return path if self.go_around is None else self.go_around.broken_off(path)


class PaperApproach(_ToTheGround):
    """The paper's profile: uniformly decelerated glide from time 0, then level at the touchdown speed."""

    profile: Literal["paper"]
    """the paper's decelerated glide, then level at the touchdown speed"""
    transition_time_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.5
    """time within which the glide turns into level flight (instantaneous in the paper)"""

    def path(self, rise: float = 0.0) -> Path:
        """Path in the tangent plane of the touchdown point. Raises ValueError if there is none."""
        from navsim.trajectory.approach import paper_profile

        path = paper_profile(
            self.speed_start_kmh * KMH,
            self.speed_touchdown_kmh * KMH,
            self.start_height_m,
            self.glide_slope_deg * DEG,
            self.transition_time_s,
        )
        return self._ended(path)


class _Captured(_ToTheGround):
    """Common part of the approaches from level flight onto the slope, and of their ends."""

    capture_s: Stretch = 6.0
    """duration of the transition onto the slope"""
    flare_height_m: Annotated[float, Field(ge=0.01, le=1000.0)] = 6.0
    """height above the runway at which the flare begins"""
    flare_blend_s: Stretch = 1.0
    """transition from the slope into the exponential flare"""
    touchdown_sink_m_s: Annotated[float, Field(ge=0.001, le=50.0)] = 0.5
    """rate of descent at touchdown"""
    settle_s: Stretch = 1.0
    """time in which the landing gear takes up the sink rate and the brakes come on"""
    rollout_deceleration_m_s2: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """deceleration by the brakes after touchdown"""
    taxi_speed_kmh: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    """ground speed at the end of the roll-out; 0 or null: the brakes stay on until the aircraft stops"""
    taxi_s: Stretch | None = None
    """time at taxi_speed_kmh before the aircraft stops; null: it continues to taxi"""
    brake_ease_s: Stretch = 1.0
    """time in which brakes are let go at taxi_speed_kmh, and come on and off at the stop"""

    def _taxi(self) -> Taxi | None:
        from navsim.trajectory.approach import Taxi

        if self.taxi_speed_kmh is None:
            return None
        return Taxi(self.taxi_speed_kmh * KMH, self.brake_ease_s, self.taxi_s)

    @model_validator(mode="after")
    def _slows(self) -> Self:
        if self.taxi_speed_kmh is None and self.taxi_s is not None:
            raise reject("is for a roll-out that is slowed: give taxi_speed_kmh", "taxi_s")
        if self.taxi_speed_kmh is not None and self.speed_is == "air":
            raise reject("on the ground no airspeed is held: use `speed_is: ground`", "taxi_speed_kmh")
        if self.taxi_speed_kmh == 0.0 and self.taxi_s is not None:
            raise reject("the aircraft has stopped: taxi_speed_kmh is 0", "taxi_s")
        return self

    def stops(self, path: Path, duration: float) -> bool:
        """Whether the brakes stop the aircraft within the flight, s, although no taxi speed is given."""
        import numpy as np

        from navsim.trajectory.approach import TOUCHDOWN

        if self.taxi_speed_kmh is not None or self.speed_is == "air":
            return False
        lands = path.events.get(TOUCHDOWN, math.inf) < duration
        return lands and bool(path.jet(np.array([duration]))[0, 1, 0] < SLOWEST)

    def flared(self, speed: float, height: float, lead_in: float, rise: float) -> Path:
        """Path from level flight at a speed, m/s, and a height, m, for so many seconds; rise: of the runway, m a m."""
        from navsim.trajectory.approach import Ending, smooth_profile

        return smooth_profile(
            speed,
            self.speed_touchdown_kmh * KMH,
            height,
            self.glide_slope_deg * DEG,
            lead_in,
            self.capture_s,
            Ending(
                self.flare_height_m,
                self.flare_blend_s,
                self.touchdown_sink_m_s,
                self.settle_s,
                self.rollout_deceleration_m_s2,
                self._taxi(),
                rise,
            ),
        )


class SmoothApproach(_Captured):
    """A profile an aircraft can fly: level lead-in, capture, decelerated glide, exponential flare, roll-out."""

    profile: Literal["smooth"]
    """one that an aircraft can fly, from level flight to the roll-out"""
    lead_in_s: Stretch = 35.0
    """level flight before the capture of the glide slope"""

    def path(self, rise: float = 0.0) -> Path:
        """Path in the tangent plane of the touchdown point, onto a runway with this rise, m a m. Raises ValueError if
        there is none."""
        return self._ended(self.flared(self.speed_start_kmh * KMH, self.start_height_m, self.lead_in_s, rise))


class WaypointSection(Section):
    """A place that the aircraft flies by, on the runway's axes or by coordinates."""

    along_m: Reach | None = None
    """from the threshold along the direction of landing; before it, negative"""
    right_m: Reach | None = None
    """to the right of the centre line; to the left, negative"""
    lat_deg: Latitude | None = None
    """geodetic latitude, instead of along_m and right_m"""
    lon_deg: Longitude | None = None
    """longitude, east positive"""
    height_m: Annotated[float, Field(ge=0.1, le=5000.0)] | None = None
    """height above the runway; null: approach.start_height_m"""
    speed_kmh: Annotated[float, Field(gt=10.0, le=1000.0)] | None = None
    """ground speed there, kept through the turn; null: approach.speed_start_kmh"""

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
        on_axes, by_coordinates = [self.along_m, self.right_m], [self.lat_deg, self.lon_deg]
        if (None in on_axes) == (None in by_coordinates) or any(
            given != [None, None] for given in (on_axes, by_coordinates) if None in given
        ):
            raise reject("give along_m and right_m, or lat_deg and lon_deg")
        return self


class TrafficCircuitSection(Section):
    """A traffic circuit: downwind, base and final as three waypoints."""

    side: Literal["left", "right"] = "left"
    """on which side of the runway downwind lies; turns go to that side"""
    begin_m: Reach = 0.0
    """where the flight begins on downwind, from the threshold along the direction of landing"""
    offset_m: Annotated[float, Field(ge=10.0, le=1e5)] = 800.0
    """distance of downwind from the centre line"""
    final_m: Annotated[float, Field(ge=10.0, le=1e5)] = 2500.0
    """distance before the threshold of the corners of base with downwind and final"""


class WaypointApproach(_Captured):
    """Legs from waypoint to waypoint with fly-by turns of one bank angle, and a landing at their end."""

    profile: Literal["waypoints"]
    """legs with coordinated turns, by points or as a circuit"""
    points: Annotated[ListOf[WaypointSection], Field(max_length=200)] = ()
    """places that the aircraft flies by, in order; it begins over the first"""
    circuit: TrafficCircuitSection | None = None
    """downwind, base and final, instead of points; null: points"""
    bank_deg: Annotated[float, Field(ge=1.0, le=60.0)] = 25.0
    """bank of the turns; turns too small to roll that far have less"""
    roll_s: Stretch = 3.0
    """time to roll from level into a turn, and out of it"""
    ending: Literal["flare", "paper", "none"] = "flare"
    """flare: capture of the slope, glide, flare, roll-out, as with `profile: smooth`; paper: capture, then as with
    `profile: paper`; none: straight over the last waypoint, no landing"""
    transition_time_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.5
    """with `ending: paper`, time within which the glide turns into level flight"""

    @model_validator(mode="after")
    def _one_list(self) -> Self:
        if (self.circuit is None) == (not self.points):
            raise reject("give exactly one of points and circuit", "points")
        if len(self.points) == 1:
            raise reject("give at least two", "points")
        if self.ending != "flare" and self.taxi_speed_kmh is not None:
            raise reject("is for a roll-out, which comes after `ending: flare`", "taxi_speed_kmh")
        if self.ending == "none" and self.go_around is not None:
            raise reject("there is no landing to break off: use `ending: flare` or `paper`", "go_around")
        return self

    def by_coordinates(self) -> bool:
        """Whether any waypoint is given so."""
        return any(each.lat_deg is not None for each in self.points)

    def placed(self, aim_point: float, seen: Callable[[float, float], tuple[float, float]]) -> list[Waypoint]:
        """The waypoints in the axes of the path. aim_point: of touchdown beyond the threshold, m; seen: x and y of a
        latitude and longitude, rad."""
        from navsim.trajectory.waypoints import Waypoint, circuit

        height, speed = self.start_height_m, self.speed_start_kmh * KMH
        if self.circuit is not None:
            side = -1.0 if self.circuit.side == "left" else 1.0
            begin, final = self.circuit.begin_m - aim_point, -self.circuit.final_m - aim_point
            return circuit(side, begin, self.circuit.offset_m, final, (height, speed))
        out = []
        for each in self.points:
            if each.lat_deg is not None and each.lon_deg is not None:
                x, y = seen(each.lat_deg * DEG, each.lon_deg * DEG)
            else:
                assert each.along_m is not None
                assert each.right_m is not None
                x, y = each.along_m - aim_point, each.right_m
            at = speed if each.speed_kmh is None else each.speed_kmh * KMH
            out.append(Waypoint(x, y, height if each.height_m is None else each.height_m, at))
        return out

    def path(self, way: list[Waypoint], rise: float) -> Path:
        """The path through these waypoints, onto a runway that rises so, m a m. Raises NoSuchPath, another ValueError
        where the landing has none."""
        from navsim.trajectory.approach import captured_paper_profile
        from navsim.trajectory.waypoints import cruise, landing

        bank, last = self.bank_deg * DEG, way[-1]
        if self.ending == "none":
            return cruise(way, bank, self.roll_s)
        if self.ending == "flare":
            path = landing(way, bank, self.roll_s, lambda lead: self.flared(last.speed, last.height, lead, rise))
            return self._ended(path)
        slow, slope = self.speed_touchdown_kmh * KMH, self.glide_slope_deg * DEG
        path = landing(
            way,
            bank,
            self.roll_s,
            lambda lead: captured_paper_profile(
                last.speed, slow, last.height, slope, lead, self.capture_s, self.transition_time_s
            ),
        )
        return self._ended(path)


class FileApproach(Section):
    """A motion that a file has."""

    file: str
    """the file. With `profile: recorded`: a result of a replay, best with smoothing (filter.kind: rts). With `profile:
    track`: a table with the columns t_s, lat_deg, lon_deg, h_m, and optionally roll_deg, pitch_deg, yaw_deg.
    `runway.height_above` is the reference of h_m"""
    file_sha256: Checksum | None = None
    """its checksum; when given, another file is refused"""
    start_s: LogTime | None = None
    """time of the log that becomes time 0; default: the first there is"""
    touchdown_s: LogTime | None = None
    """time of the log at touchdown, for the figures there"""

    @property
    def start(self) -> Point | None:
        """None: the recording has its own start."""
        return None


class RecordedApproach(FileApproach):
    """A real flight, as `navsim replay` found it, with simulated sensors, satellites and pseudolites."""

    profile: Literal["recorded"]
    """a real flight, as `navsim replay` found it"""


class TrackApproach(FileApproach):
    """A recorded or planned trajectory of a table, smoothed."""

    profile: Literal["track"]
    """a recorded or planned trajectory of a table, smoothed"""
    sigma_m: Sigma
    """1 sigma of the places in the table, horizontally, an axis: the curve is as near to them; of a plan, how far it
    may be rounded off"""
    sigma_vertical_m: Sigma | None = None
    """1 sigma of their heights; null: sigma_m"""
    angle_of_attack_deg: Annotated[float, Field(ge=-10.0, le=30.0)] = 3.0
    """constant angle of attack of an aircraft that flies coordinated, where the table has no attitudes"""

    @property
    def sigmas(self) -> tuple[float, float]:
        """Horizontal and vertical, m."""
        return self.sigma_m, self.sigma_m if self.sigma_vertical_m is None else self.sigma_vertical_m
