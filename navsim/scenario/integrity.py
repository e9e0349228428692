"""Monitor of the fixes of a landing, and its requirements: section `integrity`.

Source of structure and defaults: `docs/theory/integrity.md`, section 7.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.results.priors import GROUP_PRIOR
from navsim.scenario.priors import PSEUDOLITES
from navsim.scenario.sky import Name
from navsim.scenario_files.base import DistinctListOf, FlightTime, ListOf, NonNegative, Section, reject

if TYPE_CHECKING:
    from navsim.gnss.heavy_tailed import HeavyTailedNoise

Prior = Annotated[float, Field(ge=0.0, le=0.1)]
"""A probability that a fault is there."""
TransmitterPrior = Prior | Literal["monitored", "unmonitored"]
"""That of a transmitter on the ground, or the name of one."""
Chance = Annotated[float, Field(ge=1e-15, le=0.1)]
"""A probability that is allowed."""
AlertLimit = Annotated[float, Field(ge=0.1, le=1e4)] | None
Bias = Annotated[float, Field(ge=0.0, le=1e3)]
"""A bound of a bias, m."""

Operation = Literal["NPA", "APV-I", "APV-II", "LPV-200", "CAT-I", "GBAS-D"]
OPERATIONS: dict[Operation, tuple[float, float | None]] = {
    "NPA": (556.0, None),
    "APV-I": (40.0, 50.0),
    "APV-II": (40.0, 20.0),
    "LPV-200": (40.0, 35.0),
    "CAT-I": (40.0, 10.0),
    "GBAS-D": (17.0, 10.0),
}
"""Horizontal and vertical alert limits, m: ICAO Annex 10, volume I, table 3.7.2.4-1, note 2 (NPA, APV, of CAT I the
smaller of 10 to 15 m); doi:10.1186/s43020-020-00010-2, table 1 (LPV-200); RTCA DO-245A table 2-1 as in Pullen 2014
(GBAS D)."""

TIMES_TO_ALERT: dict[Operation, float] = {
    "NPA": 10.0, "APV-I": 10.0, "APV-II": 6.0, "LPV-200": 6.2, "CAT-I": 6.0, "GBAS-D": 2.0,
}  # fmt: skip
"""Times to alert of these operations, s, from the same sources."""


SMOOTHING_D = 30.0
"""Time constant, s, of the carrier smoothing of the position that guides by GAST D."""


class LimitsSection(Section):
    """Limits of position errors and protection levels, and time to alert."""

    operation: Operation | None = None
    """operation whose alert limits are taken; or give hal_m, val_m or both"""
    hal_m: AlertLimit = None
    """horizontal alert limit"""
    val_m: AlertLimit = None
    """vertical alert limit"""
    grow_with_distance: bool = False
    """whether these are the limits at the threshold, which grow with the distance from it and the height above it as
    those of GBAS approaches do (ICAO Annex 10, tables B-68 and B-69)"""
    tta_s: Annotated[float, Field(ge=0.0, le=60.0)]
    """time to alert: how long an error may exceed its limit before an alarm"""

    @model_validator(mode="after")
    def _some(self) -> Self:
        given = self.hal_m is not None or self.val_m is not None
        if given == (self.operation is not None):
            raise reject("give either `operation` or limits of your own, hal_m, val_m or both", "operation")
        return self

    def limits(self) -> tuple[float | None, float | None]:
        """Horizontal, vertical."""
        return (self.hal_m, self.val_m) if self.operation is None else OPERATIONS[self.operation]


class GroundGroup(Section):
    """Transmitters on the ground that can fail together, since they share clock, survey, power or correction link."""

    members: Annotated[DistinctListOf[str], Field(min_length=1)]
    """names of the pseudolites, beacons or ground stations of the group"""
    prior: Prior = GROUP_PRIOR
    """probability that the whole group is faulty"""


class TailsSection(Section):
    """Sampling of the probability that errors exceed their levels without an alarm."""

    at_s: Annotated[ListOf[FlightTime], Field(min_length=1, max_length=20)]
    """times at which tails are sampled; for each the last fix epoch until then"""
    samples: Annotated[int, Field(ge=1000, le=1_000_000)] = 100_000
    """samples of each fault at each of the times"""


class InnovationsSection(Section):
    """Test of the filter's innovations, which detects what no single fix shows."""

    window_s: FlightTime = 30.0
    """how long innovations are added up; 0: single epochs"""
    p_fa: Chance = 1e-5
    """probability of an alarm at an epoch without a fault"""


