"""`kind: optimize`: positions of pseudolites or beacons under constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from navsim.results.findings import several
from navsim.scenario_files.base import (
    Checksum,
    Dotted,
    ListOf,
    NonNegative,
    Pair,
    Section,
    Signed,
    Size,
    SourceName,
    Version,
    reject,
)
from navsim.sweeps.scenario import BEACON_OUTPUTS, DOP_OUTPUTS, FILTER_OUTPUTS, LEVEL_OUTPUTS

DOP_OBJECTIVES = tuple(name for name in DOP_OUTPUTS if name != "epochs_without_fix")
"""Objectives from the geometry alone."""
LEVEL_OBJECTIVES = LEVEL_OUTPUTS
"""Objectives from the levels of monitored fixes, which also follow from the geometry."""
BEACON_OBJECTIVES = BEACON_OUTPUTS
"""Objectives from the geometry of beacons."""
OBJECTIVES = (*DOP_OBJECTIVES, *FILTER_OUTPUTS, *LEVEL_OBJECTIVES, *BEACON_OBJECTIVES)
FILTER_DISTANCE = (100.0, 100_000.0)
"""Default of `constraints.distance_m` if a filter error is the objective, m. With fix errors of 3 m, the third-order
term of a range is then at most 3 % of the second-order term, and that 5 % of the range's sigma."""
BEACON_DISTANCE = (30.0, 100_000.0)
"""The same where beacons are placed, for every objective, m: ten sigmas of fixes, beyond which a range is linear."""
Number = Annotated[int, Field(ge=1, le=12)]
"""Number of pseudolites or beacons."""


class Numbers(Section):
    """Numbers of pseudolites or beacons one after the other, both ends included."""

    first: Number
    """smallest number"""
    last: Number
    """largest number"""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.last < self.first:
            raise reject("must not lie below first", "last")
        return self


def _written(value: Any) -> str:
    return "range" if isinstance(value, (dict, Numbers)) else "list"


Counts = Annotated[
    Annotated[ListOf[Number], Tag("list")] | Annotated[Numbers, Tag("range")],
    Discriminator(_written),
]
"""Numbers one by one, or first and last."""


class Area(Section):
    """Area for pseudolites or beacons, in runway axes."""

    s_m: Pair
    """from, to across the runway, positive to the right of landing"""
    l1_m: Pair
    """from, to along it, positive before the threshold"""
    height_m: Pair | None = None
    """from, to of the height of the antennas above the runway, one for each; omitted: height_m of the study for all"""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        for key in ("s_m", "l1_m", "height_m"):
            if (ends := getattr(self, key)) is not None and ends[0] >= ends[1]:
                raise reject("the lower end comes first", key)
        return self


class Strip(Section):
    """Runway strip, kept clear (ICAO Annex 14, 3.4)."""

    half_width_m: Size = 75.0
    """from the axis of the runway to the edge of the strip"""
    beyond_m: NonNegative = 60.0
    """length of the strip before the threshold and past the end of the runway"""


class Surfaces(Section):
    """Obstacle limitation surfaces antennas stay under (ICAO Annex 14, table 4-1, precision approach, code 1 or 2)."""

    inner_edge_m: Size = 150.0
    """length of the inner edge of the approach surface, across the runway"""
    from_threshold_m: NonNegative = 60.0
    """distance of the inner edge from the threshold"""
    divergence_percent: NonNegative = 15.0
    """how much each side of the approach surface widens with distance"""
    approach_slope_percent: Annotated[float, Field(ge=0.01, le=1000.0)] = 2.5
    """slope of the approach surface"""
    transitional_slope_percent: Annotated[float, Field(ge=0.01, le=1000.0)] = 14.3
    """slope of the transitional surface, across the runway"""


class SiteChoice(Section):
    """A place where a pseudolite or beacon could be put up."""

    name: SourceName | None = None
    """name of the place; left out: its number in the list"""
    s_m: Signed
    """distance from the runway axis, positive to the right of landing"""
    l1_m: Signed
    """distance before the threshold"""
    height_m: Signed | None = None
    """height of the antenna above the runway; omitted: height_m of the study"""
    ground_m: Signed | None = None
    """height of the ground, or roof, that a mast stands on there, counted as height_m; omitted: 0. For `costs`"""
    cost: NonNegative | None = None
    """what permission to stand there costs; omitted: nothing. For `costs`"""


