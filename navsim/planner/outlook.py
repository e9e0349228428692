"""Evaluation of a proposal: at the positions of its pseudolites, on maps of possible positions, satellite by satellite.

The value of the proposal is that of `navsim run`. Maps use the methods of sweeps and searches: the geometry kernel at
all fix epochs of the glide, or protection levels at some of them. If the value of satellites depends on the positions
of pseudolites, maps use simulated signals at the same epochs.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from navsim.environment.sources import environment, glide_epochs
from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss.dop import dops, geometry_covariance
from navsim.gnss.signals import build_signals
from navsim.gnss.sky import Horizon
from navsim.landing import integrity
from navsim.landing.beacons import BeaconGlide
from navsim.landing.case import Case
from navsim.landing.result_groups import geometry_summary
from navsim.landing.study import prepare
from navsim.optimization.analyses import LevelScreen, Prepared, glimpsed
from navsim.optimization.placement import RunwayPlane
from navsim.optimization.problem import of_geometry
from navsim.planner.proposal import PlannedScenario
from navsim.simulation.placement_geometry import Geometry, glide_geometry


@dataclass(frozen=True)
class Quantity:
    """Quantity of a map. name: as in sweeps. unit: "" for none."""

    name: str
    said: str
    unit: str
    level: bool = False

    @property
    def label(self) -> str:
        """In words with its unit."""
        return self.said + (f", {self.unit}" if self.unit else "")


QUANTITIES = {each.name: each for each in (
    Quantity("pdop", "PDOP, mean of the glide", ""),
    Quantity("hdop", "HDOP, mean of the glide", ""),
    Quantity("vdop", "VDOP, mean of the glide", ""),
    Quantity("pdop_max", "PDOP, worst of the glide", ""),
    Quantity("fix_horizontal", "accuracy of fixes, horizontal, 1σ", "m"),
    Quantity("fix_vertical", "accuracy of fixes, vertical, 1σ", "m"),
    Quantity("hidden", "share of the glide that does not see the pseudolites", ""),
    Quantity("hpl_p95", "protection level HPL, 95 % of the glide", "m", level=True),
    Quantity("vpl_p95", "protection level VPL, 95 % of the glide", "m", level=True),
)}  # fmt: skip
Places = Callable[[np.ndarray], np.ndarray]
"""Values (n,) of placements (n, k, 3), along, right and up, m; not finite without a solution."""


@dataclass(frozen=True)
class Share:
    """A source at the middle of the glide.

    without: mean PDOP of the glide without it, nan if it is unused, inf if some epoch then has no fix. azimuth,
    elevation: deg.
    """

    name: str
    azimuth: float
    elevation: float
    used: bool
    ground: bool
    without: float


@dataclass(frozen=True)
class Performance:
    """Performance of the present pseudolites: figures by their paths in a result, shares of sources, warnings."""

    figures: dict[str, float]
    shares: list[Share]
    warnings: list[str]


class Outlook:
    """The world of a proposal at its epoch with its jammers, for any places of pseudolites."""

    def __init__(self, proposal: PlannedScenario, epoch: datetime.datetime | None = None) -> None:
        """epoch: another one than the proposal's. Raises InputError for files of satellites that cannot be used."""
        self._proposal, self._document = proposal, proposal.document
        self._trajectory = proposal.trajectory
        self.scenario = proposal.scenario if epoch is None else proposal.scenario.model_copy(update={"epoch": epoch})
        self._sources, self.scenario, _ = environment(self.scenario, self._document, self._trajectory)
        self._geometry: Geometry | None = None
        self._watched: Prepared | None = None
        self._case: Case | None = None

    @property
    def horizon(self) -> Horizon | None:
        """Obstacles that hide satellites above the mask, if the scenario has any."""
        return self._sources.mask.horizon

    @property
    def placed(self) -> bool:
        """Whether the value of satellites, or of single pseudolites, depends on the positions of pseudolites."""
        return self._sources.depends_on_pseudolite_sites or self._sources.singled_out

    def lacks(self, name: str) -> str:
        """Why there is no map of a quantity; empty if there is one."""
        section = self.scenario.integrity
        if not QUANTITIES[name].level:
            return ""
        if section is None:
            return "the scenario has no section `integrity`"
        return "levels of filters take seconds a place" if section.method == "filter" else ""

    def jammed_from(self, places: np.ndarray) -> Outlook:
        """Copy with its jammers at positions (j, 3)."""
        out = Outlook.__new__(Outlook)
        # with signals, each position is simulated with its own sources: the epochs stay the same
        watched = self._bare if self.placed else None
        out.__dict__ |= self.__dict__ | {"_geometry": None, "_watched": watched, "_case": None}
        jamming = self._sources.jamming
        assert jamming is not None
        sites = self._proposal.sites(places)
        jammers = tuple(replace(one, place=site) for one, site in zip(jamming.jammers, sites, strict=True))
        out._sources = replace(self._sources, jamming=replace(jamming, jammers=jammers))
        return out

    @property
    def geometry(self) -> Geometry:
        """The glide as placements see it."""
        if self._geometry is None:
            utc = np.array([self.scenario.epoch.timestamp()])
            epochs = glide_epochs(self.scenario, self._trajectory)
            self._geometry = glide_geometry(self._trajectory, self._sources, utc, *epochs)
        return self._geometry

    def judge(self, name: str, names: tuple[str, ...], every: int = 1) -> Places:
        """Evaluator of a quantity for placements of pseudolites with these names; by geometry at every so many-th
        epoch."""
        if name == "hidden":
            return lambda places: (
                1.0
                - np.mean(
                    [self.geometry.visible_share(self._proposal.sites(places[:, k])) for k in range(places.shape[1])],
                    axis=0,
                )
            )
        if self.placed or (self._sources.sight_placed and QUANTITIES[name].level):
            return lambda places: np.array([self._by_signals(name, each, names) for each in places])
        if not QUANTITIES[name].level:
            geometry = self.geometry.at(np.arange(0, len(self.geometry.receiver), every))
            return lambda places: of_geometry(name, geometry, self._proposal.sites(places))
        watched = replace(self._bare, names=names)

        def levels(places: np.ndarray) -> np.ndarray:
            if self.geometry.has_beyond_horizon(self._proposal.sites(places)):
                return np.array([self._by_signals(name, each, names) for each in places])
            plane = RunwayPlane(self._proposal.threshold, self._proposal.heading, places[0, :, 2])
            screen = LevelScreen(plane, watched, name, None)
            return screen(np.stack([places[..., 1], -places[..., 0]], axis=-1))[0]

        return levels

    def quick(self, name: str) -> bool:
        """Whether a quantity is available for ten thousand placements at once."""
        return name == "hidden" or not (self.placed or QUANTITIES[name].level)

    @property
    def _bare(self) -> Prepared:
        """Monitored flight without pseudolites, at some epochs of the glide."""
        if self._watched is None:
            case = self._ready
            none = replace(self._sources.pseudolites, names=(), llh=np.empty((0, 3)))
            self._watched = glimpsed(replace(case, environment=replace(self._sources, pseudolites=none)))
        return self._watched

    @property
    def _ready(self) -> Case:
        if self._case is None:
            self._case = prepare(self.scenario, self._document)
        return self._case

    def _by_signals(self, name: str, places: np.ndarray, names: tuple[str, ...]) -> float:
        """A quantity of one placement (k, 3), with all that depends on it."""
        llh = llh_from_ecef(self._proposal.sites(places))
        pseudolites, watched = replace(self._sources.pseudolites, names=names, llh=llh), self._bare
        # for signals with memory, the epochs are the same at all positions
        sources = replace(self._sources, pseudolites=pseudolites, satellites=watched.case.environment.satellites)
        if set(self._sources.pseudolites.names) <= set(names):
            sources = replace(sources, effects=self.scenario.effects(pseudolites))
        signals = build_signals(watched.motion, self.scenario.epoch.timestamp(), sources)
        if watched.watched is not None:
            signals = signals.at(watched.watched)
        if QUANTITIES[name].level:
            case = replace(watched.case, environment=sources).over(replace(watched.case.shared, signals=signals))
            levels = case.flight.monitor.levels if case.flight.monitor is not None else np.empty((0, 2))
            of = levels[:, 0 if name.startswith("hpl") else 1]
            return float(np.max(of, initial=0.0)) if np.isfinite(of).all() else np.inf
        if name.startswith("fix_"):
            cofactor, _ = geometry_covariance(signals.los, signals.time_scale, 1.0 / signals.fix_sigma**2)
            variance = np.diagonal(cofactor, axis1=1, axis2=2)
            columns = [0, 1] if name == "fix_horizontal" else [2]
            values = np.sqrt(variance[:, columns].sum(axis=1))
        else:
            values = dops(signals.los, signals.time_scale)[:, 1 + "phv".index(name[0])]
        if not np.isfinite(values).all():
            return np.inf
        return float(values.max() if name.endswith("_max") else values.mean())

    def at(self, places: np.ndarray) -> dict[str, float]:
        """DOPs and accuracy of fixes by the geometry kernel, of one placement (k, 3); empty without a solution."""
        if self.placed:
            return {}
        sites = self._proposal.sites(places)[None]
        values, _ = self.geometry.dops(sites)
        sigmas, _ = self.geometry.fix_sigmas(sites)
        of_dops = {f"dop/{name}": float(values[i, 0, 0]) for i, name in enumerate(("pdop", "hdop", "vdop"))}
        of_dops["dop/pdop_max"] = float(values[0, 2, 0])
        return of_dops | {
            f"fix/rms_{name}": float(sigmas[i, 0, 0])
            for i, name in ((1, "horizontal"), (2, "vertical"), (0, "3d"))
        }  # fmt: skip

    def beacons_at(self, places: np.ndarray) -> dict[str, float]:
        """DOPs of ranging beacons at places (b, 3); empty without beacons."""
        if (section := self.scenario.beacons) is None:
            return {}
        time, glide = glide_epochs(self.scenario, self._trajectory)
        seen = BeaconGlide.of(section.model(self.scenario), self._trajectory, time[glide])
        values, _ = seen.dops(self._proposal.sites(places)[None])
        return {"beacons/hdop": float(values[1, 0, 0]), "beacons/vdop": float(values[2, 0, 0]),
                "beacons/vdop_max": float(values[2, 2, 0])}  # fmt: skip

    def found(self) -> Performance:
        """Results of `navsim run` for the present scenario. Raises InputError."""
        case = self._ready
        summary = geometry_summary(case)
        figures = {f"dop/{name}": float(summary[f"/summary/dop/{name}"][0]) for name in ("pdop", "hdop", "vdop")}
        figures["dop/pdop_max"] = float(summary["/summary/dop/pdop"][2])
        for name in ("horizontal", "vertical", "3d"):
            figures[f"fix/rms_{name}"] = float(summary[f"/summary/fix/rms_{name}"][0])
        if self.scenario.beacons is not None:
            hdop, vdop = (summary[f"/summary/beacons/{name}"] for name in ("hdop", "vdop"))
            figures |= {"beacons/hdop": float(hdop[0]), "beacons/vdop": float(vdop[0])}
            figures["beacons/vdop_max"] = float(vdop[2])
        if self.scenario.integrity is not None and self.scenario.integrity.method != "filter":
            figures |= {f"integrity/{name}": value for name, value in integrity.level_outputs(case).items()}
        glide = integrity.glide_of(case)
        figures["lost"] = float(np.isnan(case.shared.dop[glide, 1]).sum())
        return Performance(figures, self._shares(case, glide), case.warnings)

    def _shares(self, case: Case, glide: np.ndarray) -> list[Share]:
        """All sources above the horizon, or used."""
        signals = case.shared.signals
        los, out = signals.los[glide], []
        if not len(los):
            return []
        middle = np.flatnonzero(glide)[len(los) // 2]
        ground = case.pseudolites.names
        for i, name in enumerate(signals.names):
            used = bool(signals.used[glide][:, i].any())
            elevation = float(np.degrees(signals.elevation[middle, i]))
            if not used and not elevation > 0.0:
                continue
            without = np.nan
            if used:
                rest = los.copy()
                rest[:, i] = np.nan
                without = float(dops(rest, signals.time_scale)[:, 1].mean())
                without = without if np.isfinite(without) else np.inf
            azimuth = float(np.degrees(signals.azimuth[middle, i]) % 360.0)
            out.append(Share(name, azimuth, elevation, used, name in ground, without))
        return out
