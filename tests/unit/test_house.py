"""The one-way street of `docs/architecture.md`, and what must not be imported for `--help`."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from navsim.report.table import cell
from navsim.statistics.rounding import digits

PACKAGE = Path(__file__).resolve().parents[2] / "navsim"
BASE = {"compiler", "geodesy", "statistics", "defect"}
WORLD = BASE | {"trajectory", "gnss", "sensors"}
FILES = BASE | {"filter", "results", "formats"}
YAML = {"scenario_files", "scenario"}
LANDING = YAML | {"simulation", "report", "page", "runner", "environment", "landing"}
ALLOWED = {
    "compiler": set(),
    "geodesy": {"compiler"},
    "statistics": {"compiler"},
    "trajectory": BASE,
    "gnss": BASE | {"trajectory"},
    "filter": BASE,
    "sensors": BASE | {"trajectory", "gnss", "filter"},
    "integrity": BASE | {"gnss", "filter"},
    "error_propagation": {"compiler", "filter"},
    "simulation": WORLD | {"filter", "integrity", "error_propagation"},
    "results": BASE,
    "formats": WORLD | {"filter", "results"},
    "logs": WORLD | {"results", "formats"},
    "scenario_files": {"statistics", "results", "formats", "kinds"},
    "scenario": WORLD | FILES | {"scenario_files", "kinds"},
    "report": FILES | {"kinds"},
    "page": FILES | {"report", "kinds"},
    "runner": FILES | {"logs", "scenario_files", "scenario", "report", "kinds"},
    "environment": WORLD | FILES | YAML,
    "landing": WORLD | FILES | YAML | {"integrity", "simulation", "report", "runner", "environment"},
    "published_tables": WORLD | FILES | LANDING | {"integrity"},
    "recording_checks": WORLD | FILES,
    "sweeps": WORLD | FILES | LANDING,
    "optimization": WORLD | FILES | LANDING | {"sweeps"},
    "ranging": FILES | YAML | {"gnss", "runner", "report", "page"},
    "replays": WORLD | FILES | LANDING | {"logs", "recording_checks", "ranging"},
    "live": WORLD | FILES | LANDING | {"replays"},
    "companions": FILES | YAML | {"runner", "report", "page"},
    "planner": WORLD | FILES | LANDING - {"runner"} | {"optimization"},
    "api": FILES | YAML | {"report", "runner"},
    "cli": FILES | LANDING | {"logs", "published_tables", "replays", "live", "planner", "kinds"},
}


@cache
def tree(source: Path) -> ast.Module:
    """The parsed file."""
    return ast.parse(source.read_text())


@cache
def nodes(source: Path) -> tuple[ast.AST, ...]:
    """All nodes of the parsed file."""
    return tuple(ast.walk(tree(source)))


@pytest.fixture(autouse=True, scope="module")
def _forgotten_afterwards() -> Iterator[None]:
    """The nodes of all files are many, which would slow the collection of garbage in later tests."""
    yield
    tree.cache_clear()
    nodes.cache_clear()


def rooms_imported(source: Path) -> set[str]:
    """Rooms of navsim that a file imports, also inside functions."""
    found = set()
    for node in nodes(source):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "navsim":
                names = [f"navsim.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        else:
            continue
        found |= {n.split(".")[1] for n in names if n.startswith("navsim.")}
    return found


@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_imports_point_one_way(room: str) -> None:
    files = sorted((PACKAGE / room).glob("**/*.py"))
    assert files
    for source in files:
        wrong = rooms_imported(source) - ALLOWED[room] - {room}
        assert not wrong, f"{source.relative_to(PACKAGE)} imports {wrong}"


def modules_imported(source: Path, modules: set[str]) -> set[str]:
    """Modules of navsim that a file imports as it is imported itself."""
    found = set()
    for node in tree(source).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found |= {whole if whole in modules else node.module} & modules
    return found


def test_no_module_imports_itself_by_a_circle() -> None:
    """Within a room too: what stands on what can be read from the imports."""
    files = {
        str(path.relative_to(PACKAGE.parent).with_suffix("")).replace("/", ".").removesuffix(".__init__"): path
        for path in PACKAGE.glob("**/*.py")
    }
    imported = {name: modules_imported(path, set(files)) for name, path in files.items()}
    done: set[str] = set()

    def visit(name: str, way: tuple[str, ...]) -> None:
        assert name not in way, " -> ".join([*way[way.index(name) :], name])
        if name not in done:
            for other in sorted(imported[name]):
                visit(other, (*way, name))
            done.add(name)

    for name in files:
        visit(name, ())


OF_STATES = ("nav", "x", "p", "phi", "mid", "error", "own", "mean", "cov", "covariance", "matrix")
"""What arrays over states are called in the navigation filters and around them."""


def called(node: ast.expr) -> str:
    """The name of a variable or of an attribute."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def test_states_are_named_and_not_counted() -> None:
    """No literal index into an array over states: `x[A_N]`, not `x[6]`."""
    sources = [
        *(
            PACKAGE / "filter" / f"{name}.py"
            for name in (
                "strapdown", "covariance", "eskf", "left_invariant", "tfg", "error_parametrisation", "history",
                "filter_loop", "gaussian_sum", "smoother", "evaluation", "measurement_models", "estimate",
                "records", "design", "gnss_measurements", "ground_station_measurements", "height_measurements",
                "magnetometer_measurements", "vehicle_measurements",
            )
        ),
        *(PACKAGE / "simulation" / f"{name}.py" for name in (
            "landing", "landing_covariance", "correlated_sources", "inertial_states",
        )),
        PACKAGE / "replays" / "flight.py",
        *(source for room in ("error_propagation", "live", "landing") for source in (PACKAGE / room).glob("*.py")),
    ]  # fmt: skip
    counted = []
    for source in sources:
        for node in nodes(source):
            allowed = 2  # a number up to 2 may be an axis
            if isinstance(node, ast.Call) and called(node.func) in ("slice", "range"):
                bounds: list[ast.expr | None] = [*node.args]
                allowed = 2 if called(node.func) == "slice" else 6  # and there are increments of angle and velocity
            elif isinstance(node, ast.Subscript) and called(node.value) in OF_STATES:
                parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
                bounds = [
                    b for part in parts for b in ((part.lower, part.upper) if isinstance(part, ast.Slice) else (part,))
                ]
            else:
                continue
            if any(isinstance(b, ast.Constant) and isinstance(b.value, int) and b.value > allowed for b in bounds):
                counted.append(f"{source.name}:{node.lineno}: {ast.unparse(node)}")
    assert not counted, counted