class HeavyTailedSection(Section):
    """Noise of ranges from two Gaussians, each range at each epoch from one of them; defaults: Tukey's contaminated
    normal distribution."""

    core: Annotated[float, Field(ge=0.01, le=10.0)] = 1.0
    """1 sigma of most ranges relative to the assumed one"""
    tail: Annotated[float, Field(ge=1.0, le=100.0)] = 3.0
    """1 sigma of the other ranges relative to the assumed one"""
    share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    """share of the other ranges among all"""

    @model_validator(mode="after")
    def _tailed(self) -> Self:
        if self.tail < self.core:
            raise reject(f"the tail is the wider of the two: at least `core`, {self.core:g}", "tail")
        return self

    def model(self) -> HeavyTailedNoise:
        """Distribution of the noise."""
        from navsim.gnss.heavy_tailed import HeavyTailedNoise

        return HeavyTailedNoise(self.core, self.tail, self.share)


class GroundStationSection(Section):
    """The ground station that the form of GBAS is of: by bounds of its errors, or the one of
    signals.errors.ground_station, whose B values each run draws."""

    receivers: Annotated[int, Field(ge=2, le=4)] | None = None
    """number of reference receivers; null, like the next two: that of signals.errors.ground_station"""
    ground_sigma_m: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    """1 sigma of the ground station's part of each range error, at most the least sigma of the ranges"""
    b_m: Bias | None = None
    """bound of the B values of each range, taken with the signs that hurt most"""
    glide_path_deg: Annotated[float, Field(ge=0.5, le=15.0)] | None = None
    """glide path angle of the form; null: approach.glide_slope_deg"""
    approach_service: Literal["C", "D"] = "C"
    """GBAS approach service type (GAST). D adds D_L and D_V, the differences between positions from ranges smoothed
    over 30 s and over 100 s (unverified: that levels are these sums), and is for drawn B values"""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        bounds = {name: getattr(self, name) for name in ("receivers", "ground_sigma_m", "b_m")}
        missing = [name for name, value in bounds.items() if value is None]
        if 0 < len(missing) < len(bounds):
            raise reject("is missing: give all three of receivers, ground_sigma_m and b_m, or none", missing[0])
        if not missing and self.approach_service == "D":
            raise reject("is for drawn B values: leave receivers, ground_sigma_m and b_m out", "approach_service")
        return self

    @property
    def drawn(self) -> bool:
        """Whether each run draws the B values."""
        return self.receivers is None


class ComparisonSection(Section):
    """Levels that the forms of other systems' standards give the same fixes, for comparison."""

    sbas: bool = True
    """whether levels by the form of DO-229, precision approach, are computed"""
    gbas: GroundStationSection | None = None
    """ground station of the form of GBAS approach service; null: none"""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.sbas and self.gbas is None:
            raise reject("with sbas false there is nothing to compare: give gbas, or leave the section out", "sbas")
        return self


