"""`kind: landing`: a complete landing scenario, and its models.

Source of structure and defaults: `docs/theory/landing.md`. A section is the only declaration of its parameters; the
default of an optional key is there and nowhere else. Sections: `approach`, `sensors`, `sky`, `signals`, `events`,
`terrain`, `interference`, `filter`, `integrity`, `requirements`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from navsim.kinds import KINDS, named
from navsim.scenario.aerodrome import with_published
from navsim.scenario.aiding_sensors import (
    AidingSection,
    AltimeterSection,
    BarometricAltimeterSection,
    FilterAidingSection,
    MagnetometerSection,
    RadioAltimeterSection,
)
from navsim.scenario.air import WindSection, beside
from navsim.scenario.analysable import check_analysable
from navsim.scenario.approach import (
    S_TURN_LASTS,
    FileApproach,
    PadApproach,
    PaperApproach,
    RecordedApproach,
    SmoothApproach,
    STurn,
    TrackApproach,
    WaypointApproach,
)
from navsim.scenario.beacons import BeaconsSection
from navsim.scenario.box import BoxSection
from navsim.scenario.estimated_errors import check_correlated, check_fix_states, check_gains
from navsim.scenario.events import AnyEvent, RangeSection
from navsim.scenario.filter import SMOOTHERS, FilterSection
from navsim.scenario.flyable import check_airspeed, check_speed, checked_path
from navsim.scenario.ground_stations import AzimuthStationSection, DmeSection, ElevationStationSection
from navsim.scenario.idle_keys import idle_keys
from navsim.scenario.imu import Imu, assumed_sensor
from navsim.scenario.initial_errors import InitialErrorsSection
from navsim.scenario.integrity import SMOOTHING_D, IntegritySection
from navsim.scenario.interference import InterferenceSection
from navsim.scenario.pseudolites import PseudolitesSection
from navsim.scenario.requirements import AnyRequirement
from navsim.scenario.runway import Runway
from navsim.scenario.signals import ClockNoise, ReceiverSection, SignalsSection
from navsim.scenario.site_clearance import check_sites
from navsim.scenario.sky import Sky
from navsim.scenario.source_names import check_source_names
from navsim.scenario.terrain import TerrainSection, terrain_of
from navsim.scenario_files.base import DEG, EndTime, KeyedError, ListOf, Section, Utc, Version, reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.gnss.interference.horizon import Terrain
    from navsim.gnss.receiver import Receiver
    from navsim.gnss.signal_errors import Effects
    from navsim.gnss.signals import Pseudolites
    from navsim.scenario_files.source import Document
    from navsim.sensors.aiding import AidingSensor
    from navsim.trajectory.air import Air
    from navsim.trajectory.kinematics import Frame, Trajectory
    from navsim.trajectory.path import AnyPath, Path
    from navsim.trajectory.waypoints import Waypoint


class Landing(Section):
    """A landing: INS corrected by satellites and pseudolites."""

    kind: Literal["landing"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    epoch: Utc
    """UTC of time 0"""
    duration_s: EndTime = 120.0
    """length of the simulation; left out with `profile: recorded`: to the end of the recording"""
    method: Literal["monte-carlo", "covariance", "rare"] = "monte-carlo"
    """monte-carlo: fly the runs; covariance: the same accuracy to first order from matrices, with an error budget;
    rare: the probability that a landing ends outside `box`, however small"""
    runway: Runway = Runway()
    """the runway, and where on it the aircraft touches down"""
    approach: Annotated[
        PaperApproach | SmoothApproach | PadApproach | STurn | WaypointApproach | RecordedApproach | TrackApproach,
        Field(discriminator="profile"),
    ]
    """trajectory of the aircraft, by `profile`"""
    wind: WindSection = WindSection()
    """the mean wind, which turns the nose, gusts and turbulence, which take the aircraft off its route"""
    imu: Imu = Imu()
    """the inertial sensors as they really are"""
    altimeter: AltimeterSection | None = None
    """sensor of height above the ellipsoid; null: none"""
    radio_altimeter: RadioAltimeterSection | None = None
    """sensor of height above the ground; null: none"""
    barometric_altimeter: BarometricAltimeterSection | None = None
    """sensor of height above sea level; null: none"""
    magnetometer: MagnetometerSection | None = None
    """sensor of the magnetic field, which shows the heading; null: none"""
    beacons: BeaconsSection | None = None
    """ranging beacons on the ground; null: none"""
    azimuth_station: AzimuthStationSection | None = None
    """localizer, or azimuth of an MLS; null: none"""
    elevation_station: ElevationStationSection | None = None
    """glide path, or elevation of an MLS; null: none"""
    dme: DmeSection | None = None
    """distance measuring equipment; null: none"""
    initial_errors: InitialErrorsSection = InitialErrorsSection()
    """errors that the navigation starts with"""
    sky: Sky = Sky()
    """where the satellites are, and which of them are received"""
    pseudolites: PseudolitesSection = PseudolitesSection()
    """transmitters on the ground"""
    signals: SignalsSection = SignalsSection()
    """errors of the ranging signals of satellites"""
    events: Annotated[ListOf[AnyEvent], Field(max_length=100)] = ()
    """events that affect signals, with their times"""
    terrain: Annotated[ListOf[TerrainSection], Field(max_length=100)] = ()
    """ridges, skylines, files of heights: satellites, pseudolites, beacons and stations behind them are not received,
    jammers are received more weakly"""
    interference: InterferenceSection | None = None
    """jammers; null: none"""
    receiver: ReceiverSection = ReceiverSection()
    """the satellite receiver: epochs, antenna, clock"""
    filter: FilterSection = FilterSection()
    """filter and its model; omitted keys follow from the truth"""
    box: BoxSection | None = None
    """where the position error has to be at the end of a landing; null: anywhere"""
    integrity: IntegritySection | None = None
    """monitor of the fixes; null: none"""
    requirements: Annotated[ListOf[AnyRequirement], Field(max_length=100)] = ()
    """requirements on the landing: a verdict on each"""

    @classmethod
    def completed(cls, document: Document) -> Any:
        """The data with what it takes from results of replays. Raises InputError."""
        data = document.data
        sections = [data.get(key) for key in ("imu", "signals", "approach")] if isinstance(data, dict) else []
        if not any(isinstance(section, dict) and section.keys() & {"from", "file"} for section in sections):
            return data
        return named(KINDS["landing"].completed)(document)

    @model_validator(mode="before")
    @classmethod
    def _with_published(cls, data: Any) -> Any:
        """Write out numbers derived from the runway's published data."""
        return with_published(data)

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if (self.approach.start is None) == (self.runway.threshold is None):
            raise reject(
                "give exactly one of approach.start and runway.threshold; the other follows from it",
                "approach",
                "start",
            )
        if self.receiver.rate_hz > self.imu.rate_hz:
            raise reject("fixes cannot come faster than the IMU's samples (imu.rate_hz)", "receiver", "rate_hz")
        for sensor in ("gyro", "accelerometer"):
            given = getattr(self.filter.imu, sensor)
            if given is not None:
                assumed_sensor(getattr(self.imu, sensor), given).check(self.imu.rate_hz, "filter", "imu", sensor)
        check_source_names(self)
        self._checked_aiding()
        check_correlated(self)
        if self.signals.system_offset_sigma_ns > 0.0 and not self.receiver.single_clock:
            text = "a receiver with a clock unknown for each system does not notice: for `receiver.single_clock: true`"
            raise reject(text, "signals", "system_offset_sigma_ns")
        for name, value in self.signals.system_offsets_ns.items():
            if value == "broadcast" and self.sky.source != "navigation":
                text = "messages contain it: give `sky: {source: navigation, navigation: [FILE]}`, or a number"
                raise reject(text, "signals", "system_offsets_ns", name)
        if self.signals.troposphere is not None and self.sky.mask_deg <= 0.0:
            raise reject("the troposphere is modelled above the horizon only: must be above 0", "sky", "mask_deg")
        check_fix_states(self)
        for i, ground in enumerate(self.terrain):
            if ground.height_above == "geoid" and self.runway.geoid_undulation_m is None:
                text = "heights above the geoid need the geoid's own above the ellipsoid: give "
                raise reject(f"{text}runway.geoid_undulation_m", "terrain", i, "height_above")
        if self.method != "monte-carlo":
            check_analysable(self)
        if self.method == "rare" and self.box is None:
            raise reject("method rare needs a box; give `box: {lateral_m: ..., vertical_m: ...}`", "box")
        if self.filter.clock is not None and not self.filter.tight:
            raise reject("is for `coupling: tight`: each fix solves for the clock", "filter", "clock")
        if self.integrity is not None:
            try:
                self.integrity.check_names(self.pseudolites.names(), self.ground_names())
            except KeyedError as error:
                raise reject(str(error), "integrity", *error.path) from None
            if self.integrity.method == "filter" and self.integrity.exclusion != "none" and not self.ground_names():
                text = "with method filter it excludes beacons or ground stations, and there is none; use mhss or chi2"
                raise reject(text, "integrity", "exclusion")
            if self.integrity.method == "filter" and self.filter.kind in SMOOTHERS:
                text = f"is for a filter, {self.filter.kind} is a smoother; use mhss or chi2, or another filter.kind"
                raise reject(text, "integrity", "method")
            if self.integrity.method == "filter" and self.receiver.smoothing_s > 0.0:
                text = "smoothed ranges are correlated in time, which levels of the filter are not for; use 0, or mhss"
                raise reject(text, "receiver", "smoothing_s")
            station = None if self.integrity.comparison is None else self.integrity.comparison.gbas
            if station is not None and station.glide_path_deg is None and isinstance(self.approach, FileApproach):
                text = "a recorded flight defines no glide slope: give the angle"
                raise reject(text, "integrity", "comparison", "gbas", "glide_path_deg")
            if station is not None and station.drawn and self.signals.errors.ground_station is None:
                text = "draws B values of signals.errors.ground_station: give it, or receivers, ground_sigma_m and b_m"
                raise reject(text, "integrity", "comparison", "gbas")
            if station is not None and station.approach_service == "D" and self.receiver.smoothing_s != SMOOTHING_D:
                text = f"guides by ranges smoothed over {SMOOTHING_D:g} s: give receiver.smoothing_s: {SMOOTHING_D:g}"
                raise reject(text, "integrity", "comparison", "gbas", "approach_service")
            for i, at in enumerate(() if self.integrity.tails is None else self.integrity.tails.at_s):
                if at > self.duration_s:
                    text = f"is not within duration_s, {self.duration_s:g} s"
                    raise reject(text, "integrity", "tails", "at_s", i)
        if self.interference is not None:
            try:
                self.interference.check_pseudolites(len(self.pseudolites.names()), self.pseudolites.strength_known)
            except KeyedError as error:
                raise reject(str(error), "interference", *error.path) from None
        if self.box is not None and self.box.error != "navigation" and self.air() is None:
            text = "all runs fly the route: give approach.guidance: estimate, approach.flight_technical_error"
            raise reject(f"{text}, wind.turbulence or wind.gusts", "box", "error")
        if getattr(self.approach, "indicator", None) is not None and self.air() is None:
            text = "all runs fly the route: give approach.guidance: estimate, approach.flight_technical_error"
            raise reject(f"{text}, wind.turbulence or wind.gusts", "approach", "indicator")
        if isinstance(self.approach, STurn) and self.approach.indicator is not None:
            raise reject("turns have no glide path to be off: leave it out", "approach", "indicator")
        if self.breaks_off and self.integrity is None:
            text = "there is no monitor that raises alarms: give `integrity`, or height_m"
            raise reject(text, "approach", "go_around", "on_alarm")
        if self.steered and self.filter.kind in SMOOTHERS:
            text = f"{self.filter.kind} is a smoother, with output after the flight; use another filter.kind"
            raise reject(text, "approach", "guidance")
        there = {"": True, "box": self.box is not None, "integrity": self.integrity is not None}
        there["integrity.limits"] = self.integrity is not None and self.integrity.limits is not None
        there["approach.go_around.on_alarm"] = self.breaks_off
        there["approach.indicator"] = getattr(self.approach, "indicator", None) is not None
        for i, requirement in enumerate(self.requirements):
            if not there[requirement.needs]:
                of_limits = requirement.needs == "integrity.limits"
                example = "; for example limits: {operation: LPV-200, tta_s: 6}" if of_limits else ""
                text = f"refers to `{requirement.needs}`, which the scenario does not have{example}"
                raise reject(text, "requirements", i, "what")
        for i, event in enumerate(self.events):
            if event.at_s >= self.duration_s:
                raise reject(f"is not within duration_s, {self.duration_s:g} s", "events", i, "at_s")
            if isinstance(event, RangeSection) and event.reference_receiver is not None:
                serving = self.signals.errors.ground_station
                receivers = 0 if serving is None else serving.receivers
                if event.reference_receiver > receivers:
                    text = f"is none of the {receivers} reference receivers of signals.errors.ground_station"
                    raise reject(text, "events", i, "reference_receiver")
        if isinstance(self.approach, STurn) and self.duration_s > S_TURN_LASTS:
            raise reject(f"turns of `profile: s-turn` last {S_TURN_LASTS:g} s; give no more", "duration_s")
        if self.duration_s * self.imu.rate_hz < 2.0:
            raise reject("shorter than two samples of the IMU", "duration_s")
        if isinstance(self.approach, FileApproach):
            if self.pseudolites.frame == "table1":
                raise reject("the paper's frame needs the paper's approach", "pseudolites", "frame")
            if self.wind.blows and isinstance(self.approach, RecordedApproach):
                raise reject("a recorded flight has had its wind", "wind", "speed_m_s")
            if (air := self.air()) is not None:
                raise reject(f"a recorded flight, or a planned one, is flown as it is{beside(air[1])}", *air[1][0])
            return self
        if isinstance(self.approach, PadApproach | WaypointApproach) and self.pseudolites.frame == "table1":
            raise reject("the paper's frame needs the paper's approach", "pseudolites", "frame")
        by_coordinates = isinstance(self.approach, WaypointApproach) and self.approach.by_coordinates()
        if by_coordinates and self.runway.threshold is None:
            text = "waypoints by coordinates need the runway's: give runway.threshold instead of approach.start"
            raise reject(text, "approach", "points")
        path = checked_path(self)
        check_speed(self, path)
        trajectory = self.trajectory()
        check_airspeed(self, trajectory)
        check_sites(self, trajectory)
        return self

    def _checked_aiding(self) -> None:
        """Check that sensors and states of the filter fit together."""
        for name, section in self.aiding_sections().items():
            if section.rate_hz > self.imu.rate_hz:
                raise reject("cannot be faster than the IMU's samples (imu.rate_hz)", name, "rate_hz")
            if section.rate_hz * (self.duration_s - getattr(section, "latency_s", 0.0)) < 1.0:
                raise reject("measures nothing within duration_s", name, "rate_hz")
        for name, given in self.filter:
            if isinstance(given, FilterAidingSection) and getattr(self, name) is None and given != type(given)():
                raise reject(f"there is none: give `{given.needs}`", "filter", name)
        for section in self.aiding_sections().values():
            section.check(self)
        check_gains(self, "scale_factors", "scale_ppm")
        check_gains(self, "misalignments", "misalignment_mrad")

    @property
    def draws_b_values(self) -> bool:
        """Whether each run draws the B values of a ground station."""
        section = None if self.integrity is None else self.integrity.comparison
        return section is not None and section.gbas is not None and section.gbas.drawn

    # --- models of the sections

    def receiver_model(self) -> Receiver:
        """The receiver, with the clock that it has."""
        return self.receiver.model(ClockNoise() if self.filter.tight else None)

    def slant(self) -> float:
        """Length of the paper's glide path, m: start height over the sine of the slope."""
        assert not isinstance(self.approach, FileApproach)
        return self.approach.start_height_m / math.sin(self.approach.glide_slope_deg * DEG)

    def glide_path(self) -> float:
        """The angle of the glide path that the form of GBAS is given, rad."""
        assert self.integrity is not None
        assert self.integrity.comparison is not None
        station = self.integrity.comparison.gbas
        assert station is not None
        if station.glide_path_deg is not None:
            return station.glide_path_deg * DEG
        assert not isinstance(self.approach, FileApproach)
        return self.approach.glide_slope_deg * DEG

    def effects(self, pseudolites: Pseudolites) -> Effects:
        """Effects on the signals of satellites and of these pseudolites, in propagation and in the receiver."""
        from navsim.geodesy.earth import SPEED_OF_LIGHT
        from navsim.gnss.signal_errors import Effects

        signals, section, tracking = self.signals, self.pseudolites, self.signals.tracking
        space, station, multipath = signals.ephemeris, section.differential, section.multipath
        watched = self.integrity
        return Effects(
            ionosphere=None if signals.ionosphere is None else signals.ionosphere.model(),
            troposphere=None if signals.troposphere is None else signals.troposphere.model(),
            ground_air=None if section.air is None else section.air.model(self.runway.ellipsoidal_m),
            signal_in_space=None if space is None else space.model(),
            correlated=signals.errors.models(),
            reference=None if station is None else station.model(pseudolites),
            loop=tracking.loop(),
            thermal=signals.range_law == "cn0",
            horizon_db=tracking.gain_horizon_db,
            reflection=None
            if multipath is None
            else multipath.model(self.runway.ellipsoidal_m, tracking.gain_horizon_db),
            cn0_reference=section.cn0_reference_m,
            noise_figure=self.receiver.noise_figure_db,
            thermal_pseudolites=section.range_law == "cn0",
            offsets=signals.offsets(),
            offset_sigma=SPEED_OF_LIGHT * signals.system_offset_sigma_ns * 1e-9,
            single_clock=self.receiver.single_clock,
            smoothing=self.receiver.smoothing_s,
            noise_distribution=watched.heavy_tailed.model()
            if watched is not None and watched.error_model == "heavy_tailed"
            else None,
        )

    def unused(self) -> list[str]:
        """Keys without effect, whatever the files contain, as messages."""
        return self.sky.unused() + self.unused_of_flight() + ([] if self.integrity is None else self.integrity.unused())

    def unused_of_flight(self) -> list[str]:
        """Keys without effect of the trajectory, the sensors and the pseudolites."""
        out = self.pseudolites.unused() + self.doubted_heights() + self.wind.unused() + self.imu.unused()
        out += idle_keys(self)
        if self.method == "covariance" and (air := self.air()) is not None:
            out += [f"{'.'.join(key)} changes nothing here: the covariance analysis is of the route" for key in air[1]]
        if self.method == "covariance" and self.beacons is not None and (key := self.beacons.irregular):
            out.append(f"beacons.{key} changes nothing here: the covariance analysis counts every answer")
        out += [] if self.beacons is None else self.beacons.unwatched(self)
        if self.imu.temperature is not None and not self.imu.warms():
            out.append("imu.temperature changes nothing: no sensor has an error that goes with it (temperature_...)")
        if self.pseudolites.differential is not None and self.signals.errors.models():
            out.append(
                "pseudolites.differential does not reduce signals.errors, which are residuals after corrections; give "
                "only one of both, unless the errors are the station's"
            )
        return out

    def doubted_heights(self) -> list[str]:
        """Warnings of pseudolites and beacons whose height above the runway is likely one above something else."""
        out = []
        for section in (self.pseudolites, self.beacons):
            if section is None:
                continue
            name: Literal["pseudolites", "beacons"] = "pseudolites" if section is self.pseudolites else "beacons"
            of_sites = [site.height_m for site in section.sites]
            keys = {f"{name}.sites[{i}].height_m": h for i, h in enumerate(of_sites) if h is not None}
            if None in of_sites or (section is self.pseudolites and section.count):
                keys[f"{name}.height_m"] = section.height_m
            out += [text for key, height in keys.items() if (text := self.runway.doubted_height(key, height, name))]
        return out

    def aiding_sections(self) -> dict[str, AidingSection]:
        """Sections of the sensors beside the receiver that there are, by their names."""
        return {name: section for name, section in self if isinstance(section, AidingSection)}

    def ground_names(self) -> tuple[str, ...]:
        """Names of ranging beacons and ground stations."""
        return tuple(name for section in self.aiding_sections().values() for name in section.names())

    def aiding(self) -> list[AidingSensor]:
        """Models of these sensors."""
        return [section.model(self) for section in self.aiding_sections().values()]

    def _frame_of_threshold(self) -> Frame:
        """The frame at the touchdown point of a runway whose threshold is given."""
        from navsim.trajectory.kinematics import touchdown_from_threshold

        assert self.runway.threshold is not None
        return touchdown_from_threshold(
            self.runway.threshold.radians,
            self.runway.ellipsoidal_m,
            self.runway.heading_deg * DEG,
            self.runway.aim_point_m,
            self.runway.rise_m,
        )

    def path(self) -> AnyPath:
        """Path over ground, in the tangent plane of the touchdown point; recorded approaches are read elsewhere.

        Raises ValueError if there is none, AirError if there is none in this wind.
        """
        from navsim.trajectory.airspeed_path import held_airspeed
        from navsim.trajectory.approach import sloped

        assert not isinstance(self.approach, FileApproach)
        if isinstance(self.approach, PadApproach):
            return self.approach.path()
        path = self._route(self.approach)
        if isinstance(self.approach, SmoothApproach | WaypointApproach) and self.approach.stops(path, self.duration_s):
            path = self._route(self.approach.model_copy(update={"taxi_speed_kmh": 0.0}))
        path = sloped(path, self.runway.rise)
        if self.approach.speed_is == "ground" or not self.wind.blows:
            return path
        wind = self.wind.mean(self.runway.heading_deg * DEG)
        return held_airspeed(path, wind, self.duration_s, self.runway.rise)

    def _route(self, approach: PaperApproach | SmoothApproach | WaypointApproach | STurn) -> Path:
        if isinstance(approach, WaypointApproach):
            return approach.path(self._waypoints(approach), self.runway.rise)
        return approach.path(self.runway.rise)

    def why_no_fix(self) -> str:
        """Warning that no fix reaches the filter of a flight without any, why, and what to write."""
        receiver, duration = self.receiver, f"duration_s, {self.duration_s:g} s"
        interval = 1.0 / receiver.rate_hz
        if interval <= self.duration_s:
            late = f"receiver.latency_s: {receiver.latency_s:g} s after the first fix"
            why, give = f"{late} ({interval:g} s) is not within {duration}", "a shorter latency"
        else:
            why = f"{duration}, is shorter than one fix interval, {interval:g} s (receiver.rate_hz)"
            give = "a higher rate"
        return f"{why}: the filter never gets a fix; give {give}, or a longer duration_s"

    def air(self) -> tuple[Air, tuple[tuple[str, ...], ...]] | None:
        """Disturbances that move runs off the route, and their keys; None if all fly it."""
        wind, technical, autopilot, go_around = self.wind, None, None, None
        if not isinstance(self.approach, FileApproach):
            technical = self.approach.flight_technical_error
            autopilot = self.approach.autopilot.model() if self.approach.guidance == "estimate" else None
            section = getattr(self.approach, "go_around", None)
            go_around = None if section is None else section.by_alarm()
        if technical is None and autopilot is None and go_around is None and not wind.buffets:
            return None
        from navsim.trajectory.air import Air  # only if any of it is present

        mean, response = wind.mean(self.runway.heading_deg * DEG), wind.response.model()
        turbulence = None if wind.turbulence is None else wind.turbulence.model(mean)
        gusts = tuple(gust.model() for gust in wind.gusts)
        acting = {"turbulence": wind.turbulence is not None, "gusts": bool(wind.gusts)}
        keys: tuple[tuple[str, ...], ...] = tuple(("wind", name) for name, acts in acting.items() if acts)
        if go_around is not None:
            keys = ("approach", "go_around", "on_alarm"), *keys
        if autopilot is not None:
            keys = ("approach", "guidance"), *keys
        out = Air(
            response, turbulence=turbulence, gusts=gusts, autopilot=autopilot, go_around=go_around,
            rise=self.runway.rise,
        )  # fmt: skip
        if technical is None:
            return out, keys
        parts = (technical.lateral, technical.along, technical.vertical)
        lateral, along, vertical = (None if part is None else part.model() for part in parts)
        own = replace(response, bank_lag=technical.bank_lag_s)
        keys = ("approach", "flight_technical_error"), *keys
        return replace(out, response=own, lateral=lateral, along=along, vertical=vertical), keys

    @property
    def steered(self) -> bool:
        """Whether aircraft are steered by their estimates."""
        air = self.air()
        return air is not None and air[0].autopilot is not None

    @property
    def breaks_off(self) -> bool:
        """Whether an alarm breaks a run's landing off."""
        air = self.air()
        return air is not None and air[0].go_around is not None

    @property
    def monitored(self) -> bool:
        """Whether runs have a monitor; pushed ones only to break them off."""
        return self.integrity is not None and (self.method != "rare" or self.breaks_off)

    def trajectory_draws(self) -> int:
        """Random numbers at each IMU sample for the trajectory of a run."""
        found = self.air()
        return 0 if found is None else found[0].draws

    def _waypoints(self, approach: WaypointApproach) -> list[Waypoint]:
        """The waypoints in the axes of the touchdown point."""
        import numpy as np

        from navsim.geodesy.earth import ecef_from_llh

        frame = self._frame_of_threshold() if approach.by_coordinates() else None

        def to_plane(lat: float, lon: float) -> tuple[float, float]:
            assert frame is not None
            x, y, _ = (ecef_from_llh(np.array([lat, lon, self.runway.ellipsoidal_m])) - frame.origin) @ frame.axes
            return float(x), float(y)

        return approach.placed(self.runway.aim_point_m, to_plane)

    def trajectory(self) -> Trajectory:
        """The aircraft's motion over the Earth; recorded approaches are read elsewhere."""
        import numpy as np

        from navsim.trajectory.kinematics import touchdown_from_start

        assert not isinstance(self.approach, FileApproach)
        path = self.path()
        if self.approach.start is not None:
            begin, heading = path.jet(np.zeros(1))[0, 0], self.runway.heading_deg * DEG
            height = self.runway.ellipsoidal_m + self.runway.rise_m
            frame = touchdown_from_start(self.approach.start.radians, height, heading, begin)
        else:
            frame = self._frame_of_threshold()
        return self.trajectory_along(path, frame)

    def trajectory_along(self, path: AnyPath, frame: Frame) -> Trajectory:
        """Coordinated flight along a path in the axes of a frame, in the scenario's wind."""
        import numpy as np

        from navsim.trajectory.air import WindAlong
        from navsim.trajectory.approach import FLARE, ROLL_OUT, TOUCHDOWN
        from navsim.trajectory.kinematics import Trajectory, Wind, WindField

        assert not isinstance(self.approach, RecordedApproach)
        heading, events = self.runway.heading_deg * DEG, path.events
        decrab = (events.get(FLARE), events[TOUCHDOWN] if FLARE in events else None)
        wind: WindField
        if self.wind.profile == "constant":
            towards = (self.wind.from_deg + 180.0) * DEG - heading
            speed = self.wind.speed_m_s
            wind = Wind(np.array([speed * math.cos(towards), speed * math.sin(towards), 0.0]), *decrab)
        else:
            wind = WindAlong(self.wind.mean(heading), path, self.duration_s, *decrab, self.runway.rise)
        return Trajectory(
            path,
            frame,
            wind,
            self.approach.angle_of_attack_deg * DEG,
            isinstance(self.approach, TrackApproach) or self.approach.pitch == "path",
            events.get(ROLL_OUT, math.inf),
            self.runway.rise,
            self.approach.body(heading) if isinstance(self.approach, PadApproach) else None,
        )

    def threshold(self, frame: Frame) -> np.ndarray:
        """Threshold of the runway (rad, rad, m) whose touchdown point is the origin of `frame`."""
        import numpy as np

        from navsim.geodesy.earth import llh_from_ecef

        llh = llh_from_ecef(frame.origin - self.runway.aim_point_m * frame.axes[:, 0])
        return np.array([llh[0], llh[1], self.runway.ellipsoidal_m])

    def terrain_around(self, frame: Frame) -> Terrain:
        """Ridges and read files of heights."""
        return terrain_of(self.terrain, self.threshold(frame))

    def pseudolite_positions(self, frame: Frame) -> np.ndarray:
        """Surveyed positions (p, 3), rad, rad, m."""
        import numpy as np

        from navsim.geodesy.earth import wrap_angle
        from navsim.gnss.pseudolite import runway_position, table1_position

        out = np.empty((len(self.pseudolites.placed()), 3))
        for row, site in zip(out, self.pseudolites.placed(), strict=True):
            above = self.pseudolites.height_m if site.height_m is None else site.height_m
            height = self.runway.ellipsoidal_m + above
            if site.lat_deg is not None and site.lon_deg is not None:
                row[:] = site.lat_deg * DEG, wrap_angle(site.lon_deg * DEG), height
                continue
            assert site.s_m is not None
            assert site.l1_m is not None
            if self.pseudolites.frame == "table1":
                assert self.approach.start is not None
                row[:2] = table1_position(np.array(self.approach.start.radians), self.slant(), site.s_m, site.l1_m)
                row[2] = height
            else:
                heading = self.runway.heading_deg * DEG
                row[:] = runway_position(self.threshold(frame), heading, site.s_m, site.l1_m, above)
        return out
