"""Compare the results of two checkouts of navsim bit by bit.

    python scripts/same_results.py A B [--keep FOLDER] [--only PATTERN]

A and B are folders with a checkout each. Every case below is run by both, and every dataset, attribute, exported file
and printed table is compared. Paths of results that B renames stand in `RENAMED`. The script prints what differs; its
exit code is then 1. With `--keep`, results stay in FOLDER, and those of a checkout without changes since its commit are
not computed again. `--only` takes the cases whose names match PATTERN.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml

from navsim.results.former_names import with_present_names
from navsim.results.schema import NOT_REPEATED, PROVENANCE

RENAMED: dict[str, str] = {
    "/front": "/pareto", "/useful": "/subsets", "/useful/subsets": "/subsets/number",
    "/useful/subsets_of_all": "/subsets/number_of_all", "/audit": "/published", "/fit/letter": "/fit/id",
}  # fmt: skip
"""Paths of datasets and groups in results of A, each with its path in results of B."""
EXCEPTED = (*NOT_REPEATED, PROVENANCE)
"""Attributes and groups that name the version, the time of computation, the code and the machine."""
_OF_THE_CLOCK = re.compile(
    rb"^compiling the kernels.*\n|^.* s used.*\n|^.*PGM / RUN BY / DATE *\n|about [\d.]+ s on this .*?timed\), ",
    re.MULTILINE,
)
"""What files say of the time: kernels that the cache lacked, progress, dates, how long work takes."""
_OF_THE_FORMAT = ("DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes with references to places in the file, which netCDF keeps for dimensions."""

_BRIEF = "--set duration_s=6 --set receiver.rate_hz=2"
_LIMITS = "--set integrity.limits.operation=LPV-200 --set integrity.limits.tta_s=6"
_TIGHT = "--set filter.coupling=tight"
_SENSORS = """--set imu.gyro.scale_ppm=2000 --set imu.accelerometer.misalignment_mrad=2
    --set 'radio_altimeter={sigma_floor_m: 0.5, sigma_share: 0.02, highest_m: 200}'
    --set 'barometric_altimeter={sigma_m: 0.5, qnh_error_hpa: 1, drift_m: 2}'
    --set filter.barometric_altimeter.errors=states --set runway.geoid_undulation_m=15"""
_JAMMER = """--set 'interference.jammers=[{name: j, place: {lat_deg: 56.01, lon_deg: 37}, height_m: 10, eirp_dbw: -20,
    waveform: noise, centre_mhz: 1590, bandwidth_mhz: 60}]'"""
_GRID = "--set vary.1.grid.count=2 --set vary.2.grid.count=2"
_SWEEP = f"""sweep scenarios/placement_sweep.yaml -o {{out}} {_GRID}
    --set 'set={{pseudolites.frame: runway, duration_s: 61, receiver.rate_hz: 1}}'"""
