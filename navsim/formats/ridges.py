"""Ridges and skylines of a result's scenario, as lines along their tops: for maps and figures.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss.interference import horizon
from navsim.results.result import Result, scenario_of

_THRESHOLDS = ("/truth/threshold_llh", "/plan/threshold_llh")


@dataclass(frozen=True)
class RidgeLine:
    """number: in the section `terrain`, from 0. llh: (n, 3) along its top, rad, rad, m. height: of its top above the
    threshold, m; of a skyline in the middle."""

    number: int
    llh: np.ndarray
    height: float

    @property
    def name(self) -> str:
        """Name on maps."""
        return f"terrain[{self.number}], {self.height:.0f} m"


def ridges(result: Result) -> list[RidgeLine]:
    """Terrain of a landing, a sweep or a search for placements; None if a result of an earlier version has no
    threshold.

    If a sweep varies the terrain, only the part common to all combinations.
    """
    given = scenario_of(result).get("terrain") or []
    place = next((path for path in _THRESHOLDS if path in result), None)
    if not given or place is None:
        return []
    threshold, other = np.asarray(result[place]), varied(result)
    out = []
    for number, one in enumerate(given):
        if f"{number}" in other or WHOLE in other or one.get("file") is not None:
            continue
        if one.get("ends") is not None:
            ends = np.radians([[end["lat_deg"], end["lon_deg"]] for end in one["ends"]])
            tops = horizon.ridge(ends, threshold[2] + one["height_m"])
        else:
            azimuths = tuple(np.radians(one["azimuth_deg"]))
            tops = horizon.skyline(threshold, azimuths, np.radians(one["elevation_deg"]), one["distance_m"])
        llh = llh_from_ecef(np.concatenate([tops[:, 0], tops[-1:, 1]]))
        out.append(RidgeLine(number, llh, float(np.median(llh[:, 2]) - threshold[2])))
    return out


WHOLE = ""
"""Marks the whole section among varied ridges."""


def varied(result: Result) -> set[str]:
    """Numbers of the ridges that a sweep varies, or `WHOLE`."""
    if result.attributes["kind"] != "sweep":
        return set()
    axes = scenario_of(result, "study")["vary"]
    keys = [key.split(".") for axis in axes for key in (axis.get("keys") or [axis.get("key")])]
    return {key[1] if len(key) > 1 else WHOLE for key in keys if key[0] == "terrain"}
