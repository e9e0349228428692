"""Write docs/dry-runs-measured.md: how long studies take, beside what `--dry-run` said before.

    python scripts/dry_runs.py

Each study is told of and computed in a process of its own, in a folder that is thrown away, with kernels in the cache.
"""

from __future__ import annotations

import platform
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import measured

from navsim.runner.executor import threads

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "dry-runs-measured.md"
STUDIES = (
    "run landing.yaml --runs 2000 --keep none",
    "run landing.yaml --runs 1000",
    "run landing.yaml --runs 500 --keep none --set filter.kind=eskf --set filter.coupling=tight",
    "run landing_smooth.yaml --runs 1000 --keep none --workers 1",
    "run landing.yaml --method rare --runs 2000 --set box={lateral_m: 0.8, vertical_m: 1.2}",
    "sweep placement_sweep.yaml",
    "sweep placement_sweep.yaml --method covariance --set vary.1.grid.count=5 --set vary.2.grid.count=4",
    "sweep placement_sweep.yaml --method monte-carlo --runs 50 --set vary.1.grid.count=4 --set vary.2.grid.count=4",
    "run mls_elevation.yaml --runs 2000",
)
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "days": 86400.0}
TOLD = re.compile(r": about ([\d.]+) (s|min|h|days) on this .*?\(within a factor of")


def navsim(words: list[str], folder: str) -> tuple[float, str]:
    """Seconds a command took, and what it said."""
    begun = time.monotonic()
    command = [sys.executable, "-m", "navsim", *words]
    done = subprocess.run(
        command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: exit code {done.returncode}\n{done.stderr}")
    return time.monotonic() - begun, done.stderr


def split(study: str) -> list[str]:
    """The words of a study, with the path of its file; a value in braces is one word."""
    command, file, *rest = re.findall(r"\S*\{[^}]*\}|\S+", study)
    return [command, str(ROOT / "scenarios" / file), *rest]


def row(study: str) -> tuple[str, float]:
    """A row of the table, and what was told by what it took."""
    words = [*split(study), "-o", "r.h5", "--figures", "none", "--force"]
    with tempfile.TemporaryDirectory() as folder:
        dry_s, said = navsim([*words, "--dry-run"], folder)
        if "compiling" in said:
            navsim(words, folder)
            dry_s, said = navsim([*words, "--dry-run"], folder)
        took, _ = navsim(words, folder)
    match = TOLD.search(said)
    assert match is not None, said
    number, unit = match.groups()
    ratio = float(number) * UNITS[unit] / took
    return f"| `{study}` | {number} {unit} | {took:.1f} | {ratio:.2f} | {dry_s:.1f} |", ratio


def main() -> None:
    begun, rows = measured.commit(), []
    for study in STUDIES:
        rows.append(row(study))
        print(rows[-1][0], flush=True)
    ratios = [ratio for _, ratio in rows]
    PAGE.write_text(
        "# Dry runs against what studies took\n\n"
        f"By `scripts/dry_runs.py` with the code of commit {begun}, on {platform.machine()} "
        f"with {threads().workers} cores; whole processes.\n\n"
        "| command | estimate | measured, s | estimate / measured | the dry run itself, s |\n|---|---|---|---|---|\n"
        + "\n".join(line for line, _ in rows)
        + f"\n\nThe estimates were {min(ratios):.2f} to {max(ratios):.2f} times the measured times.\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
