"""Shared by all tests: where the outside material lies, and the shipped scenarios."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# the first example of a kernel may have to compile it
settings.register_profile("navsim", deadline=None)
settings.load_profile("navsim")

# in the background of a script Ctrl-C is ignored, and by all that is started from there; tests send it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# half a million objects live as long as the tests: to look for garbage among them takes a twentieth of the time
gc.set_threshold(50_000, 20, 50)

# what the developer has installed for editors is none of the tests'
os.environ["XDG_DATA_HOME"] = "/dev/null/data"

# processes of the tests keep what they compile of Python: the start of one takes half as long then
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# tests run in two processes already, and threads of numpy that wait for each other would take their time
os.environ["NAVSIM_SECOND_PROCESS"] = "off"
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as in a command; read when numpy is imported

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
SCENARIOS = ROOT / "scenarios"
DATA = ROOT / "tests" / "data"
"""Figures of others that tests compare with."""
LANDINGS = sorted(p.stem for p in SCENARIOS.glob("*.yaml") if "kind: landing\n" in p.read_text())
"""Shipped scenarios of kind landing; the other files are studies."""


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of other people's files; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the files in ../shared, which is not here")
    return SHARED


@pytest.fixture(scope="session")
def oracles() -> dict[str, Any]:
    """Published figures and worked examples; `tests/data/SOURCE.md` says whose."""
    return json.loads((DATA / "oracles.json").read_text())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--validation", metavar="FILE", help="write the table of oracle tests to FILE")
    parser.addoption("--long", action="store_true", help="run the tests marked long, and no others")
    parser.addoption("--baselines", action="store_true", help="write the pictures of tests/baselines anew")
    parser.addoption("--as-written", action="store_true", help="run all documented commands at length")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked long are for `make validate`."""
    split: dict[bool, list[pytest.Item]] = {True: [], False: []}
    for item in items:
        split[bool(item.get_closest_marker("long")) == config.getoption("--long")].append(item)
    config.hook.pytest_deselected(items=split[False])
    items[:] = split[True]


SHARES = {"": 1.0, "(relative)": 1.0, "%": 0.01}
UNITS = ("m", "m2", "m/s", "m/s2", "m/s rms an axis", "s", "rad", "deg", "deg/s", "deg/s2", "Pa", "dB", "uT")
"""Units that tolerances of oracle tests may have: those that the tests compute in."""


class Within(dict[str, float]):
    """The tolerances of an oracle test by what they are of, and which of them the test has used.

    Raises pytest.UsageError for a unit that no test computes in: a tolerance of `1 mm` would be one of 1 m.
    """

    def __init__(self, texts: dict[str, str]) -> None:
        super().__init__()
        for name, text in texts.items():
            number, _, unit = text.partition(" ")
            if unit not in UNITS and unit not in SHARES:
                known = ", ".join([*UNITS, "%", "(relative)"])
                raise pytest.UsageError(f"{name}={text!r}: unknown unit {unit!r}; give it in one of {known}")
            self[name] = float(number) * SHARES.get(unit, 1.0)
        self.unused = set(texts)

    def __getitem__(self, name: str) -> float:
        self.unused.discard(name)
        return super().__getitem__(name)


_WITHIN = pytest.StashKey[Within]()


@pytest.fixture
def within(request: pytest.FixtureRequest) -> Within:
    """The numbers that the test's mark `validates` promises, the only place where they stand: `place="2e-3 m"` there is
    `within["place"]` in the test, in the unit that is given, per cent as a share."""
    return request.node.stash[_WITHIN]


@dataclass
class Row:
    """An oracle test of docs/validation.md: where it stands, what it says, how it ended, and what of its tolerances no
    case of it has used."""

    file: str
    line: int
    claim: str
    oracle: str
    tolerance: str
    outcome: str
    unused: set[str]


_rows: dict[str, Row] = {}


def pytest_runtest_setup(item: pytest.Item) -> None:
    mark = item.get_closest_marker("validates")
    if mark is not None:
        item.stash[_WITHIN] = Within(mark.kwargs)


