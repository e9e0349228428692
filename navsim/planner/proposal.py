"""Edited scenario of the planner: the data of a scenario file and nothing else.

The scenario's own sections compute positions and times from these data, as for `navsim run`. Coordinates are along,
right and up from the runway's threshold, m, along in the direction of landing.
"""

from __future__ import annotations

import copy
import datetime
import math
from typing import Any

import numpy as np

from navsim.environment.sources import trajectory_of
from navsim.geodesy.earth import ecef_from_llh, in_heading_axes
from navsim.optimization.placement import RunwayPlane
from navsim.scenario.approach import FileApproach
from navsim.scenario.landing import Landing
from navsim.scenario.site_clearance import check_sites
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario_files.base import DEG, KeyedError, utc_text, validated
from navsim.scenario_files.rewrite import Rewritten, rewritten
from navsim.scenario_files.source import Document, InputError, Problem, dotted

_MILLIMETRES = 3
"""Decimals of metres that are written."""
_DEGREES = 9
"""Decimals of degrees that are written: a tenth of a millimetre."""


class PlannedScenario:
    """The present scenario, its history, and its text."""

    def __init__(self, document: Document, text: str) -> None:
        """document: as read from text. Raises InputError."""
        self._base, self._text = document, text
        self._past: list[dict[str, Any]] = []
        self._future: list[dict[str, Any]] = []
        self.saved: dict[str, Any] = document.data
        self._take(document.data)

    def _take(self, data: dict[str, Any]) -> None:
        document = self._base.copy()
        document.data = copy.deepcopy(data)
        scenario = validated(Landing, document)
        trajectory, scenario = trajectory_of(scenario, document)
        if isinstance(scenario.approach, FileApproach):  # of others the scenario itself has looked
            try:
                check_sites(scenario, trajectory)
            except KeyedError as error:
                raise InputError([Problem(document.place(error.path), dotted(error.path), str(error))]) from None
        self.document, self.scenario, self.trajectory = document, scenario, trajectory

    # --- properties

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the pseudolites."""
        return self.scenario.pseudolites.names()

    def file_names(self) -> list[str]:
        """Files that the scenario names, as written there."""
        approach = self.scenario.approach
        flown = [approach.file] if isinstance(approach, FileApproach) else []
        sky = self.scenario.sky
        around = [] if sky.horizon is None else [sky.horizon]
        around += [its.file for its in self.scenario.terrain if its.file is not None]
        return [*flown, *around, *(getattr(sky, sky.source) if sky.source in SOURCES_FROM_FILES else ())]

    @property
    def plane(self) -> RunwayPlane:
        """The runway's, where places are counted from."""
        return RunwayPlane(self.threshold, self.heading, 0.0)

    @property
    def threshold(self) -> np.ndarray:
        """(3,) rad, rad, m."""
        return self.scenario.threshold(self.trajectory.frame)

    @property
    def heading(self) -> float:
        """Direction of landing, rad."""
        return self.scenario.runway.heading_deg * DEG

    def places(self) -> np.ndarray:
        """Along, right and up of the pseudolites (p, 3), m."""
        section = self.scenario.pseudolites
        out = self._in_plane(self.scenario.pseudolite_positions(self.trajectory.frame))
        for place, site in zip(out, section.placed(), strict=True):
            if section.frame == "runway" and site.s_m is not None and site.l1_m is not None:
                place[:2] = -site.l1_m, site.s_m
        return out

    @property
    def beacon_names(self) -> tuple[str, ...]:
        """Names of the ranging beacons."""
        return () if self.scenario.beacons is None else self.scenario.beacons.names()

    def beacons(self) -> np.ndarray:
        """Along, right and up of the ranging beacons (b, 3), m."""
        if (section := self.scenario.beacons) is None:
            return np.empty((0, 3))
        out = self._in_plane(section.model(self.scenario).positions(self.trajectory.frame))
        for place, site in zip(out, section.sites, strict=True):
            if site.s_m is not None and site.l1_m is not None:
                place[:2] = -site.l1_m, site.s_m
        return out

    def jammers(self) -> np.ndarray:
        """Positions of the jammers (j, 3)."""
        interference = self.scenario.interference
        if interference is None:
            return np.empty((0, 3))
        ground = self.scenario.runway.ellipsoidal_m
        llh = [[*each.place.radians, ground + each.height_m] for each in interference.jammers]
        return self._in_plane(np.array(llh).reshape(-1, 3))

    def _in_plane(self, llh: np.ndarray) -> np.ndarray:
        plane = self.plane
        flat = np.column_stack([llh[:, :2], np.full(len(llh), self.threshold[2])])
        s_l1 = plane.places(flat)
        for _ in range(2):  # places are in a plane, and the Earth is not: millimetres at some kilometres
            s_l1 += plane.places(flat) - plane.places(plane.llh(s_l1))
        return np.column_stack([-s_l1[:, 1], s_l1[:, 0], llh[:, 2] - self.scenario.runway.ellipsoidal_m])

    def axes(self, ecef: np.ndarray) -> np.ndarray:
        """Points (..., 3), ECEF, along, right and down of the threshold, m."""
        return in_heading_axes(ecef, self.threshold, self.heading)

    def sites(self, places: np.ndarray) -> np.ndarray:
        """Places (..., 3) as ECEF, m."""
        llh = self.plane.llh(np.stack([places[..., 1], -places[..., 0]], axis=-1))
        llh[..., 2] += places[..., 2]
        return ecef_from_llh(llh)

    @property
    def unsaved(self) -> bool:
        """Whether there are changes that no file has."""
        return bool(self.document.data != self.saved)

    @property
    def can_undo(self) -> bool:
        """Whether something was changed."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether something was undone."""
        return bool(self._future)

    def text(self) -> Rewritten:
        """The scenario file."""
        return rewritten(self._text, self.document.data)

    # --- changes; each raises InputError, and changes nothing, if the scenario forbids it

    def undo(self) -> None:
        """Go back by one change."""
        if self._past:
            now = self.document.data
            self._take(self._past[-1])
            self._past.pop()
            self._future.append(now)

    def redo(self) -> None:
        """Redo the change that was undone."""
        if self._future:
            now = self.document.data
            self._take(self._future[-1])
            self._future.pop()
            self._past.append(now)

    def _change(self, data: dict[str, Any]) -> None:
        if data == self.document.data:
            return
        now = self.document.data
        self._take(data)
        self._past.append(now)
        self._future.clear()

    def move(self, number: int, place: np.ndarray) -> None:
        """Put a pseudolite at a place (3,)."""
        data = copy.deepcopy(self.document.data)
        self._move_site(self._listed(data)["sites"][number], self.places()[number], place)
        self._put(data, self.names[number], place)

    def move_beacon(self, number: int, place: np.ndarray) -> None:
        """Put a ranging beacon at a place (3,)."""
        data = copy.deepcopy(self.document.data)
        self._move_site(data["beacons"]["sites"][number], self.beacons()[number], place)
        self._put(data, self.beacon_names[number], place, "beacons")

    def _move_site(self, site: dict[str, Any], before: np.ndarray, place: np.ndarray) -> None:
        """Change the keys of a site from one place (3,) to another."""
        if "lat_deg" in site:
            llh = self.plane.llh(np.array([place[1], -place[0]]))
            site["lat_deg"], site["lon_deg"] = (round(math.degrees(x), _DEGREES) for x in llh[:2])
        else:  # unchanged parts stay as written
            site |= {key: to for key, to in (("s_m", _metres(place[1])), ("l1_m", _metres(-place[0])))
                     if site[key] != to}  # fmt: skip
        if round(before[2], _MILLIMETRES) != round(place[2], _MILLIMETRES):
            site["height_m"] = _metres(place[2])

    def _put(self, data: dict[str, Any], name: str, place: np.ndarray, section: str = "pseudolites") -> None:
        """Change data to those with a pseudolite or beacon at a place (3,). Raises InputError, also on the runway's
        pavement."""
        now, past, future = self.document.data, self._past[:], self._future[:]
        self._change(data)
        runway = self.scenario.runway
        if runway.is_pavement(float(place[0]), float(place[1])):
            text = (
                f"{name} would be on the pavement of the runway, {runway.length_m:g} m by {runway.width_m:g} m; put "
                f"it more than {0.5 * runway.width_m:g} m from the centre line"
            )
            place_of = self.document.place((section,))
            self._take(now)
            self._past, self._future = past, future
            raise InputError([Problem(place_of, f"{section}.sites", text)])

    def add(self, place: np.ndarray) -> None:
        """Have one more at a place (3,)."""
        data = copy.deepcopy(self.document.data)
        section = self._listed(data)
        site: dict[str, Any] = {"s_m": _metres(place[1]), "l1_m": _metres(-place[0])}
        if self.fresh_name() != f"PL{len(section['sites']) + 1}":
            site = {"name": self.fresh_name()} | site
        if _metres(place[2]) != self.scenario.pseudolites.height_m:
            site["height_m"] = _metres(place[2])
        section["sites"].append(site)
        self._put(data, self.fresh_name(), place)

    def fresh_name(self) -> str:
        """Name for one more."""
        number = len(self.names) + 1
        while f"PL{number}" in self.names:
            number += 1
        return f"PL{number}"

    def remove(self, number: int) -> None:
        """Have one less; the others keep their names."""
        data = copy.deepcopy(self.document.data)
        names = self.names
        section = self._listed(data)
        del section["sites"][number]
        left = [name for i, name in enumerate(names) if i != number]
        section["sites"] = [
            site if site.get("name", f"PL{i}") == name else {"name": name} | site
            for i, (site, name) in enumerate(zip(section["sites"], left, strict=True), 1)
        ]
        if not section["sites"]:
            del section["sites"]
            section["count"] = 0
        self._change(data)

    def jam_from(self, number: int, place: np.ndarray) -> None:
        """Put a jammer at a place (2,), along and right."""
        data = copy.deepcopy(self.document.data)
        llh = self.plane.llh(np.array([place[1], -place[0]]))
        point = data["interference"]["jammers"][number]["place"]
        point["lat_deg"], point["lon_deg"] = (round(math.degrees(x), _DEGREES) for x in llh[:2])
        self._change(data)

    def set_epoch(self, seconds: float) -> None:
        """Set the time of day, UTC, s; the day stays."""
        self._change(copy.deepcopy(self.document.data) | {"epoch": utc_text(self.epoch_at(seconds))})

    def epoch_at(self, seconds: float) -> datetime.datetime:
        """The epoch as it would be at a time of its day."""
        midnight = self.scenario.epoch.replace(hour=0, minute=0, second=0, microsecond=0)
        return midnight + datetime.timedelta(seconds=round(seconds, 3))

    @property
    def seconds(self) -> float:
        """The time of day, UTC, s."""
        epoch = self.scenario.epoch
        return epoch.hour * 3600.0 + epoch.minute * 60.0 + epoch.second + epoch.microsecond * 1e-6

    def _listed(self, data: dict[str, Any]) -> dict[str, Any]:
        """The section `pseudolites` of data with a site for each in axes of the runway, or by its coordinates."""
        section: dict[str, Any] = data.get("pseudolites") or {}
        data["pseudolites"] = section
        sites = section.get("sites") or []
        places = self.places()
        if not sites or section.get("frame") == "table1":
            known = sites or [{} for _ in places]
            for site, place in zip(known, places, strict=True):
                if "lat_deg" not in site:
                    site["s_m"], site["l1_m"] = _metres(place[1]), _metres(-place[0])
            if "frame" in section:
                section["frame"] = "runway"
            for key in ("count", "s_m", "l1_m"):
                section.pop(key, None)
            section["sites"] = known
        return section


def _metres(value: float) -> float:
    return round(float(value), _MILLIMETRES) + 0.0