def nodes_of(kind: type[ast.AST]) -> list[tuple[Path, ast.AST]]:
    """Every node of a kind in the package, with its file."""
    return [
        (source.relative_to(PACKAGE), node)
        for source in sorted(PACKAGE.glob("**/*.py"))
        for node in nodes(source)
        if isinstance(node, kind)
    ]


def test_no_class_name_stands_twice() -> None:
    where: dict[str, list[str]] = {}
    for source, node in nodes_of(ast.ClassDef):
        assert isinstance(node, ast.ClassDef)
        where.setdefault(node.name, []).append(str(source))
    assert len(where) > 200
    assert {name: files for name, files in where.items() if len(files) > 1} == {}


MOST_PARAMETERS = 9


def test_scripts_and_benchmarks_name_what_there_is() -> None:
    """They are run by nobody but their makers, so a name that moved would be missed."""
    missing, count = [], 0
    for source in sorted(
        path for folder in ("scripts", "benchmarks") for path in (PACKAGE.parent / folder).glob("*.py")
    ):
        for node in nodes(source):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("navsim"):
                continue
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                count += 1
                there = hasattr(module, alias.name) or importlib.util.find_spec(f"{node.module}.{alias.name}")
                if not there:
                    missing.append(f"{source.name}:{node.lineno}: {node.module}.{alias.name}")
    assert count > 30
    assert not missing, missing


def test_functions_have_few_parameters() -> None:
    """Kernels take arrays by hand: numba is to see each."""
    long = {}
    for source, node in nodes_of(ast.FunctionDef):
        assert isinstance(node, ast.FunctionDef)
        compiled = any(ast.unparse(decorator).startswith(("kernel", "inlined")) for decorator in node.decorator_list)
        arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
        count = len([a for a in arguments if a.arg not in ("self", "cls")])
        if count > MOST_PARAMETERS and not compiled:
            long[f"{source}:{node.name}"] = count
    assert long == {}