def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """What the page says of a test travels with its report, from the process that ran it."""
    if call.when == "teardown":
        item.user_properties.append((CPU, _cpu_s() - item.stash[_BEGAN]))
    mark = item.get_closest_marker("validates")
    if mark is None or call.when == "teardown" or _WITHIN not in item.stash:  # the last: its mark is wrong
        return
    claim, oracle, *rest = mark.args
    tolerances = ", ".join(f"{name.replace('_', ' ')}: {text}" for name, text in mark.kwargs.items())
    told = [claim, oracle, " ".join(filter(None, [tolerances, *rest])), sorted(item.stash[_WITHIN].unused)]
    item.user_properties[:] = [("validates", told)]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Gather the results of oracle tests, where several processes run them in the one that hears of all."""
    told, cpu = (dict(report.user_properties).get(name) for name in ("validates", CPU))
    if cpu is not None and report.when == "teardown":
        _cpu[report.nodeid] += cpu
        if (node := getattr(report, "node", None)) is not None:
            _last[node.gateway.id] = time.monotonic()
    if told is None or not (report.when == "call" or (report.when == "setup" and report.outcome != "passed")):
        return
    claim, oracle, tolerance, unused = told
    file, line, _ = report.location
    name = report.nodeid.split("[")[0]
    row = _rows.setdefault(name, Row(file, line or 0, claim, oracle, tolerance, report.outcome, set(unused)))
    row.unused &= set(unused)
    if report.outcome == "failed":
        row.outcome = report.outcome


def pytest_unconfigure() -> None:
    """What is left ends with the process: pytest need not look for garbage among millions of objects."""
    gc.freeze()


CPU = "cpu_s"
"""What reports call the processor time of a test."""


def _cpu_s() -> float:
    """Processor time of this process and of those that it started, the living ones among them where /proc tells."""
    spent = os.times()
    total = spent.user + spent.system + spent.children_user + spent.children_system
    waiting = [os.getpid()]
    while waiting:
        for listed in Path(f"/proc/{waiting.pop()}/task").glob("*/children"):
            with suppress(OSError):  # it has ended in between
                for child in listed.read_text().split():
                    fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
                    total += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
                    waiting.append(int(child))
    return total


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """What a test costs, with what is made for it, travels with its last report."""
    item.stash[_BEGAN] = _cpu_s()
    return (yield)


_BEGAN = pytest.StashKey[float]()
_cpu: Counter[str] = Counter()
_last: dict[str, float] = {}
"""When each process of tests has ended its last one."""
DEAREST = 10
"""Tests that the end of a session names."""


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """The sum of processor time and the dearest tests: the suite has to fit in a quarter of an hour on two cores."""
    files: Counter[str] = Counter()
    for name, seconds in _cpu.items():
        files[name.partition("::")[0]] += seconds
    terminalreporter.write_sep("=", f"{sum(_cpu.values()):.0f} s of processor time")
    for name, end in sorted(_last.items()):
        terminalreporter.write_line(f"{max(_last.values()) - end:6.1f} s  without work at the end: {name}")
    for dearest in (files, _cpu):
        for name, seconds in dearest.most_common(DEAREST):
            terminalreporter.write_line(f"{seconds:6.1f} s  {name}")


SUBJECTS = {
    "error_state": "The filter", "cramer_rao": "Covariance of the filter",
    "tight": "Tight coupling, monitored filters", "smoother": "Smoother", "strapdown": "Strapdown navigation",
    "sensors": "Inertial sensors", "dop": "Dilution of precision", "single_point": "Single point",
    "pseudolites": "Pseudolites", "beacons": "Beacons", "ranging": "Recorded ranges", "integrity": "Integrity",
    "gbas_station": "GBAS corrections",
    "tails": "Risk behind levels", "importance_sampling": "Importance sampling", "interference": "Interference",
    "orbits": "Orbits", "sky": "Galileo, BeiDou, QZSS", "atmosphere": "Ionosphere and troposphere",
    "rinex": "Reading RINEX", "export": "Exported RINEX", "earth": "Coordinates and gravity", "runway": "Runway",
    "paths": "Paths", "track": "Recorded trajectories", "air": "Wind and turbulence",
    "heights": "Air pressure and geoid", "ground": "Headings, rest and wheels", "ground_stations": "Ground stations",
    "table2": "Table 2 of the landing paper", "elevation": "MLS elevation", "azimuth": "The landing circuit",
    "atc": "Tracking with onboard data",
}  # fmt: skip
"""Headings of docs/validation.md in their order, by test file."""
_NOT_RUN = {"passed": "", "skipped": ", not run"}
"""What a row says behind its tolerance, by the outcome of its test."""


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write docs/validation.md from the oracle tests, none of which may fail: claim, oracle, tolerance."""
    target = session.config.getoption("--validation")
    if not target or hasattr(session.config, "workerinput"):
        return
    failed = [name for name, row in _rows.items() if row.outcome == "failed"]
    idle = {name: row.unused for name, row in _rows.items() if row.outcome == "passed" and row.unused}
    if failed or idle:
        raise pytest.UsageError(f"no page: tests failed: {failed}; tolerances that their tests do not use: {idle}")
    order = [f"test_{stem}" for stem in SUBJECTS]
    in_order = sorted(_rows.items(), key=lambda row: (order.index(Path(row[1].file).stem), row[1].line))
    Path(target).write_text(validation_page(in_order))


SCRIPT = ("independent script", "Riccati solver of an independent script")
"""How the reference of a row begins that the developers wrote, and nobody else confirms."""


def validation_page(in_order: list[tuple[str, Row]]) -> str:
    """Text of docs/validation.md: name and row of each test."""
    from navsim.report.assurance import JUDGES, UNCHECKED
    from navsim.report.citations import METHODS

    alone = {row.claim for _, row in in_order if row.oracle.startswith(SCRIPT)}
    lines = [
        "# Validation",
        "",
        "Does navsim compute correctly? Each row has a quantity that navsim computes, the reference that the test",
        "compares it with, and the largest difference that the test allows (or error, where a row says so).",
        "All rows hold: `make docs` writes this page only if no test fails. A tolerance in % or marked",
        "(relative) is a share of the value. navsim's developers wrote each *independent script* from published",
        f"formulas, without its code. In {len(alone)} of {len(in_order)} rows it is the only reference.",
        "",
        "| no outside reference has checked these methods |",
        "|---|",
        *(f"| {each.name} |" for each in METHODS if each.name not in JUDGES),
        *(f"| {part} |" for part in UNCHECKED),
        "",
        "| only an independent script of the developers has checked these methods |",
        "|---|",
        *(f"| {each.name} |" for each in METHODS if each.name in JUDGES and alone.issuperset(JUDGES[each.name])),
        "",
        "Such a script is all that confirms `eskf`. The default filter is a sum of several Gaussians: only simulated",
        "landings [test it](sigma.md).",
    ]
    for file, rows in groupby(in_order, lambda row: row[1].file):
        lines += ["", f"## {SUBJECTS[Path(file).stem.removeprefix('test_')]}", ""]
        lines += ["| navsim computes | compared with | largest difference | test |", "|---|---|---|---|"]
        lines += [
            f"| {row.claim} | {row.oracle} | {row.tolerance or 'exact'}{_NOT_RUN[row.outcome]} "
            f"| `{name.split('::')[-1]}` |"
            for name, row in rows
        ]
    return "\n".join([*lines, ""])