class Constraints(Section):
    """Constraints on a placement; an omitted key is no constraint."""

    runway_strip: Strip | None = None
    """keep out of the runway strip"""
    surfaces: Surfaces | None = None
    """stay under the obstacle limitation surfaces"""
    keep_out: str | None = None
    """GeoJSON file with polygons (longitude, latitude) to keep out of, relative to this file"""
    keep_out_sha256: Checksum | None = None
    """checksum of that file; when given, another file is refused"""
    permission: str | None = None
    """GeoJSON file with polygons (longitude, latitude) to stay within, relative to this file. The property `cost` of a
    polygon is what permission costs there, for each source; omitted: nothing"""
    permission_sha256: Checksum | None = None
    """checksum of that file; when given, another file is refused"""
    spacing_m: NonNegative = 0.0
    """least distance between pseudolites, or beacons"""
    distance_m: Pair | None = None
    """least and largest distance from the aircraft during the glide. Left out: 30 m to 100 km for beacons; 100 m to
    100 km for pseudolites with an error of the filter as the objective; else no limits. In nearer passes a filter that
    takes ranges as linear is overconfident"""
    near_far_db: Annotated[float, Field(ge=0.001, le=1000.0)] | None = None
    """largest ratio of a pseudolite's received power over the glide, from the distances, dB"""
    requirements: bool = False
    """whether placements have to meet those `requirements` of the base scenario that levels and covariance analysis
    decide. If none does, navsim gives the placement that comes closest to its worst requirement, and fails"""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        for key in ("keep_out", "permission"):
            if getattr(self, f"{key}_sha256") is not None and getattr(self, key) is None:
                raise reject(f"there is no {key}: give it, or leave the checksum out", f"{key}_sha256")
        if self.distance_m is not None and not 0.0 <= self.distance_m[0] < self.distance_m[1]:
            raise reject("expected a least distance, then a larger one", "distance_m")
        return self


class Period(Section):
    """Start times of the approach over which the objective is taken."""

    hours: Annotated[float, Field(ge=1e-3, le=1e5)]
    """length of the period; GLONASS repeats its ground track after 7.99 days, 191.5 h"""
    count: Annotated[int, Field(ge=2, le=10_000)]
    """number of start times, evenly spread from the base scenario's epoch on"""


class PowerChoice(Section):
    """A transmitter power that can be bought."""

    eirp_dbm: Annotated[float, Field(ge=-150.0, le=100.0)]
    """replaces eirp_dbm of the base scenario's pseudolites or beacons, for all of them; range and noise follow from
    their link budget"""
    cost: NonNegative = 0.0
    """further cost of a source with this power"""


class Costs(Section):
    """What sources cost, in any one currency. navsim then seeks the front of accuracy against cost."""

    each: NonNegative = 0.0
    """cost of a source without mast and permission"""
    mast_per_metre: NonNegative = 0.0
    """cost of each metre of its antenna's height above the ground, which is at 0 m but for `sites` with their
    ground_m"""
    power: ListOf[PowerChoice] = ()
    """transmitter powers to choose from, one for all sources of a placement; omitted: that of the base scenario"""
    steps: Annotated[int, Field(ge=1, le=50)] = 4
    """for each number of sources and each power: steps from the cost of the most accurate placement down to the least
    cost, with a search below each"""