_LANDINGS = (
    "landing", "circuit", "landing_gnss_only", "landing_open_sky", "landing_smooth", "s_turn", "table2",
    "table2_almanac", "table2_row1", "table2_weighted", "track",
)  # fmt: skip
_BEACONS = ("beacons_pad", "beacons_uav")
_FILTERS = ("tfg", "eskf", "left-invariant", "gaussian-sum", "rts", "map")
_LANDING = f"run scenarios/landing.yaml -o {{out}} {_BRIEF}"
_SMOOTH = f"run scenarios/landing_open_sky.yaml -o {{out}} {_BRIEF}"
_REPLAY = "replay scenarios/recorded_flight.yaml -o {out} --set tuning=none --set filter.output_rate_hz=1"
_OPTIMIZE = "-o {out} --set effort=1 --set pseudolites=[1]"
CASES = {
    **{name: f"run scenarios/{name}.yaml -o {{out}} --runs 2 {_BRIEF}" for name in _LANDINGS},
    **{name: f"run scenarios/{name}.yaml -o {{out}} --runs 2 {_BRIEF} --set events.0.at_s=3" for name in _BEACONS},
    "odense": "run scenarios/odense.yaml -o {out} --set receiver.rate_hz=1",
    **{f"loose-{kind}": f"{_LANDING} --runs 2 --set filter.kind={kind}" for kind in _FILTERS},
    **{f"tight-{kind}": f"{_SMOOTH} --runs 2 {_TIGHT} --set filter.kind={kind}" for kind in _FILTERS},
    "whole-flight": "run scenarios/landing.yaml -o {out} --keep all --set receiver.rate_hz=1 --set filter.kind=tfg",
    "sensors": f"{_SMOOTH} --runs 2 {_SENSORS} --set filter.kind=eskf",
    "sensors-tight": f"{_SMOOTH} {_SENSORS} {_TIGHT} --set filter.kind=tfg",
    "covariance": f"{_LANDING} --method covariance --set filter.kind=tfg",
    "covariance-tight": f"{_SMOOTH} --method covariance {_TIGHT} {_SENSORS} --set filter.kind=eskf",
    "rare": """run scenarios/landing.yaml -o {out} --method rare --runs 8 --set duration_s=61 --set receiver.rate_hz=1
        --set filter.kind=tfg --set 'box={lateral_m: 4, vertical_m: 4}'""",
    "mhss": f"""{_LANDING} --runs 2 --set integrity.method=mhss {_LIMITS} --set integrity.exclusion=residual
        --set 'integrity.tails={{at_s: [5], samples: 1000}}'
        --set 'events=[{{what: step, sources: [R01], at_s: 3, error_m: 30}}]'""",
    "chi2": f"{_LANDING} --runs 2 --set integrity.method=chi2 {_LIMITS} --set integrity.exclusion=rms",
    "watched-filter": f"""{_SMOOTH} --runs 2 --set filter.kind=tfg {_TIGHT} --set filter.fix_errors=inflate
        --set integrity.method=filter {_LIMITS} --set integrity.innovations.window_s=3""",
    "jammer": f"{_LANDING} --runs 2 {_JAMMER}",
    "almanac": f"{_LANDING} --set 'sky={{source: almanac, almanac: scenarios/data/nominal.agl, mask_deg: 5}}'",
    "navigation": f"{_LANDING} --set sky.source=navigation --set sky.navigation=scenarios/data/nominal.rnx",
    "first-part": f"{_LANDING} --runs 2 --set filter.kind=tfg",
    "second-part": f"{_LANDING} --runs 2 --first-run 2 --set filter.kind=tfg",
    "merge": "merge {first-part} {second-part} -o {out}",
    "mls_elevation": "run scenarios/mls_elevation.yaml -o {out} --runs 3",
    "atc_tracking": "run scenarios/atc_tracking.yaml -o {out} --runs 3 --set link.study_runs=2",
    "azimuth_tracking": "run scenarios/azimuth_tracking.yaml -o {out} --runs 3 --set map.runs=0",
    "recorded_flight": _REPLAY,
    "replay-smoothed": f"{_REPLAY} --set filter.kind=rts --set outages=[]",
    "placement_sweep": _SWEEP,
    "sweep-covariance": f"{_SWEEP} --method covariance",
    "sweep-runs": f"{_SWEEP} --method monte-carlo --runs 2",
    "jammer_places": f"sweep scenarios/jammer_places.yaml -o {{out}} {_GRID.replace('vary.2', 'vary.0')}",
    "placement_optimum": f"optimize scenarios/placement_optimum.yaml {_OPTIMIZE}",
    "placement_lpv200": f"optimize scenarios/placement_lpv200.yaml {_OPTIMIZE}",
    "published": "table2 -o published --runs 2 -q",
    "integrity-table": "integrity-table -o {out} --set receiver.rate_hz=1 --set integrity.method=chi2 " + _LIMITS,
    "live": "live scenarios/landing.yaml --receiver whole-flight_gnss.csv -o {out} --set duration_s=6",
    "dry-run": f"{_LANDING} --runs 50 --dry-run --set filter.kind=left-invariant",
    "validate": "validate scenarios/odense.yaml",
}
"""Command lines by the name of the case: {out} is the file of its result, {NAME} that of an earlier case."""
_SHOWN = ("show {out}", "cite {out}")
"""Commands that print each result."""
_EXPORTED = {
    "whole-flight": ("export {out} --rinex --nmea --kml --geojson --csv --imu",),
    "published": ("show published/table2.h5", "cite published/table2.h5"),
    "recorded_flight": ("export {out} --kml --csv",),
}
"""Other commands on a result."""
_DRIVER = """
import importlib, json, os, pkgutil, sys, traceback
import navsim
for module in pkgutil.walk_packages(navsim.__path__, "navsim."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from navsim.__main__ import main
for name, words in json.load(sys.stdin):
    pid = os.fork()
    if not pid:
        for number, stream in enumerate((os.devnull, name + ".txt", name + ".txt")):
            os.dup2(os.open(stream, os.O_RDWR | os.O_CREAT | os.O_APPEND), number)
        code = 1
        try:
            sys.argv = ["navsim", *words]
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    ended = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if ended:
        print(name, words[0], "ends with exit code", ended, flush=True)
"""


def commands(name: str) -> Iterator[list[str]]:
    """Words of each command of a case."""
    has_result = "{out}" in CASES[name] and "--dry-run" not in CASES[name]
    for line in (CASES[name], *(_SHOWN if has_result else ()), *_EXPORTED.get(name, ())):
        for other in ("out", *CASES):
            line = line.replace(f"{{{other}}}", f"{name if other == 'out' else other}.h5")
        words = shlex.split(line)
        is_quiet = words[0] in ("run", "sweep", "optimize", "replay") and "--dry-run" not in words
        yield [*words, *(("-q", "--figures", "none") if is_quiet else ())]