class IntegritySection(Section):
    """Monitor of the fixes, its fault list, and its requirements."""

    method: Literal["mhss", "chi2", "filter"] = "mhss"
    """mhss: solution separation, the fix without each fault against the full one. `chi2`: sum of squared residuals, one
    fault at a time. `filter`: solution separation between the filter and filters without each fault; levels, errors and
    alarms are then the filter's"""
    limits: LimitsSection | None = None
    """null: levels and alarms are computed, and nothing is asked"""
    tails: TailsSection | None = None
    """null: levels are computed, and how often they are exceeded is not sampled"""
    innovations: InnovationsSection | None = None
    """null: the filter's innovations are not monitored"""
    comparison: ComparisonSection | None = None
    """null: no levels of other systems' forms"""
    decision_height_m: NonNegative | None = None
    """height above the runway from which to touchdown an approach has to be available throughout; null: all of the
    glide"""
    exclusion: Literal["none", "residual", "rms"] = "none"
    """source (chi2), fault (mhss), beacons or ground stations (filter) excluded after an alarm, if the rest then passes
    its own test. `residual`: the one with the largest normalised residual; filter: those without which alone
    innovations are consistent, for the rest of the run. `rms`, as RTKLIB does: the source whose exclusion leaves the
    smallest RMS of residuals. `none`: nothing is excluded"""
    on_alarm: Literal["use", "drop"] = "use"
    """whether the filter takes fixes whose alarm no exclusion has ended"""
    p_fa: Chance = 6.666667e-5
    """chi2: probability of an alarm at an epoch without a fault"""
    p_md: Chance = 1e-3
    """chi2: probability of no alarm at an epoch with the fault that the levels are of"""
    p_hmi_v: Chance = 9.8e-8
    """mhss and filter: probability of a vertical error beyond the level without an alarm"""
    p_hmi_h: Chance = 2e-9
    """mhss and filter: probability of a horizontal error beyond the level without an alarm"""
    p_fa_v: Chance = 3.9e-6
    """mhss and filter: probability of an alarm without a fault, by the vertical"""
    p_fa_h: Chance = 9e-8
    """mhss and filter: probability of an alarm without a fault, by the horizontal"""
    p_unmonitored_max: Chance = 8e-8
    """mhss and filter: probability of faults that are not monitored, as many as are tolerated"""
    p_satellite: Prior = 1e-5
    """mhss and filter: probability that a satellite is faulty"""
    p_constellation: Prior = 1e-4
    """mhss and filter: probability that all satellites of a system are faulty"""
    p_constellations: dict[Name, Prior] = Field(default_factory=dict)
    """mhss and filter: that of single satellite systems, by name, in place of p_constellation"""
    p_pseudolite: TransmitterPrior = 1e-4
    """mhss and filter: probability that a pseudolite is faulty. monitored: 4.3e-5, it has a monitor that shuts it down
    within 6 s; unmonitored: 1.04e-3, where a fault is found after an hour"""
    p_beacon: TransmitterPrior = 1e-4
    """filter: probability that a ranging beacon is faulty, like p_pseudolite"""
    p_station: TransmitterPrior = 1e-4
    """filter: probability that a ground station (azimuth_station, elevation_station, dme) is faulty, like
    p_pseudolite"""
    ground_groups: Annotated[ListOf[GroundGroup], Field(max_length=20)] | None = None
    """pseudolites, beacons or ground stations that can fail together; null: several pseudolites are one group, and for
    `filter` several beacons another, with the default prior"""
    b_nom_m: Bias = 0.75
    """bound of the bias of a satellite's range without a fault"""
    b_nom_pseudolite_m: Bias = 0.25
    """bound of the bias of a pseudolite's range without a fault"""
    b_nom_beacon_m: Bias = 0.25
    """filter: bound of the bias of a beacon's range without a fault, beyond the biases that the filter estimates"""
    b_nom_azimuth_station_m: Bias = 0.0
    """filter: bound of the bias of the azimuth station without a fault, at the threshold, beyond the bias and bends
    that the filter estimates; also the next two"""
    b_nom_elevation_station_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """filter: that of the elevation station"""
    b_nom_dme_m: Bias = 0.0
    """filter: that of the DME"""
    sigma_ratio_acc: Annotated[float, Field(ge=0.01, le=1.0)] = 1.0
    """1 sigma of the ranges without a fault by the one that bounds them, which is the receiver's"""
    effective_samples: Annotated[float, Field(ge=1.0, le=1e6)] = 1.0
    """independent samples of an approach, by which p_hmi and p_fa are divided: its duration over the larger of the
    time to alert and the correlation time of errors. White noise and 6 s to alert give 150 s / 6 s = 25"""
    error_model: Literal["gaussian", "heavy_tailed"] = "gaussian"
    """noise of ranges in runs. gaussian: with the sigmas that receiver, filter and monitor assume; heavy_tailed: of
    `heavy_tailed`, which they do not know: a test of the bound"""
    heavy_tailed: HeavyTailedSection = HeavyTailedSection()
    """the two Gaussians of `error_model: heavy_tailed`"""

    @model_validator(mode="after")
    def _sampled(self) -> Self:
        if self.tails is not None and self.error_model == "heavy_tailed":
            raise reject(
                "samples errors that are as believed; with `error_model: heavy_tailed` count runs "
                "(/summary/integrity/exceeded_vertical)",
                "tails",
            )
        return self

    @model_validator(mode="after")
    def _worse(self) -> Self:
        if self.error_model == "gaussian" and self.heavy_tailed != HeavyTailedSection():
            raise reject("is for `error_model: heavy_tailed`", "heavy_tailed")
        return self

    @model_validator(mode="after")
    def _of_fixes_alone(self) -> Self:
        if self.method == "filter":
            if self.exclusion == "rms":
                text = "must be residual or none with method filter: rms is of residuals of fixes"
                raise reject(text, "exclusion")
            for name, default, why in (
                ("on_alarm", "use", "alarms of the filter come after it took the fix"),
                ("tails", None, "they are sampled of fixes"),
                ("comparison", None, "the forms are of fixes"),
                ("sigma_ratio_acc", 1.0, "the filter has one covariance"),
            ):
                if getattr(self, name) != default:
                    shown = "null" if default is None else f"{default:g}" if name == "sigma_ratio_acc" else default
                    raise reject(f"must be {shown} with method filter: {why}; or use method mhss or chi2", name)
        return self

    def false_alarm(self) -> float:
        """The largest probability of an alarm at an epoch without a fault."""
        return self.p_fa if self.method == "chi2" else (self.p_fa_v + self.p_fa_h) / self.effective_samples

    def risk_of_levels(self) -> float:
        """Probability, for an approach, that errors are beyond their levels without an alarm; 1 where levels are
        computed for none: `chi2` has that of a fault that is there."""
        return 1.0 if self.method == "chi2" else self.p_hmi_v + self.p_hmi_h + self.p_unmonitored_max

    def unused(self, systems: Collection[str] | None = None) -> list[str]:
        """Keys without effect, as messages. systems: of the satellites, None if unknown."""
        of_residuals = ("p_fa", "p_md")
        of_separation = (
            "p_hmi_v", "p_hmi_h", "p_fa_v", "p_fa_h", "p_unmonitored_max", "p_satellite", "p_constellation",
            "p_constellations", "p_pseudolite", "ground_groups", "effective_samples",
        )  # fmt: skip
        of_filter = (
            "p_beacon", "p_station", "b_nom_beacon_m", "b_nom_azimuth_station_m", "b_nom_elevation_station_deg",
            "b_nom_dme_m",
        )  # fmt: skip
        usual = IntegritySection()
        out = [
            f"integrity.{name} is not used: integrity.method is {self.method}"
            for name in (
                *(of_separation if self.method == "chi2" else of_residuals),
                *(of_filter if self.method != "filter" else ()),
            )
            if getattr(self, name) != getattr(usual, name)
        ]
        if self.method != "chi2" and systems is not None:
            absent = [name for name in self.p_constellations if name not in systems]
            out += [f"integrity.p_constellations.{name} is not used: the sky has none of them" for name in absent]
        if self.limits is not None and (operation := self.limits.operation) is not None:
            asked, most = self.limits.tta_s, TIMES_TO_ALERT[operation]
            longer = f"integrity.limits.tta_s: {asked:g} s is longer than the time to alert of {operation}, {most:g} s"
            out += [longer] if asked > most else []
        return out

    def check_names(self, pseudolites: Sequence[str], ground: Sequence[str]) -> None:
        """Raise for members of groups that are none of these pseudolites or, for `filter`, of these beacons and ground
        stations."""
        for i, group in enumerate(self.ground_groups or ()):
            for j, member in enumerate(group.members):
                if member in ground and self.method != "filter":
                    text = f"{member!r} is a beacon or ground station, which method filter alone watches"
                    raise reject(text, "ground_groups", i, "members", j)
                if member not in (*pseudolites, *ground):
                    there = ", ".join(pseudolites) or "none"
                    text = f"{member!r} is not a pseudolite; the pseudolites are: {there}"
                    text += f"; the beacons and ground stations are: {', '.join(ground)}" if ground else ""
                    raise reject(text, "ground_groups", i, "members", j)


def transmitter_prior(given: float | Literal["monitored", "unmonitored"]) -> float:
    """Probability that a transmitter on the ground is faulty."""
    return PSEUDOLITES[given] if isinstance(given, str) else given