def test_every_room_has_its_rule() -> None:
    rooms = {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    assert rooms == set(ALLOWED)
    above = {"defect", "kinds"}
    for room, allowed in ALLOWED.items():
        assert allowed <= above, f"{room} may import {allowed - above}, which stand below it"
        above.add(room)


def test_rooms_with_kernels_are_named_by_the_cache() -> None:
    """Machine code is kept by a digest of these rooms: one that is missing would leave old code behind."""
    from navsim.compiler.kernel_cache import KERNEL_ROOMS

    kernels = {"kernel", "inlined", "within", "in_kernels"}
    rooms = {
        source.parts[0]
        for source, node in nodes_of(ast.ImportFrom)
        if isinstance(node, ast.ImportFrom) and node.module == "navsim.compiler.jit"
        if kernels & {alias.name for alias in node.names}
    }
    assert {"statistics", "filter", "companions"} <= rooms <= set(KERNEL_ROOMS)
    assert all((PACKAGE / room).is_dir() for room in KERNEL_ROOMS)


def modules_after(code: str) -> set[str]:
    out = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(out.stdout.split())


def test_help_imports_nothing_heavy() -> None:
    code = "import contextlib, io, sys\nsys.argv = ['navsim', '--help']\nfrom navsim.__main__ import main\n"
    code += "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): main()"
    heavy = {"numba", "scipy", "matplotlib", "h5py", "h5netcdf", "pydantic", "yaml", "numpy"}
    assert not heavy & modules_after(code)


def modules_of(*words: str) -> set[str]:
    """Modules that a command has imported at its end."""
    code = f"import contextlib, io, sys\nsys.argv = {['navsim', *words]!r}\nfrom navsim.__main__ import main\n"
    return modules_after(
        code + "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): main()"
    )


LANDING = PACKAGE.parent / "scenarios" / "landing.yaml"
OF_OTHER_KINDS = {
    f"navsim.{name}"
    for name in (
        "companions", "sweeps", "optimization", "replays", "report.figures",
        "cli.recorded", "cli.studies", "cli.results",
    )
}  # fmt: skip


def test_validate_compiles_nothing() -> None:
    found = modules_of("validate", str(LANDING))
    assert {"navsim.scenario.landing", "numpy"} <= found
    heavy = {"numba", "scipy", "matplotlib", "h5py", "rich", "numpy.ma"}
    assert not (heavy | {"navsim.results.schema", "navsim.results.result"} | OF_OTHER_KINDS) & found


def test_a_landing_imports_only_what_it_needs(tmp_path: Path) -> None:
    words = ("run", str(LANDING), "--set", "duration_s=2", "-o", str(tmp_path / "r.h5"), "--figures", "none")
    modules_of(*words)  # the compiler loads more
    found = modules_of(*words)
    assert (tmp_path / "r.h5").exists()
    assert {"navsim.landing.study", "numba", "h5py"} <= found
    unneeded = {
        "matplotlib", "PIL", "h5netcdf", "scipy.spatial", "scipy.optimize", "scipy.interpolate", "scipy.stats",
        "shapely", "sgp4", "pynmeagps", "serial", "hatanaka", "ncompress",
        "navsim.formats.rinex_nav", "navsim.formats.sp3", "navsim.formats.almanac",
    }  # fmt: skip
    assert not (unneeded | OF_OTHER_KINDS) & found


def test_sizes_have_no_power_of_ten() -> None:
    """Python's format `.3g` writes 1940 km as 1.94e+03 km: `rounding.digits` does not, nor do cells of tables."""
    assert [digits(x) for x in (1937.0, 0.0, -98765.0, 1.5e-7, 2e9, 3.14159)] == (
        ["1940", "0", "-98800", "1.5e-07", "2e+09", "3.14"]
    )
    assert str(cell("{:.3g} {:+.2g} {:g}", 1937.0, 150.0, 2.5e6)) == "1940 +150 2500000"
    sized = re.compile(r"\.[1-6]g\} ?(%|(k?m|s|h|Hz|deg|rad|km/h|m/s2?|ns|us)\b)")
    wrong = [
        f"{path.name}: {text}"
        for path in PACKAGE.glob("**/*.py")
        for text in re.findall(r"\{[^{}\"]+" + sized.pattern, path.read_text())
    ]
    assert not wrong


def test_what_a_handler_catches_is_imported_before_its_try() -> None:
    """A command that leaves early inside `try` must find the names of its handlers: else UnboundLocalError."""
    seen = 0
    for source in sorted((PACKAGE / "cli").glob("*.py")):
        for node in nodes(source):
            if isinstance(node, ast.Try):
                seen += 1
                late = {
                    alias.asname or alias.name
                    for statement in node.body
                    for inner in ast.walk(statement)
                    if isinstance(inner, (ast.Import, ast.ImportFrom))
                    for alias in inner.names
                }
                caught = {
                    name.id
                    for handler in node.handlers
                    if handler.type is not None
                    for name in ast.walk(handler.type)
                    if isinstance(name, ast.Name)
                }
                assert not late & caught, f"{source.name}:{node.lineno}: {sorted(late & caught)}"
    assert seen > 5