def revision(checkout: Path) -> str:
    """Commit of a checkout without changes; "" where files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", checkout, *words], capture_output=True, text=True, check=True
        ).stdout.strip()

    return "" if git("status", "--porcelain", "navsim", "scenarios") else git("rev-parse", "HEAD")


def compute(checkout: Path, folder: Path, names: Sequence[str]) -> None:
    """Run cases by a checkout, with their results in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [name for name in names if not (folder / f"{name}.txt").exists()]
    if not missing:
        return
    shutil.copytree(checkout / "scenarios", folder / "scenarios", dirs_exist_ok=True)
    told = json.dumps([(name, words) for name in missing for words in commands(name)])
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
    command = [sys.executable, "-c", _DRIVER]
    done = subprocess.run(
        command, input=told, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    if done.stdout:
        raise SystemExit(f"{done.stdout}{checkout}: a case that fails compares nothing; see {folder}/CASE.txt")


def contents(file: Path) -> dict[str, Any]:
    """Everything that a result holds: bits of datasets and attributes, by path."""
    found: dict[str, Any] = {}

    def bits(value: Any) -> Any:
        array = np.asarray(value)
        return array.tolist() if array.dtype.hasobject else (array.dtype.str, array.shape, array.tobytes())

    def take(path: str, node: Any) -> None:
        if path.startswith(EXCEPTED):
            return
        found[path] = bits(node[()]) if isinstance(node, h5py.Dataset) else "group"
        for name in sorted(set(node.attrs) - set(EXCEPTED) - set(_OF_THE_FORMAT)):
            value = node.attrs[name]
            if name in ("scenario", "study"):  # keys by their present names, in any order
                value = json.dumps(with_present_names(yaml.safe_load(value)), sort_keys=True, default=str)
            found[f"{path}@{name}"] = bits(value)

    with h5py.File(file) as result:
        take("", result)
        result.visititems(lambda path, node: take(f"/{path}", node))
    return found


def renamed(path: str, table: Mapping[str, str]) -> str:
    """Path in results of B for a path in results of A: the longest beginning that stands in the table is changed."""
    place, at, attribute = path.partition("@")
    parts = place.split("/")
    for count in range(len(parts), 0, -1):
        if (begin := "/".join(parts[:count])) in table:
            return "/".join([table[begin], *parts[count:]]) + at + attribute
    return path


def differences(a: Path, b: Path, table: Mapping[str, str]) -> list[str]:
    """What differs between two results, by path."""
    first = {renamed(path, table): value for path, value in contents(a).items()}
    second = contents(b)
    only = [f"{path}: only in {'A' if path in first else 'B'}" for path in sorted(first.keys() ^ second.keys())]
    return only + [f"{path}: differs" for path in sorted(first.keys() & second.keys()) if first[path] != second[path]]


def owner(file: Path) -> str:
    """Case that has made a file: that of the longest name which the file's begins with; "" of no case."""
    return max((name for name in CASES if re.match(rf"{name}[._]|{name}$", file.parts[0])), key=len, default="")


def printed(file: Path) -> bytes:
    """Contents of a file without what tells the time of its making."""
    return _OF_THE_CLOCK.sub(b"", file.read_bytes())


def compare(a: Path, b: Path, names: Sequence[str]) -> list[str]:
    """What differs between the files of cases in two folders."""
    files = {
        str(path.relative_to(folder))
        for folder in (a, b)
        for path in folder.glob("**/*")
        if path.is_file() and owner(path.relative_to(folder)) in names
    }
    found = []
    for name in sorted(files):
        if not (a / name).exists() or not (b / name).exists():
            found.append(f"{name}: only in {'A' if (a / name).exists() else 'B'}")
        elif name.endswith(".h5"):
            found += [f"{name}{line}" for line in differences(a / name, b / name, RENAMED)]
        elif printed(a / name) != printed(b / name):
            found.append(f"{name}: differs")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("a", type=Path)
    parser.add_argument("b", type=Path)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--only", default="", help="regular expression for the names of cases")
    asked = parser.parse_args()
    names = [name for name in CASES if re.search(asked.only, name)]
    with tempfile.TemporaryDirectory() as temporary:
        folders: list[Path] = []
        for side, checkout in (("a", asked.a), ("b", asked.b)):
            kept = asked.keep and revision(checkout)
            folders.append(asked.keep / kept if kept else Path(temporary) / side)
            compute(checkout, folders[-1], names)
        found = compare(folders[0], folders[1], names)
    print("\n".join(found) or f"{len(names)} cases: equal to the bit")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
