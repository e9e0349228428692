"""List of the kinds of scenario files and results.

Modules of a kind are named here as text and imported when needed, so that `--help` can list the kinds, and a landing
loads nothing of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Kind:
    """A kind of files or results. Places in code are "module:name"."""

    command: str
    """Command that computes it."""
    view: str
    """How its results are shown (`report.view.View`)."""
    section: str = ""
    """Model of the file (a `scenario_files.base.Section`), "" without a file."""
    job: str = ""
    """Creates its job (`runner.job.Opener`), "" if only the command can."""
    noun: str = "scenario"
    """Name of such a file in messages."""
    check: str = ""
    """Warnings about a file, which reads the files that it names as the job does (`runner.job.Check`); "" if the
    section checks everything."""
    completed: str = ""
    """Writes into the data of a file what it takes from results, before it is validated; "" if it takes nothing."""
    ensemble: str = ""
    """Verifies results by some of their runs (`runner.verification.EnsembleCheck`), "" for kinds without runs."""


KINDS = {
    "landing": Kind(
        "run", "navsim.report.landing:VIEW", "navsim.scenario.landing:Landing", "navsim.landing.job:job",
        check="navsim.landing.preflight:warnings_of", completed="navsim.replays.for_landings:completed",
        ensemble="navsim.landing.verification:check_ensemble",
    ),
    "mls-elevation": Kind(
        "run", "navsim.companions.elevation.report:VIEW", "navsim.companions.elevation.scenario:Elevation",
        "navsim.companions.jobs:mls_elevation",
    ),
    "atc-tracking": Kind(
        "run", "navsim.companions.atc.report:VIEW", "navsim.companions.atc.scenario:Atc",
        "navsim.companions.jobs:atc_tracking",
    ),
    "azimuth-tracking": Kind(
        "run", "navsim.companions.azimuth.report:VIEW", "navsim.companions.azimuth.scenario:Azimuth",
        "navsim.companions.jobs:azimuth_tracking",
    ),
    "sweep": Kind(
        "sweep", "navsim.sweeps.report:VIEW", "navsim.sweeps.scenario:Sweep", "navsim.sweeps.job:SweepJob", "study",
        "navsim.sweeps.job:check",
    ),
    "optimize": Kind(
        "optimize", "navsim.optimization.report:VIEW", "navsim.optimization.scenario:Optimize",
        "navsim.optimization.job:OptimizeJob", "study", "navsim.optimization.job:check",
    ),
    "replay": Kind(
        "replay", "navsim.replays.report:VIEW", "navsim.replays.scenario:Replay", "navsim.replays.job:ReplayJob",
        "log", "navsim.replays.job:check",
    ),
    "ranges": Kind(
        "replay", "navsim.ranging.report:VIEW", "navsim.ranging.scenario:RecordedRanges", "navsim.ranging.job:RangeJob",
        "log", "navsim.ranging.job:check",
    ),
    "table2": Kind(
        "table2", "navsim.published_tables.table2_report:VIEW", job="navsim.published_tables.table2_job:job"
    ),
    "integrity-table": Kind(
        "integrity-table", "navsim.published_tables.integrity_table_report:VIEW",
        job="navsim.published_tables.integrity_table_job:job",
    ),
    "live": Kind("live", "navsim.live.report:VIEW"),
}  # fmt: skip
OF_FILES = tuple(name for name, kind in KINDS.items() if kind.section)
"""The kinds that files have."""


def named(place: str) -> Any:
    """Object at "module:name"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def advice(kind: str, path: object) -> str:
    """Which commands take the file of this kind."""
    this = KINDS[kind]
    return f"a {this.noun} of kind {kind}: use navsim {this.command} {path} or navsim validate {path}"
