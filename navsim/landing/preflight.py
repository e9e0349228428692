"""Checks of a landing before the simulation: warnings about the input, and errors.

Nothing here is compiled, so that `navsim validate` reports it, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from navsim.geodesy.earth import ecef_from_llh, in_heading_axes
from navsim.gnss.constellations.systems import CLOCKS, first_time_scale
from navsim.gnss.events import EVERY
from navsim.gnss.interference.horizon import Terrain, flown_under
from navsim.landing.clock_gain import clock_gain_warnings
from navsim.landing.plausibility import one_direction, plausibility_warnings
from navsim.scenario.approach import FileApproach
from navsim.scenario.box import BoxSection
from navsim.scenario.events import EventSection
from navsim.scenario.integrity import IntegritySection
from navsim.scenario.landing import Landing
from navsim.scenario.requirements import INTEGRITY, PresetRequirement
from navsim.scenario.site_clearance import check_sites
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario_files.base import DEG, KeyedError
from navsim.scenario_files.presets import IMU_SHEETS
from navsim.scenario_files.source import Document, InputError, Problem, dotted
from navsim.statistics.rounding import digits
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.go_around import GO_AROUND
from navsim.trajectory.kinematics import Motion, Moving

if TYPE_CHECKING:
    from navsim.gnss.pseudorange import Signals
    from navsim.gnss.signals import SignalScenario

_USUAL_MASK = 20.0
"""Mask up to which the sky of a whole satellite system leaves enough sources for a fix, deg."""
_ROUGH = 50
_STEP = 0.2
"""Interval between positions that are compared with ridges, s."""
OFF_GROUND = 0.5
"""Height at touchdown, m, up to which an aircraft has come down: blends at a corner leave as much."""
_MISPLACED = 5.0
"""Height of a flight of a file at its touchdown, m, beyond which that is doubted."""
_TURNED, _SLOW = 20.0, 2.0
"""Angle between runway and course, deg, that is doubted at more than this speed, m/s."""
_LOOKS = 200
"""Times at which the heights of such a flight are looked at."""
FOLLOW = "leave `clock` out, which takes the time scale of the satellites,"
"""Advice for a time scale that no satellite has."""
MISPRINT = 1.0
"""Difference of a published direction of a runway from that between its thresholds that is warned of, deg."""
_FAR_STATION, _HIGH_STATION = 10e3, 30.0
"""Distance from the runway and height above it beyond which the place of an angle's antenna is doubted, m."""