class Optimize(Section):
    """The best placement of pseudolites or beacons for a base scenario."""

    kind: Literal["optimize"]
    """kind of the file"""
    version: Version
    """version of the format"""
    title: str = ""
    """title of results, reports and exports; empty: they show the name of the file"""
    base: str
    """scenario file, relative to this one"""
    set: dict[Dotted, Any] = Field(default_factory=dict)
    """settings of the base: dotted keys and values"""
    pseudolites: Counts | None = None
    """numbers of pseudolites to place, a list or first and last; several give the trade-off of accuracy and number"""
    beacons: Counts | None = None
    """numbers of ranging beacons to place, in place of pseudolites; the base scenario describes them, and its own
    `sites` are not used"""
    objective: Literal[OBJECTIVES]  # type: ignore[valid-type]
    """quantity that navsim minimises: a mean or (…_max) worst DOP or sigma of a fix of the glide, an error of the
    filter, or a protection level, if all of the glide has it. It maximises level_share, the share of epochs that have
    levels. With beacons: beacons_…, a DOP of their ranges, also its median (…_p50), which single epochs do not
    spoil; or an error of the filter"""
    area: Area | None = None
    """area for pseudolites or beacons; give this or sites"""
    sites: ListOf[SiteChoice] = ()
    """instead of area: the places there are; the choice is then combinatorial"""
    height_m: Signed = 0.0
    """height of the antennas above the runway, for those without their own"""
    height_above: Literal["runway", "ground"] = "runway"
    """what all heights of the study count from; ground: that of the files of heights under `terrain` of the base"""
    constraints: Constraints = Constraints()
    """constraints on a placement"""
    costs: Costs | None = None
    """what sources cost; omitted: navsim seeks accuracy against their number alone"""
    period: Period | None = None
    """start times over which a geometric objective is taken; left out: the base scenario's epoch alone"""
    effort: Annotated[int, Field(ge=1, le=100)] = 3
    """searches from independent starts, of which the best is kept; for an error of the filter, rounds of learning"""

    @model_validator(mode="after")
    def _check_consistent(self) -> Self:
        if (self.pseudolites is None) == (self.beacons is None):
            raise reject("give exactly one of pseudolites and beacons: the numbers to place", "pseudolites")
        if (self.area is None) == (not self.sites):
            raise reject("give exactly one of area and sites", "area")
        if not self.counts:
            raise reject("an empty list", self.placed)
        if len({*self.counts}) < len(self.counts):
            raise reject("a number is given twice", self.placed)
        if self.sites and max(self.counts) > len(self.sites):
            raise reject(f"there are only {len(self.sites)} sites", self.placed)
        if self.height_m and self.area is not None and self.area.height_m is not None:
            raise reject("area.height_m is where the height is searched; give one of both", "height_m")
        for i, site in enumerate(self.sites if self.costs is None else ()):
            for key in ("ground_m", "cost"):
                if getattr(site, key) is not None:
                    raise reject("is for `costs`, which is not given; `costs: {}` counts this alone", "sites", i, key)
        self._check_objective()
        if self.period is not None and (self.objective not in DOP_OBJECTIVES or self.constraints.requirements):
            raise reject(
                "errors of the filter, levels and requirements are taken over one epoch; leave this out", "period"
            )
        return self

    def _check_objective(self) -> None:
        """Raise for what does not depend on the positions of the beacons, or pseudolites, that are placed."""
        of_beacons = self.objective in BEACON_OBJECTIVES
        if self.beacons is None and of_beacons:
            raise reject("depends on beacons alone: give `beacons` in place of `pseudolites`", "objective")
        if self.beacons is not None and not of_beacons and self.objective not in FILTER_OUTPUTS:
            text = "does not depend on beacons, whose ranges the filter takes: use one of "
            raise reject(text + f"{', '.join((*BEACON_OBJECTIVES, *FILTER_OUTPUTS))}", "objective")
        if self.beacons is not None and self.constraints.near_far_db is not None:
            raise reject("is for pseudolites; beacons answer one after the other", "constraints", "near_far_db")

    @property
    def placed(self) -> Literal["pseudolites", "beacons"]:
        """Kind of what is placed, as the name of its section."""
        return "pseudolites" if self.beacons is None else "beacons"

    def named(self, count: int) -> str:
        """So many of them, in words."""
        return several(count, self.placed[:-1])

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers to place, the smallest first."""
        given = self.pseudolites if self.beacons is None else self.beacons
        if isinstance(given, Numbers):
            return tuple(range(given.first, given.last + 1))
        return tuple(sorted(given or ()))

    @property
    def has_heights(self) -> bool:
        """Whether a position has a height of its own, above the runway."""
        return (
            self.area.height_m is not None if self.area is not None else any(s.height_m is not None for s in self.sites)
        )

    @property
    def powers(self) -> tuple[PowerChoice | None, ...]:
        """The transmitter powers to choose from; None for that of the base scenario."""
        return (self.costs.power if self.costs is not None else ()) or (None,)

    def site(self, place: Sequence[float]) -> dict[str, float]:
        """Keys of a site of the base scenario at a position: s, l1, and the height where it has its own, m."""
        s, l1, *height = map(float, place)
        return {"s_m": s, "l1_m": l1, "height_m": height[0] if height else self.height_m}
