"""A small result of every kind, for tests of what people see of them."""

from __future__ import annotations

import fcntl
import shutil
from pathlib import Path

from navsim.formats.export import export
from navsim.results.result import read
from tests.conftest import SCENARIOS
from tests.forks import navsim

EVIL = "<script>alert('title')</script>"
_GLIDE = ("--set", "duration_s=65", "--set", "imu.rate_hz=20", "--set", "receiver.rate_hz=1")
_QUIET = ("-q", "--figures", "none")
_BEACONS = (
    "beacons={sites: [{s_m: 60, l1_m: 150}, {s_m: -60, l1_m: 150, height_m: 12}, {s_m: 60, l1_m: -150, "
    "height_m: 12}, {s_m: -60, l1_m: -150}], rate_hz: 4, sigma_m: 0.1, range_limit_m: 1500}"
)
_LIMITS = "integrity={method: chi2, limits: {hal_m: 40, val_m: 60, tta_s: 2}}"
COMMANDS: dict[str, tuple[object, ...]] = {
    "one": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET),
    "cut": ("run", SCENARIOS / "landing.yaml", "--set", "duration_s=6", *_QUIET),
    "runs": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET, "--runs", 30, "--keep", "all", "--set", _LIMITS,
             "--set", "box={lateral_m: 1.5, vertical_m: 1.5}", "--set",
             "approach.indicator={system: ils, until_height_m: 20}", "--set",
             "approach.flight_technical_error={lateral: {sigma_m: 2}, vertical: {sigma_m: 1}}", "--set",
             "requirements=[{what: rms, of: horizontal, below_m: 0.2}, "
             "{what: error, of: lateral, at: touchdown, below_m: 1.2}]"),
    "evil": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET, "--runs", 30, "--set", f"title={EVIL}", "--set",
             "runway.heading_deg=33", "--set", "interference={jammers: [{name: \"<b>van</b>\", place: {lat_deg: 56.01, "
             "lon_deg: 37.0}, height_m: 10, eirp_dbw: -10, waveform: tone}]}"),
    "none": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET, "--runs", 5, "--keep", "none"),
    "covariance": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET, "--method", "covariance", "--set",
                   "filter.coupling=tight", "--set", _BEACONS),
    "rare": ("run", SCENARIOS / "landing.yaml", *_GLIDE, *_QUIET, "--method", "rare", "--runs", 30, "--set",
             "box={lateral_m: 0.8, vertical_m: 1.2}"),
    "sweep": ("sweep", SCENARIOS / "placement_sweep.yaml", "--set", "vary.1.grid.count=6", "--set",
              "vary.2.grid.count=6", "--set", "outputs=[pdop, vdop, fix_vertical]", *_QUIET),
    "sweep-numbers": ("sweep", SCENARIOS / "placement_sweep.yaml", "--set",
                      "set={pseudolites.count: 1, pseudolites.s_m: 60, pseudolites.l1_m: 900, receiver.rate_hz: 0.5}",
                      "--set", "vary=[{key: sky.mask_deg, range: {first: 0, last: 20, step: 5}}, "
                      "{key: pseudolites.range_sigma_m, range: {first: 1, last: 9, step: 2}}]", "--set",
                      "outputs=[fix_vertical]", *_QUIET),
    "sweep-names": ("sweep", SCENARIOS / "placement_sweep.yaml", "--set", "vary=[{key: sky.source, "
                    "values: [nominal-gps, nominal-glonass]}, {key: sky.mask_deg, values: [3, 20]}]", "--set",
                    "outputs=[pdop]", *_QUIET),
    "optimize": ("optimize", SCENARIOS / "placement_optimum.yaml", "--set", "pseudolites=[1, 2]", "--set", "effort=1",
                 "--runs", 8, *_QUIET),
    "replay": ("replay", SCENARIOS / "recorded_flight.yaml", "--set", "tuning=none", *_QUIET),
    "ranges": ("replay", SCENARIOS / "recorded_ranges.yaml", "--set", "tuning=none", "--set", "end_s=60", *_QUIET),
    "mls-elevation": ("run", SCENARIOS / "mls_elevation.yaml", "--set", "montecarlo.experiments=5", *_QUIET),
    "atc-tracking": ("run", SCENARIOS / "atc_tracking.yaml", "--runs", 5, "--set", "link.study_runs=5", *_QUIET),
    "azimuth-tracking": ("run", SCENARIOS / "azimuth_tracking.yaml", "--runs", 5, "--set", "map.runs=3", *_QUIET),
    "integrity-table": ("integrity-table", "--set", _LIMITS, "-q"),
}  # fmt: skip
"""Commands that make a small result each."""


def _table2(folder: Path) -> None:
    done = navsim("table2", "--runs", 12, "-o", "t2", cwd=folder)
    (folder / "t2" / "printed.txt").write_text(done.stdout, encoding="utf-8")
    shutil.copy(folder / "t2" / "table2.h5", folder)


def _live(folder: Path) -> None:
    _once("one", folder)
    (sentences,) = export(read(folder / "one.h5"), folder / "sent.h5", ["nmea"])
    navsim("live", SCENARIOS / "landing.yaml", *_GLIDE, "--receiver", sentences, "-o", "live.h5", cwd=folder)


def _once(name: str, folder: Path, wait: bool = True) -> None:
    """Make a result unless it is there; with another process at it, wait for it or leave it alone."""
    with open(folder / f".{name}.lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            return
        if (folder / f"{name}.h5").exists():
            return
        if name in COMMANDS:
            navsim(*COMMANDS[name], "-o", f"{name}.h5", cwd=folder)
        else:
            {"table2": _table2, "live": _live}[name](folder)


def make(folder: Path) -> None:
    """Results by the names of `EVERY`. Processes that are at it at the same time share the work."""
    for wait in (False, True):
        for name in EVERY:
            _once(name, folder, wait)


EVERY = (*COMMANDS, "live", "table2")