@dataclass(frozen=True)
class PreflightChecks:
    """A landing before it is flown. signals: at all its fixes. outputs: times of the filter's, the first at 0, s."""

    scenario: Landing
    trajectory: Moving
    environment: SignalScenario
    signals: Signals
    outputs: np.ndarray

    @property
    def warnings(self) -> list[str]:
        """Warnings about the input besides the sky: no touchdown, a box before any fix, sources that are never
        tracked."""
        out = trajectory_warnings(self.scenario, self.trajectory)
        out += clock_gain_warnings(self.scenario, self.trajectory, self.signals)
        if self.scenario.box is not None and (self.outputs[1:2] > (when := self.box_time)).any():
            out.append(
                f"box.height_m: {self.scenario.box.height_m:g} m above the runway are passed at {when:.2f} s, before "
                "the first fix: the errors there are those that the filter begins with"
            )
        if self.scenario.box is not None and (apart := self._route_outside(self.scenario.box)):
            where = f": it is then {self.box_place:.0f} m beyond the threshold" * ("from_threshold_m" in apart)
            out.append(f"box: the route itself is outside {' and '.join(apart)}{where}")
        hidden = self.environment.behind_terrain(self.signals.antenna)
        out += _out_of_sight(self.environment, self.signals.antenna) + self._under_horizon()
        out += self._shadowed() + self._jammed() + self.lone_pseudolite + self._corrections()
        out += _hidden_throughout(self.environment.pseudolites.names, hidden)
        if (section := self.scenario.integrity) is not None:
            out += section.unused(self.environment.systems)
            out += [
                f"requirements[{i}]: continuity and hazardously misleading information are counted by "
                f"integrity.limits, which are not those of {each.operation}: undecided; give limits: "
                f"{{operation: {each.operation}, tta_s: ...}}"
                for i, each in enumerate(self.scenario.requirements)
                if isinstance(each, PresetRequirement) and not each.counts_by(section.limits)
            ]
            out += [
                f"requirements[{i}]: levels are not those of {each.operation}, which allows a risk of {INTEGRITY:g} an "
                f"approach: {self._risk_of_levels(section)}"
                for i, each in enumerate(self.scenario.requirements)
                if isinstance(each, PresetRequirement) and not each.levels_are_its_own(section)
            ]
        out += [
            f"events[{i}]: {event.what} of {', '.join(event.sources)}: none of them is received then"
            for i, event in enumerate(self.scenario.events)
            if event.what != "silence" and not self._received(event)
        ]
        if (jamming := self.environment.jamming) is not None:
            heard = np.isfinite(self.signals.js).any(axis=(1, 2))
            out += [
                f"interference.jammers[{j}]: {jammer.name} is never received: it is off, or beyond the radio horizon"
                for j, jammer in enumerate(jamming.jammers)
                if not heard[j] and self.scenario.beacons is None  # which it may jam when no satellite is received
            ]
            stopped = [*itertools.compress(self.environment.names, ~jamming.passed(self.environment.carriers))]
            if stopped:
                text = f"no band has the carriers of {', '.join(stopped)}: they are not received"
                out.append(f"interference.front_end_mhz: {text}")
        return out

    def _under_horizon(self) -> list[str]:
        """Warning of a mask below the horizon."""
        lowest = math.degrees(float(self.environment.horizon_of(self.signals.antenna).min(initial=0.0)))
        if not (mask := self.scenario.sky.mask_deg) < lowest:
            return []
        return [
            f"sky.mask_deg: {mask:g} deg is below the horizon, which is at {lowest:.2f} deg at lowest: satellites "
            "below the horizon are not received; give 0 or more"
        ]

    def _corrections(self) -> list[str]:
        """Warnings of corrections that do not arrive, and of those that arrive although nobody sends them."""
        station, age = self.environment.effects.reference, self.signals.correction_age
        if station is None or age is None:
            return []
        if station.link is None:
            silent = ~self.signals.used[:, -len(self.environment.pseudolites.names) :].any(axis=1)
            text = (
                f"pseudolites.differential: corrections arrive at {silent.sum()} of {age.size} fixes at which no "
                "pseudolite is received; if pseudolites send them, add `link: {}`"
            )
            return [text] if silent.any() else []
        without = np.isinf(age)
        text = (
            f"pseudolites.differential.link: {without.sum()} of {age.size} fixes have no corrections younger than "
            f"{station.link.oldest:g} s (max_age_s), and the whole errors of the satellites; those of "
            f"signals.ephemeris are in no sigma; senders: {', '.join(station.link.senders)}"
        )
        out = [text] if without.any() else []
        if self.signals.losses is not None and self.scenario.method == "covariance":
            text = "pseudolites.differential.link.loss: the covariance analysis has one example of lost messages; runs "
            out.append(text + "of method monte-carlo lose each its own")
        return out

    @cached_property
    def lone_pseudolite(self) -> list[str]:
        """Warnings of a pseudolite that is the only source on its time scale."""
        from navsim.gnss.signals import find_lone_pseudolite

        times = int(find_lone_pseudolite(self.signals, len(self.environment.pseudolites.names)).sum())
        if not times:
            return []
        clock = CLOCKS[self.environment.pseudolites.time_scale]
        others = {CLOCKS[c] for c in self.signals.time_scale[self.signals.used.any(axis=0)]} - {clock}
        when, instead = f"at {times} of {self.signals.time.size} fixes", f"give `clock: {first_time_scale(others)}`"
        return [lone_pseudolite_warning(clock, when, instead)]

    @staticmethod
    def _risk_of_levels(section: IntegritySection) -> str:
        if section.method == "chi2":
            return "integrity.method chi2 computes them for a fault that is there (p_md); mhss does for a risk"
        risk = section.risk_of_levels()
        return f"integrity.p_hmi_v, p_hmi_h and p_unmonitored_max allow {digits(risk)}"

    def _route_outside(self, box: BoxSection) -> list[str]:
        """The limits of the box that an error of 0 is beyond."""
        lower, upper = box.limits(self.box_place)
        keys = ("lateral_m", "along_m" if box.from_threshold_m is None else "from_threshold_m", "vertical_m")
        return [key for key, low, high in zip(keys, lower, upper, strict=True) if not low <= 0.0 <= high]

    @cached_property
    def shadowed(self) -> np.ndarray:
        """Fixes and sources (e, s) bool hidden by the aircraft, see `SignalScenario.shadowed`."""
        return self.environment.shadowed(self.signals, self.trajectory.motion(self.signals.time).c_eb)

    def _by_name(self, lost: np.ndarray) -> tuple[list[str], str]:
        """Number of fixes at which sources (e, s) bool are lost, as text: each pseudolite, all satellites together, ""
        for none."""
        counts = zip(self.signals.names, lost.sum(axis=0).tolist(), strict=True)
        shown = [(name, f"{name} at {times}") for name, times in counts if times]
        ground, of = self.environment.pseudolites.names, f"of {self.signals.time.size} fixes"
        satellites = ", ".join(text for name, text in shown if name not in ground)
        return [f"{text} {of}" for name, text in shown if name in ground], satellites and f"{satellites} {of}"

    def _shadowed(self) -> list[str]:
        """Sources that the aircraft hides, by name."""
        pseudolites, satellites = self._by_name(self.shadowed)
        return [f"receiver.antenna: the aircraft shadows {text}" for text in (*pseudolites, satellites) if text]

    def _jammed(self) -> list[str]:
        """Sources that are lost since pseudolites jam, and would not be else, by name."""
        jamming, signals = self.environment.jamming, self.signals
        if jamming is None or jamming.pseudolites is None:
            return []
        if not (~np.isnan(signals.js).all(axis=0) & ~signals.used).any():  # nothing that arrives is lost
            return []
        from navsim.gnss.signals import build_signals

        quiet = replace(self.environment, jamming=replace(jamming, pseudolites=None))
        motion = self.trajectory.motion(signals.time)
        without = build_signals(motion, self.scenario.epoch.timestamp(), quiet)
        same = [without.names.index(name) for name in signals.names]  # of a search: without those that are never heard
        pseudolites, satellites = self._by_name(without.used[:, same] & ~signals.used)
        by = "interference.pseudolites: jammed by pseudolites"
        return [f"{by}: {text}" for text in (*pseudolites, satellites) if text]

    def _received(self, event: EventSection) -> bool:
        """Whether any source of an event is received while it lasts."""
        signals, model = self.signals, event.model()
        correlated = (signals.time >= model.begin) & (signals.time < model.end)
        concerned = model.concerns(signals.names, self.environment.systems_of(signals.names))
        return bool(signals.used[np.ix_(correlated, concerned)].any()) or self._answered(event)

    def _answered(self, event: EventSection) -> bool:
        """Whether any beacon of an event answers while it lasts."""
        from navsim.landing.beacons import beacon_geometry

        if (section := self.scenario.beacons) is None or not {"beacons", *section.names()} & set(event.sources):
            return False
        seen, model = beacon_geometry(section.model(self.scenario), self.trajectory, self.signals.time), event.model()
        lasting = (self.signals.time >= model.begin) & (self.signals.time < model.end)
        concerned = model.concerns(section.names(), ["beacons"] * len(section.names()))
        return bool(seen.received[np.ix_(lasting, concerned)].any())

    def times_at_heights(self, heights: Sequence[float]) -> list[float]:
        """`descent_times`, with nan for times after the filter's last output."""
        last = self.outputs[-1] + 1e-9
        return [when if when <= last else math.nan for when in descent_times(self.scenario, self.trajectory, heights)]

    @cached_property
    def box_time(self) -> float:
        """Time when the route passes the height of the scenario's box, s; nan if it does not."""
        assert self.scenario.box is not None
        return self.times_at_heights([self.scenario.box.height_m])[0]

    @property
    def box_place(self) -> float:
        """Position of the route then, along the runway from the threshold, m."""
        along = self.trajectory.path.jet(np.array([self.box_time]))[0, 0, 0]
        return float(along) + self.scenario.runway.aim_point_m

    def check(self, document: Document) -> None:
        """Raise InputError for a box that is never passed, for more noise of a station than ranges have."""
        self._check_box(document)
        self._check_ground(document)

    def _check_box(self, document: Document) -> None:
        box = self.scenario.box
        if box is None or not math.isnan(self.box_time):
            return
        (when,), last = descent_times(self.scenario, self.trajectory, [box.height_m]), float(self.outputs[-1])
        what = f"comes down through {box.height_m:g} m above the runway" if box.height_m else "touches down"
        after = f"the aircraft {what} at {when:.2f} s, after the filter's last output at {last:g} s"
        text = f"the aircraft never {what} within duration_s" if math.isnan(when) else after
        raise InputError([Problem(document.place(("box", "height_m")), "box.height_m", text)])

    def _check_ground(self, document: Document) -> None:
        """Check that the ground reflection is only a part of a range."""
        section, signals = self.scenario.integrity, self.signals
        station = None if section is None or section.comparison is None else section.comparison.gbas
        if station is None or station.ground_sigma_m is None or not signals.used.any():
            return
        least = float(signals.fix_sigma[signals.used].min())
        if station.ground_sigma_m > least:
            path = ("integrity", "comparison", "gbas", "ground_sigma_m")
            text = f"is a part of each range's sigma, of which the least is {digits(least)} m: at most that"
            raise InputError([Problem(document.place(path), dotted(path), text)])


