"""Make the pictures of the gallery, and docs/gallery.md: some minutes; needs Chromium for the report and the planner.

Each picture is drawn by navsim from the result of the command beside it. Palettes keep the files small.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
PAGE = ROOT / "docs" / "gallery.md"
COLOURS = 200
HEAD = """# Gallery

Each section shows figures of the result of its command. A command with several runs or `-q` draws none:
`navsim plot RESULT.h5` draws all [figures of a result](figures.md).
"""
START = "navsim init -o my.yaml"
PLANNER = "navsim plan my.yaml"
REPORT = "navsim report results/landing.h5"


@dataclass(frozen=True)
class Section:
    """A heading, commands, the result that they make, and of its figures the names with captions or ""."""

    title: str
    commands: tuple[str, ...]
    result: str
    figures: dict[str, str]


SECTIONS = (
    Section("One landing", ("navsim run scenarios/landing.yaml",), "landing", {
        "track": "",
        "sky": "",
        "dop": "",
        "fixes": "Fixes: 95 % should lie in the ellipse",
        "errors": "Errors of all states should stay within ±3σ",
        "nees": "NEES and NIS should stay within their bands",
    }),
    Section("Many landings", ("navsim run scenarios/landing.yaml --runs 20 -q -o results/many.h5",), "many", {
        "touchdown": "",
        "spread_time": "",
        "histogram": "",
        "consistency": "Error over sigma (z) of each state: red if sigma is too small",
    }),
    Section("Error budget", ("navsim run scenarios/landing.yaml --method covariance",), "landing_covariance", {
        "budget": "",
    }),
    Section("Placement maps", ("navsim sweep scenarios/placement_sweep.yaml",), "placement_sweep", {
        "pdop": "",
        "fix_vertical": "The star marks the best position; that of PDOP is not that of the vertical error",
    }),
    Section("Best placements", ("navsim optimize scenarios/placement_optimum.yaml",), "placement_optimum", {
        "plan": "",
        "front": "",
    }),
    Section("Integrity", (
        "navsim run scenarios/landing.yaml --runs 100 --set "
        "'integrity={method: chi2, limits: {hal_m: 40, val_m: 60, tta_s: 2}}'",
    ), "landing_runs100", {
        "integrity": "Protection levels should lie above errors and below alert limits",
        "stanford": "Stanford diagram: epochs below the diagonal are misleading",
    }),
    Section("Rare events", (
        "navsim run scenarios/landing.yaml --method rare --set 'box={lateral_m: 0.8, vertical_m: 1.2}'",
    ), "landing_rare", {"exceedance": ""}),
    Section("A recorded flight", ("navsim init recorded_flight -o log.yaml", "navsim replay log.yaml"), "log", {
        "innovations": "Innovations should stay within 3σ",
        "attitude": "",
        "outages": "Share of simulated outages with less drift",
    }),
    Section("A companion system", ("navsim run scenarios/azimuth_tracking.yaml",), "azimuth_tracking", {
        "map": "Azimuth error of a radar without load factors, divided by its error with them: above 1 they help",
    }),
)  # fmt: skip


def navsim(command: str, folder: Path) -> None:
    """Run a command as the page has it, with this Python's navsim."""
    words = command.replace("navsim", f"{sys.executable} -m navsim", 1)
    subprocess.run(["bash", "-c", words], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def keep(picture: Path, name: str) -> None:
    """Store a picture with few colours."""
    with Image.open(picture) as image:
        small = image.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        small.save(IMAGES / name, optimize=True)


def photograph(page: Page, address: str, height: int, name: str, folder: Path) -> None:
    """Store the top of a page as a browser shows it."""
    page.set_viewport_size({"width": 1280, "height": height})
    page.goto(address)
    page.wait_for_timeout(4000)
    page.screenshot(path=folder / name)
    keep(folder / name, name)


def photograph_pages(folder: Path) -> None:
    """The report of the landing, and the planner."""
    navsim(REPORT, folder)
    navsim(START, folder)
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(color_scheme="light")
        page.set_default_timeout(120_000)
        photograph(page, (folder / "results" / "landing.html").as_uri(), 1400, "report.png", folder)
        words = [sys.executable, "-m", *PLANNER.split(), "--port", "0", "--no-browser"]
        with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as planner:
            assert planner.stdout is not None
            photograph(page, planner.stdout.readline().split()[0], 880, "planner.png", folder)
            planner.send_signal(signal.SIGINT)
        browser.close()


def text() -> str:
    """The page."""
    lines = [HEAD]
    for section in SECTIONS:
        lines += [f"## {section.title}", "", *(f"    {command}" for command in section.commands), ""]
        for name, caption in section.figures.items():
            lines += [f"![Figure {name}](images/{section.result}_{name}.png)", ""]
            lines += [f"{caption}.", ""] if caption else []
    for title, commands, picture, caption in (
        ("The report", (REPORT,), "report", "[The report](report.md) is one page for any browser"),
        ("The planner", (START, PLANNER), "planner",
         "[The planner](planner.md) shows the effect of moving a pseudolite"),
    ):  # fmt: skip
        typed = [f"    {command}" for command in commands]
        lines += [f"## {title}", "", *typed, "", f"![{title}](images/{picture}.png)", "", f"{caption}.", ""]
    return "\n".join(lines)


def main() -> None:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        shutil.copytree(ROOT / "scenarios", folder / "scenarios")
        for section in SECTIONS:
            for command in section.commands:
                navsim(command, folder)
            only = ",".join(section.figures)
            navsim(f"navsim plot results/{section.result}.h5 --only {only} --width 170mm --dpi 80 -o drawn", folder)
            for name in section.figures:
                keep(folder / "drawn" / f"{section.result}_{name}.png", f"{section.result}_{name}.png")
        photograph_pages(folder)
    PAGE.write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main()