def lone_pseudolite_warning(clock: str, when: str, instead: str) -> str:
    """Warning about a pseudolite that is the only source of its time scale.

    when: how often. instead: what to write.
    """
    return (
        f"pseudolites.clock: one pseudolite is the only source on the time scale `{clock}` {when}. Its range "
        "determines that clock and nothing else, so positions of fixes and DOPs are those without it; "
        f"{instead} if it is synchronised to the satellites, or add a second pseudolite"
    )


def _misplaced(scenario: Landing, trajectory: Moving, touchdown: float) -> list[str]:
    """Warning where a flight of a file is not on the runway at its touchdown, s, or flies in another direction."""
    place, velocity = trajectory.path.jet(np.array([touchdown]))[0, :2]  # along the runway, right, down
    runway, height = scenario.runway, -float(place[2])
    distance, speed = float(np.hypot(*place[:2])), float(np.hypot(*velocity[:2]))
    turned = math.degrees(math.atan2(velocity[1], velocity[0]))
    if runway.threshold is not None and distance > runway.length_m:
        said = f"{digits(1e-3 * distance, 3)} km from the runway's touchdown point (runway.threshold)"
    elif abs(height) > _MISPLACED:
        said = f"{abs(height):.1f} m {'above' if height > 0.0 else 'below'} the runway"
    elif speed > _SLOW and abs(turned) > _TURNED:
        towards = f"{(runway.heading_deg + turned) % 360.0:.0f}"
        said = f"flying towards {towards} deg, runway.heading_deg is {runway.heading_deg:g},"
    else:
        return []
    return [f"approach.touchdown_s: the aircraft is {said} then; figures at touchdown are of there"]


def trajectory_warnings(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warnings about the trajectory, and about sections that need no sources of signals."""
    out = scenario.runway.defaulted
    touchdown = trajectory.path.events.get(TOUCHDOWN, -math.inf)
    if touchdown > scenario.duration_s:
        out.append(
            f"touchdown would be at {touchdown:.1f} s, after the end of the simulation "
            f"(duration_s: {scenario.duration_s:g}); figures at touchdown are not defined"
            + (", and requirements judge the part of the glide that is flown" if scenario.requirements else "")
        )
    elif isinstance(scenario.approach, FileApproach) and math.isfinite(touchdown):
        misplaced = _misplaced(scenario, trajectory, touchdown)
        out += misplaced
        if not misplaced and (scenario.beacons is not None or scenario.pseudolites.count or scenario.pseudolites.sites):
            out += _never_down(scenario, trajectory, touchdown)
    if abs(off := scenario.runway.misprint_deg) > MISPRINT:
        side = "right" if off > 0.0 else "left"
        out.append(
            f"runway.bearing_deg: the published direction is {abs(off):.1f} deg {side} of that between the "
            f"thresholds, {scenario.runway.heading_deg:.2f} deg, which is flown"
        )
    out += _gains_passed_over(scenario)
    if (broken_off := trajectory.path.events.get(GO_AROUND, math.inf)) <= scenario.duration_s:
        out.append(
            f"the go-around begins at {broken_off:.1f} s (approach.go_around): there is no touchdown; figures "
            "there are not defined, and those of the last seconds before it are of the end of the simulation"
        )
    out += plausibility_warnings(scenario, trajectory) + one_direction(scenario, trajectory)
    if scenario.beacons is not None:
        from navsim.environment.sources import on_glide
        from navsim.landing.beacons import beacon_geometry, beacon_warnings

        time = scenario.receiver.model().epochs(scenario.duration_s, scenario.imu.rate_hz)
        geometry = beacon_geometry(scenario.beacons.model(scenario), trajectory, time)
        out += beacon_warnings(geometry, on_glide(scenario, trajectory, time))
    out += station_warnings(scenario, trajectory)
    return out + on_pavement(scenario, trajectory) + through_ridges(scenario, trajectory)


def _never_down(scenario: Landing, trajectory: Moving, touchdown: float) -> list[str]:
    """Warning of a runway at the height of a flight of a file that does not come down to it, or that goes below it."""
    height = scenario.runway.ellipsoidal_m
    before, flown = (
        trajectory.motion(np.linspace(0.0, last, _LOOKS)).llh[:, 2] - height
        for last in (touchdown, scenario.duration_s)
    )
    if before.max() <= _MISPLACED:
        why = f"stays within {_MISPLACED:g} m above the runway until touchdown"
    elif flown.min() < -_MISPLACED:
        why = f"passes {-flown.min():.0f} m below the runway"
    else:
        return []
    return [
        f"approach.touchdown_s: the flight {why}, so the runway is perhaps in the air. Heights of beacons and "
        "pseudolites count from the runway: give the ground's as runway.height_m"
    ]


def station_warnings(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warnings about ground stations: outages outside the flight, places, a path outside the coverage."""
    from navsim.environment.sources import touchdown_time
    from navsim.filter.measurement_kinds import AZIMUTH, DISTANCE, ELEVATION
    from navsim.scenario.ground_stations import ElevationStationSection, StationSection

    out, end = [], touchdown_time(scenario, trajectory)
    for name, section in scenario.aiding_sections().items():
        if not isinstance(section, StationSection):
            continue
        model, last = section.model(scenario), scenario.duration_s
        out += [
            f"{name}.{key}[{i}]: the {what} begins at {start:g} s, after the end of the flight at {last:g} s"
            for key, what, times in (
                ("off_s", "outage", [start for start, _ in section.off_s]),
                ("faults", "fault", [fault.at_s for fault in section.faults]),
            )
            for i, start in enumerate(times)
            if start >= last
        ]
        time = np.arange(1, 1 + math.floor(end * section.rate_hz)) / section.rate_hz
        if not time.size:
            continue
        off = (time[:, None] >= model.off[:, 0]) & (time[:, None] < model.off[:, 1])
        if off.any(axis=1).all():
            out.append(f"{name}.off_s: the station is off until touchdown and measures nothing")
        if (lost := float(model.hidden(trajectory, time).mean())) > 0.0:
            out.append(f"{name}: terrain hides the antenna for {100 * lost:.0f} % of the time before touchdown")
        if model.kind == DISTANCE:
            continue
        along, right, _ = model.place
        extent = scenario.runway.extent_m
        if not -_FAR_STATION < along < extent + _FAR_STATION or abs(right) > _FAR_STATION:
            out.append(f"{name}: the antenna stands {along:g} m beyond the threshold and {right:g} m right of the "
                       f"centre line, more than {_FAR_STATION:g} m off the runway")  # fmt: skip
        if model.kind == AZIMUTH and along < extent:
            out.append(f"{name}.beyond_m: the antenna stands on the runway, which ends {extent:g} m beyond the "
                       "threshold: behind it the aircraft measures nothing")  # fmt: skip
        if section.height_m > _HIGH_STATION:
            out.append(f"{name}.height_m: the antenna stands {section.height_m:g} m above the runway")
        angle, ahead = model.geometry(trajectory, time)
        if (passed := float(1.0 - ahead.mean())) > 0.5:
            out.append(f"{name}.beyond_m: the aircraft is behind the antenna for {100 * passed:.0f} % of the time "
                       "before touchdown and measures nothing there")  # fmt: skip
            continue
        outside = ahead & ((angle < model.limits[0]) | (angle > model.limits[1]))
        if (share := float(outside.mean())) > 0.5:
            low, high = np.degrees(np.percentile(angle[ahead], (5, 95)))
            keys = "low_deg and high_deg" if model.kind == ELEVATION else "half_width_m"
            its_preset = isinstance(section, ElevationStationSection) and section.preset == "ils"
            of = [math.degrees(limit) for limit in model.limits]
            out.append(f"{name}: before touchdown the path is outside its sector, {of[0]:.2f} to {of[1]:.2f} deg, for "
                       f"{100 * share:.0f} % of the time: it is mostly at {low:.2f} to {high:.2f} deg; set {keys}"
                       + (", the preset's are for a path of 3 deg" if its_preset else ""))  # fmt: skip
    return out


def on_pavement(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warnings about pseudolites and beacons on the runway."""
    runway, frame = scenario.runway, trajectory.frame
    placed = [("pseudolites", scenario.pseudolites.names(), scenario.pseudolite_positions(frame))]
    if scenario.beacons is not None:
        beacons = scenario.beacons.model(scenario)
        placed.append(("beacons", beacons.names, beacons.positions(frame)))
    out = []
    for what, names, llh in placed:
        at = in_heading_axes(ecef_from_llh(llh), scenario.threshold(frame), runway.heading_deg * DEG)[:, :2].tolist()
        out += runway.on_pavement(what, ((name, *place) for name, place in zip(names, at, strict=True)))
    return out


def through_ridges(scenario: Landing, trajectory: Moving) -> list[str]:
    """Warning about ridges that the aircraft flies through, below their tops."""
    ridges = [(i, each) for i, each in enumerate(scenario.terrain) if each.file is None]
    if not ridges:
        return []
    time = np.linspace(0.0, scenario.duration_s, max(2, math.ceil(scenario.duration_s / _STEP)))
    path, threshold = trajectory.motion(time).position_ecef, scenario.threshold(trajectory.frame)
    out = []
    for i, ridge in ridges:
        under = flown_under(ridge.tops(threshold), path)
        if np.isfinite(under).any():
            k = int(np.argmax(under))
            out.append(
                f"terrain[{i}]: the flight goes through this ridge at {time[k]:.1f} s, {under[k]:.1f} m under its top; "
                "no aircraft does"
            )
    return out


def _gains_passed_over(scenario: Landing) -> list[str]:
    """Warnings about gains of the inertial sensors that the scenario removes from the filter model."""
    imu, its = scenario.imu, scenario.filter
    gains = (
        ("scale_ppm", "scale factors", "scale_factors"), ("misalignment_mrad", "misalignments", "misalignments"),
    )  # fmt: skip
    there = [
        (name, f"filter.{key}: true", keys)
        for error, name, key in gains
        if getattr(its, key) is False
        and (keys := [f"imu.{s}.{error}" for s in ("gyro", "accelerometer") if getattr(getattr(imu, s), error)])
    ]
    if not there:
        return []
    names, cures = (" and ".join(words) for words in zip(*((name, cure) for name, cure, _ in there), strict=True))
    told = f"which the filter model lacks: give {cures}"
    if imu.preset in IMU_SHEETS:
        return [f"imu.preset: {imu.preset} has {names}, {told}"]
    return [f"{', '.join(key for *_, keys in there for key in keys)}: the sensors have {names}, {told}"]


def _out_of_sight(environment: SignalScenario, antenna: np.ndarray) -> list[str]:
    """Warnings of pseudolites that the curvature of the Earth hides from an antenna (e, 3), ECEF, m, at fixes."""
    beyond, pseudolites = environment.beyond_horizon(antenna), environment.pseudolites
    away = np.linalg.norm(ecef_from_llh(pseudolites.llh) - antenna[:, None], axis=2)
    out = []
    for name, hidden, far in zip(pseudolites.names, beyond.T, away.T, strict=True):
        if hidden.any():
            when = "the whole flight" if hidden.all() else f"{hidden.sum()} of {hidden.size} fixes"
            nearest = f"{name} is {digits(far[hidden].min() / 1000.0)} km away or more"
            out.append(
                f"pseudolites: {nearest}, beyond the radio horizon of {when}, and not received then; give it a "
                "position nearer by or a higher antenna"
            )
    return out


def build_environment(scenario: Landing, document: Document) -> tuple[Moving, SignalScenario, Landing, list[str]]:
    """Trajectory, sources of signals, the scenario with the checksums of its files, and warnings about its sky.

    Raises InputError for unusable files, and for pseudolites in the way of the aircraft.
    """
    from navsim.environment.sources import environment, trajectory_of

    trajectory, scenario = trajectory_of(scenario, document)
    if isinstance(scenario.approach, FileApproach):  # of others the scenario itself knows the track
        try:
            check_sites(scenario, trajectory)
        except KeyedError as error:
            raise InputError([Problem(document.place(error.path), dotted(error.path), str(error))]) from None
    return trajectory, *environment(scenario, document, trajectory)


def _needs_sources(scenario: Landing) -> bool:
    """Whether files must be read, or warnings depend on the sources of signals."""
    sky = scenario.sky
    sections = (
        sky.source in SOURCES_FROM_FILES, sky.systems, sky.exclude, sky.horizon, scenario.terrain, scenario.box,
        scenario.events, scenario.integrity, scenario.interference, scenario.receiver.antenna,
        scenario.signals.system_offsets_ns, scenario.pseudolites.placed(), not 0.0 <= sky.mask_deg <= _USUAL_MASK,
    )  # fmt: skip
    return isinstance(scenario.approach, FileApproach) or any(sections)


def fix_warnings(scenario: Landing, environment: SignalScenario, trajectory: Moving, more: int = 0) -> list[str]:
    """Warning about a flight without fix epochs, or about fix epochs with too few sources.

    more: number of pseudolites that a study adds, and whose positions it does not know yet.
    """
    from navsim.gnss.signals import build_signals

    times = scenario.receiver_model().epochs(scenario.duration_s, scenario.imu.rate_hz)
    if not times.size:
        return [scenario.why_no_fix()]
    motion = trajectory.motion(times)
    signals = build_signals(motion, scenario.epoch.timestamp(), environment)
    return _without_fix(scenario, environment, signals, motion, more)


def _too_few(signals: Signals, tight: bool, more: int) -> np.ndarray:
    """Fix epochs (e,) bool with fewer sources than a fix has unknowns: three of position, one for each clock; tightly
    coupled, with none. more: further sources, on the clock of the others."""
    clocks = [len(set(signals.time_scale[used].tolist())) for used in signals.used]
    return np.asarray(signals.used.sum(axis=1) + more < (1 if tight else 3 + np.maximum(clocks, 1)))


def _without_fix(
    scenario: Landing, environment: SignalScenario, signals: Signals, motion: Motion, more: int = 0
) -> list[str]:
    """Warning about fix epochs with too few sources, and what takes them."""
    tight = scenario.filter.tight
    short = _too_few(signals, tight, more)
    if not short.any():
        return []
    from navsim.gnss.signals import build_signals
    from navsim.results.findings import several

    if short.all() and _lands_by_stations(scenario):
        return []
    time = signals.time[short]
    silent = [
        f"events[{i}] (silence from {its.begin:g} s on)"
        for i, event in enumerate(scenario.events)
        if event.what == "silence" and ((time >= (its := event.model()).begin) & (time < its.end)).any()
    ]
    environments = {
        " and ".join(silent): replace(environment, events=()),
        "interference": replace(environment, jamming=None),
        "terrain": replace(environment, terrain=Terrain()),
        "receiver.antenna": replace(environment, antenna=None),
    }
    causes, remain = [], short
    for key, without in environments.items():
        left = _too_few(build_signals(motion, scenario.epoch.timestamp(), without), tight, more)
        if (taken := int((short & ~left).sum())) and key:
            causes.append(f"without {key} there are enough at {taken} of these epochs")
        remain = remain & left
    if remain.any():
        causes.append("lower sky.mask_deg, or add satellite systems or pseudolites")
    many = int(signals.used.sum(axis=1)[short].max()) + more
    received = f"at most {several(many, 'source')} received" if many else "no source is received"
    what, needs = ("pseudorange", "") if tight else ("fix", ". A fix needs four, and one more for each further clock")
    return [
        f"{short.sum()} of {short.size} epochs without a {what}: too few usable sources, the first at {time[0]:.1f} s: "
        f"{received}{needs}; {'; '.join(causes)}"
    ]


def _lands_by_stations(scenario: Landing) -> bool:
    """Whether it has an azimuth and an elevation, and an event silences all satellites and pseudolites throughout."""
    if scenario.azimuth_station is None or scenario.elevation_station is None:
        return False
    throughout = (each for each in scenario.events if each.at_s == 0.0 and each.until_s is None)
    return any(each.what == "silence" and EVERY in each.sources for each in throughout)


def warnings_of(scenario: Landing, document: Document) -> list[str]:
    """Warnings about a landing before its preparation, except about measurements of sensors beside the receiver.

    Raises the InputErrors of the preparation.
    """
    receiver = scenario.receiver_model()
    fixes = receiver.epochs(scenario.duration_s, scenario.imu.rate_hz)
    none = [] if fixes.size else [scenario.why_no_fix()]
    if not _needs_sources(scenario):
        return [*scenario.unused(), *trajectory_warnings(scenario, scenario.trajectory()), *none]
    from navsim.gnss.signals import build_signals

    trajectory, sources, scenario, warnings = build_environment(scenario, document)
    motion = trajectory.motion(fixes)
    signals = build_signals(motion, scenario.epoch.timestamp(), sources)
    outputs = np.concatenate([[0.0], fixes + receiver.latency])
    ahead = PreflightChecks(scenario, trajectory, sources, signals, outputs)
    ahead.check(document)
    return [*warnings, *ahead.warnings, *none, *_without_fix(scenario, sources, signals, motion)]


def descent_times(scenario: Landing, trajectory: Moving, heights: Sequence[float]) -> list[float]:
    """Last times of descent through these heights above the runway, m, 0 for touchdown, s; nan if not within the
    flight."""
    path = trajectory.path
    touchdown = path.events.get(TOUCHDOWN, math.inf)
    fine = np.arange(0.0, min(touchdown, scenario.duration_s), 1e-3)
    climbing = fine >= path.events.get(GO_AROUND, math.inf)
    if climbing.any():  # to the bottom of the pull-up: later heights are not passed in a descent
        fine = fine[: int(np.argmax(climbing)) + int(np.argmin(-path.jet(fine[climbing])[:, 0, 2])) + 1]
    # search the last time above a height among every 50th, then among those that follow it
    rough = -path.jet(fine[::_ROUGH])[:, 0, 2]
    down = -float(path.jet(np.array([touchdown]))[0, 0, 2]) if math.isfinite(touchdown) else math.inf
    times = []
    for height in heights:
        last = np.flatnonzero(rough >= height)[-1:] * _ROUGH
        near = fine[int(last[0]) : int(last[0]) + _ROUGH + 1] if last.size else fine[:0]
        above = near[-path.jet(near)[:, 0, 2] >= height]
        if height == 0.0:
            when = touchdown  # unless the flight ends before
        elif above.size and above[-1] == fine[-1]:
            # between the last of the times and the ground; a track may end in the air
            when = touchdown if down - height < OFF_GROUND else math.nan
        else:
            when = float(above[-1]) if above.size else math.nan
        times.append(when if when <= scenario.duration_s + 1e-9 else math.nan)
    return times


def _hidden_throughout(names: Sequence[str], hidden: np.ndarray) -> list[str]:
    """Warning about pseudolites that terrain hides at all fixes, (e, p) bool."""
    return [
        f"terrain: {name} is behind it during the whole flight and never received; move it, or the ridge"
        for name, times in zip(names, hidden.T, strict=True)
        if times.size and times.all()
    ]
