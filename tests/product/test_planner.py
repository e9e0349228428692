"""`navsim plan` in a real browser: what is dragged by a mouse is followed, what is saved is what `navsim run` takes."""

from __future__ import annotations

import http.client
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bokeh.document import Document as BokehDocument

from navsim.geodesy.earth import llh_from_ecef
from navsim.landing.study import prepare
from navsim.optimization.analyses import glimpsed, screened
from navsim.planner.drawing import AerodromePlan, area_of
from navsim.planner.outlook import QUANTITIES, Outlook
from navsim.planner.proposal import PlannedScenario
from navsim.planner.requests import SourceCounts, UnknownRequest, read_order
from navsim.planner.server import MOST_PAGES
from navsim.planner.session import PlannerSession
from navsim.planner.target import Target
from navsim.results.result import read
from navsim.scenario_files.source import InputError, load
from tests.conftest import SCENARIOS
from tests.forks import installed, navsim
from tests.product.conftest import opened

EVIL = "<script>alert('title')</script>"
LANDING = SCENARIOS / "landing.yaml"
DRAG_S = 2.0
"""How long the mouse is drawn: twenty maps at least."""
MOST_BUSY = 2.5
"""Processes for each core beyond which the limits of a drag say more of the others than of the planner: server and
browser want a core each."""
FIELD = f"""\
# a field
kind: landing
version: 1
title: "{EVIL}"
epoch: 2018-09-13T12:00:00Z   # noon
duration_s: 65
runway: {{heading_deg: 40}}
imu: {{rate_hz: 20}}
receiver: {{rate_hz: 2}}
approach: {{profile: paper, start: {{lat_deg: 56, lon_deg: 37}}}}
integrity: {{method: chi2, limits: {{hal_m: 40, val_m: 60, tta_s: 2}}}}
pseudolites:
  # the two of the field
  sites:
    - {{name: east, s_m: 400, l1_m: 500}}   # by the hangar
    - {{name: west, s_m: -400, l1_m: 100}}
interference:
  jammers:
    - {{name: van, place: {{lat_deg: 56.03, lon_deg: 37.01}}, height_m: 10, eirp_dbw: -15, waveform: noise,
       centre_mhz: 1590, bandwidth_mhz: 60}}
"""
OVERLAY = """{"type": "FeatureCollection", "features": [
 {"type": "Feature", "properties": {"name": "<b>village</b>"}, "geometry": {"type": "Polygon", "coordinates":
  [[[37.02, 56.0], [37.03, 56.0], [37.03, 56.005], [37.02, 56.0]]]}},
 {"type": "Feature", "properties": null, "geometry": {"type": "MultiLineString", "coordinates":
  [[[36.98, 55.99], [37.0, 56.01]]]}}, {"type": "Feature", "properties": {}, "geometry": {"type": "Point",
  "coordinates": [37.01, 56.01, 3]}}]}"""


@contextmanager
def served(*arguments: object, cwd: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A planner and its address: a fork of a process that has all loaded, which hears signals as any other."""
    command = [installed(), "plan", *map(str, arguments), "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, cwd=cwd, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), (line, process.stderr and process.stderr.read())
        yield line.split()[0], process
    finally:
        process.terminate()
        process.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Its exit code and last words after Ctrl-C."""
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    return process.returncode, err


class Looked:
    """A page of the planner, and all it asked for elsewhere or had to say."""

    def __init__(self, browser: Any, address: str) -> None:
        self.said: list[str] = []
        self.page = opened(browser, viewport={"width": 1300, "height": 800})
        self.page.on("console", lambda message: self.said.append(f"console: {message.text}"))
        self.page.on("pageerror", lambda error: self.said.append(f"error: {error}"))
        self.page.on("request", lambda r: None if r.url.startswith(address) else self.said.append(f"asks: {r.url}"))
        self.page.on("websocket", lambda w: None if w.url.startswith(address.replace("http", "ws"))
                     else self.said.append(f"asks: {w.url}"))  # fmt: skip
        self.page.goto(address)
        self.rest()

    def rest(self) -> None:
        """Wait until all that was asked for is shown."""
        self.page.wait_for_function("document.body.dataset.resting === 'true'")
        assert self.page.locator("#exact").get_attribute("data-exact") == "true"

    def text(self, path: str) -> str:
        """A figure as it is shown, without its unit."""
        return str(self.page.locator(f"[data-path='{path}']").inner_text()).split()[0]

    def problems(self) -> list[str]:
        return list(self.page.locator("#problems li").all_inner_texts())

    def at(self, number: int) -> tuple[float, float]:
        """Where a transmitter is on the screen."""
        x, y = self.page.evaluate(
            """i => { const view = Bokeh.index.find_one(planner.figure()), at = planner.places().data;
            const box = document.querySelector('#map > div > *').getBoundingClientRect();
            return [box.x + view.frame.x_scale.compute(at.x[i]), box.y + view.frame.y_scale.compute(at.y[i])]; }""",
            number,
        )
        return x, y

    def dragged(self, number: int, dx: float, dy: float, steps: int = 8) -> None:
        """A transmitter pulled over the screen by a mouse."""
        x, y = self.at(number)
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + dx, y + dy, steps=steps)
        self.page.mouse.up()
        self.rest()

    def save(self) -> None:
        self.page.click("#save")
        self.page.wait_for_selector("#said:not([hidden]), #asked:not([hidden])")


@pytest.mark.long
def test_other_sites_and_floods_are_let_off(tmp_path: Path) -> None:
    """Names that point here (DNS rebinding), scripts for other sites, pages without end; a tunnel's port is let in."""
    with served(LANDING, "-o", tmp_path / "out.yaml", cwd=tmp_path) as (address, _):
        port = address.rstrip("/").rpartition(":")[2]

        def asked(path: str = "/", **headers: str) -> tuple[int, str | None]:
            connection = http.client.HTTPConnection(f"127.0.0.1:{port}", timeout=60)
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            answer.read()
            return answer.status, answer.getheader("Access-Control-Allow-Origin")

        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", "[", ""):
            assert asked(Host=host) == (403, None), host
        for path in ("/autoload.js?bokeh-autoload-element=1", "/metadata"):
            assert asked(path) == (404, None)
        assert asked("/static/js/bokeh.min.js", Origin="http://evil.example") == (403, None)
        assert asked("/ws", Host="localhost:8000", Origin="http://localhost:8000")[0] != 403
        assert asked("/ws", Host="localhost:8000", Origin="http://localhost:9000")[0] == 403
        pages = [asked(Host=host)[0] for host in (f"localhost:{port}", "localhost:8000", "[::1]:8000")]
        assert pages == [200, 200, 200]
        assert 503 in [asked()[0] for _ in range(MOST_PAGES)]


@pytest.mark.parametrize(
    "order",
    [
        None, 7, "", "{", "[]", "[" * 9000, "x" * 20_000, '{"do": "format"}', '{"do": ["save"]}',
        '{"do": "place", "kind": "pseudolite", "number": -1, "x": 1, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 2, "x": 1, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 1.0, "x": 1, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": true, "x": 1, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 0, "x": NaN, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 0, "x": 1e300, "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 0, "x": "1", "y": 400}',
        '{"do": "place", "kind": "pseudolite", "number": 0, "x": 1}',
        '{"do": "place", "kind": "pseudolite", "number": 0, "x": 1, "y": 400, "up": Infinity}',
        '{"do": "place", "kind": "jammer", "number": 0, "x": 1, "y": 400}',
        '{"do": "drag", "kind": "satellite", "number": 0, "x": 1, "y": 400}',
        '{"do": "remove", "number": -1}', '{"do": "time", "seconds": NaN}', '{"do": "hasten", "seconds": -1}',
        '{"do": "area", "factor": 0}', '{"do": "show", "quantity": "beauty", "subject": 0}',
        '{"do": "show", "quantity": "pdop", "subject": -2}', '{"do": "save", "consent": 1}',
        '{"do": "undo", "n": "one"}', f'{{"do": "undo", "n": 1{400 * "0"}}}',
        f'{{"do": "time", "seconds": 1{400 * "0"}}}',
    ],
)  # fmt: skip
def test_malformed_orders_are_refused(order: object) -> None:
    with pytest.raises(UnknownRequest):
        read_order(order, SourceCounts(2, 0))


def test_orders_of_the_page_are_read() -> None:
    for order in (
        {"do": "place", "kind": "pseudolite", "number": 1, "x": -20.5, "y": 400, "up": 2, "n": 3, "at": 7.5},
        {"do": "drag", "kind": "jammer", "number": 0, "x": 1, "y": 2, "n": 4},
        {"do": "show", "quantity": "pdop", "subject": -1},
        {"do": "save", "consent": False},
        {"do": "hello"},
    ):
        assert read_order(json.dumps(order), SourceCounts(2, 1)) == {k: v for k, v in order.items() if k != "at"}


def test_pavement_is_no_place_for_a_pseudolite(tmp_path: Path) -> None:
    """The planner refuses it, what runs and validates warns."""
    file = tmp_path / "field.yaml"
    file.write_text(UNJAMMED)
    document = load(file)
    proposal = PlannedScenario(document, UNJAMMED)
    before = proposal.document.data
    with pytest.raises(InputError, match="east would be on the pavement of the runway, 1000 m by 30 m; put it more"):
        proposal.move(0, np.array([500.0, -14.0, 0.0]))
    assert proposal.document.data == before
    proposal.move(0, np.array([500.0, -16.0, 0.0]))
    proposal.move(0, np.array([1050.0, -14.0, 0.0]))
    assert "pavement" not in navsim("validate", file, cwd=tmp_path).stderr
    file.write_text(UNJAMMED.replace("s_m: 400, l1_m: 500", "s_m: 12, l1_m: -500"))
    said = navsim("validate", file, cwd=tmp_path).stderr
    assert "pseudolites on the pavement of the runway, 1000 m by 30 m (runway.length_m, runway.width_m): east" in said
    assert "500.0 m beyond the threshold, 12.0 m off the centre line" in said


@pytest.mark.parametrize("kind", ["pseudolite", "jammer", "beacon"])
def test_a_drag_that_is_still_computed_does_not_erase_a_refusal(kind: str, tmp_path: Path) -> None:
    """Seen before: a pseudolite dropped on the pavement jumped back without a word, if its last map came later."""
    beacons = "\nbeacons: {sites: [{s_m: 60, l1_m: 300}], rate_hz: 10, sigma_m: 0.1, range_limit_m: 3000}\n"
    (tmp_path / "field.yaml").write_text(FIELD + beacons)
    proposal = PlannedScenario(load(tmp_path / "field.yaml"), FIELD + beacons)
    session = PlannerSession(BokehDocument(), proposal, Target(tmp_path / "out.yaml"), [])
    order = {"do": "drag", "kind": kind, "number": 0, "x": 500.0, "y": 5.0, "n": 1}
    news = [update.news for update in session._dragged(order)(lambda: False)]
    session.close()
    assert news
    assert not any("problems" in each for each in news)


def nobody_else_is_let_in(host: str) -> None:
    """Websockets of the planner's own page alone are taken."""

    def asked(origin: str) -> int:
        connection = http.client.HTTPConnection(host, timeout=60)
        connection.request("GET", "/ws", headers={
            "Origin": origin, "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "bokeh, x",
        })  # fmt: skip
        return connection.getresponse().status

    assert asked("http://evil.example") == 403
    assert asked(f"http://localhost:{host.partition(':')[2]}") == 403  # another page than its own
    assert asked(f"http://{host}") != 403


@pytest.mark.long
def test_a_mouse_is_followed(browser: Any, tmp_path: Path) -> None:
    """At least ten maps of 51 x 51 places a second, half of them within 200 ms, in the best of three tries: the machine
    has other work, too. Nobody else is let in meanwhile."""
    rates, medians = [], []
    with served(cwd=tmp_path) as (address, process):
        shown = Looked(browser, address)
        for _ in range(3):
            x, y = shown.at(0)
            shown.page.evaluate("planner.trips.length = 0")
            shown.page.mouse.move(x, y)
            shown.page.mouse.down()
            began, step = time.monotonic(), 0
            while time.monotonic() - began < DRAG_S:
                step += 1
                shown.page.mouse.move(x + step % 80, y - 2 * (step % 80))
            trips = shown.page.evaluate("planner.trips")
            shown.page.mouse.up()
            shown.rest()
            assert {trip["size"] for trip in trips} == {51}
            rates.append(1000.0 * (len(trips) - 1) / (trips[-1]["at"] - trips[0]["at"]))
            medians.append(float(np.median([trip["took"] for trip in trips])))
            busy = os.getloadavg()[0] / (os.cpu_count() or 1)
            if busy > MOST_BUSY or (rates[-1] >= 10.0 and medians[-1] < 200.0):
                break
        assert shown.said == []
        shown.page.context.close()
        nobody_else_is_let_in(address.removeprefix("http://").rstrip("/"))
        assert ended(process)[0] == 130
    assert not (tmp_path / "landing_planned.yaml").exists()
    kept = any(rate >= 10.0 and median < 200.0 for rate, median in zip(rates, medians, strict=True))
    print(f"maps a second {rates}, from mouse to picture {medians} ms, {busy:.1f} processes for each core")
    if not kept and busy > MOST_BUSY:
        pytest.skip(f"{busy:.1f} processes want each core; beside them {rates} maps a second, {medians} ms")
    assert kept, (rates, medians)


def test_what_is_saved_flies_and_has_the_figures_shown(browser: Any, tmp_path: Path) -> None:
    scenario, target = tmp_path / "field.yaml", tmp_path / "field_planned.yaml"
    scenario.write_text(FIELD)
    (tmp_path / "o.geojson").write_text(OVERLAY)
    with served(scenario, "--overlay", tmp_path / "o.geojson", cwd=tmp_path) as (address, process):
        shown = Looked(browser, address)
        page = shown.page
        assert page.locator("h1").inner_text() == EVIL
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            paper = re.findall(r"\d+", page.evaluate("getComputedStyle(document.body).backgroundColor"))
            assert (max(map(int, paper[:3])) < 60) == (scheme == "dark")
        before = shown.text("dop/pdop")
        shown.dragged(0, 60.0, -45.0)
        assert shown.text("dop/pdop") != before
        assert page.locator("#unsaved").is_visible()
        page.fill("input[aria-label='west along, m']", "-123.456")
        page.press("input[aria-label='west along, m']", "Enter")
        page.wait_for_function("planner.state.pseudolites[1].x === -123.456")
        shown.rest()
        page.fill("#clock", "06:30:00")
        page.press("#clock", "Enter")
        page.wait_for_function("planner.state.seconds === 23400")
        shown.rest()
        shown.save()
        assert not page.locator("#unsaved").is_visible()
        figures = {path: shown.text(path) for path in (
            "dop/pdop", "dop/hdop", "dop/vdop", "fix/rms_horizontal", "fix/rms_vertical", "integrity/hpl_p95",
            "integrity/vpl_p95",
        )}  # fmt: skip
        assert shown.said == []
        code, err = ended(process)
        assert code == 130
        assert "not saved" not in err
        assert "Traceback" not in err
    assert scenario.read_text() == FIELD
    old, new = FIELD.splitlines(), target.read_text().splitlines()
    changed = [line for line in new if line not in old]
    assert len(new) == len(old)
    assert len(changed) == 3
    assert changed[0] == "epoch: 2018-09-13T06:30:00Z   # noon"
    assert changed[1].endswith("}   # by the hangar")
    assert changed[2] == "    - {name: west, s_m: -400, l1_m: 123.456}"
    navsim("run", target, "-q", "--figures", "none", "-o", "r.h5", cwd=tmp_path)
    result = read(tmp_path / "r.h5")
    for path, text in figures.items():
        if path.startswith("integrity/"):
            value = result[f"/summary/{path.removesuffix('_p95')}"][4]
        else:
            value = result[f"/summary/{path}"][0]
        assert f"{float(value):.{len(text.partition('.')[2])}f}" == text, path


@pytest.mark.long
def test_everything_else_that_can_be_done(browser: Any, tmp_path: Path) -> None:
    """Levels, a jammer under the mouse, one more and one less, undo, what is refused, consent, what is lost."""
    scenario, target = tmp_path / "field.yaml", tmp_path / "out.yaml"
    scenario.write_text(FIELD)
    target.write_text("precious")
    with served(scenario, "-o", target, cwd=tmp_path) as (address, process):
        shown = Looked(browser, address)
        page = shown.page
        page.select_option("#quantity", "hpl_p95")
        page.wait_for_function("planner.state.map.quantity === 'hpl_p95' && planner.state.map.size >= 51")
        shown.rest()
        page.select_option("#quantity", "pdop")
        page.select_option("#subject", "0")
        page.wait_for_function("planner.state.map.subject === 0 && planner.state.map.quantity === 'pdop'")
        shown.rest()
        van = page.evaluate("planner.state.jammers[0].x")
        shown.dragged(2, 30.0, 20.0)
        assert page.evaluate("planner.state.jammers[0].x") != van
        page.click("#undo")
        page.wait_for_function("x => planner.state.jammers[0].x === x", arg=van)
        page.click("#redo")
        page.wait_for_function("x => planner.state.jammers[0].x !== x", arg=van)
        page.click("#add")
        page.wait_for_function("planner.state.pseudolites.length === 3")
        page.click("button[aria-label='Remove east']")
        page.wait_for_function("planner.state.pseudolites.map(p => p.name).join() === 'west,PL3'")
        shown.rest()
        page.fill("input[aria-label='west along, m']", "0")
        page.fill("input[aria-label='west right, m']", "0")
        page.press("input[aria-label='west right, m']", "Enter")
        page.wait_for_selector("#problems li")
        assert "it must stay 10 m away" in shown.problems()[0]
        assert page.evaluate("planner.state.pseudolites[0].y") == -400
        page.fill("input[aria-label='west right, m']", "")
        page.fill("input[aria-label='west along, m']", "5")
        page.press("input[aria-label='west along, m']", "Enter")
        assert page.input_value("input[aria-label='west right, m']") != ""
        page.wait_for_function("planner.state.pseudolites[0].x === 5 && planner.state.pseudolites[0].y === -400")
        page.click("#undo")
        page.wait_for_function("planner.state.pseudolites[0].x !== 5")
        shown.rest()
        shown.save()
        assert page.locator("#asked span").inner_text() == f"{target} is there already. Replace it?"
        assert target.read_text() == "precious"
        page.click("#replace")
        page.wait_for_selector("#said:not([hidden])")
        assert "name: PL3" in target.read_text()
        assert "# the two of the field" in target.read_text()
        page.click("#undo")
        page.wait_for_selector("#unsaved:not([hidden])")
        assert shown.said == []
        code, err = ended(process)
    assert code == 130
    assert "warning: changes in the planner were not saved" in err
    assert "Traceback" not in err
    navsim("validate", target, cwd=tmp_path)


def _without(name: str, old: str, new: str) -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        (folder / name).write_text(FIELD.replace(old, new))
        return folder / name

    return made


@pytest.mark.parametrize(
    ("scenario", "more", "said"),
    [
        (lambda folder: folder / "none.yaml", (), "none.yaml: there is no such file"),
        (_without("a.yaml", "heading_deg", "headin_deg"), (), "a.yaml:7:10: runway.headin_deg: unknown key"),
        (lambda folder: SCENARIOS / "placement_sweep.yaml", (), "use navsim sweep"),
        (_without("b.yaml", "", ""), ("-o", "none/none/b.yaml"), "no such folder"),
        (_without("c.yaml", "", ""), ("--overlay", "c.yaml"), "--overlay c.yaml: not a GeoJSON file"),
        (_without("d.yaml", "", ""), ("--port", "70000"), "expected a whole number from 0 to 65535"),
        (_without("e.yaml", "interference:", "sky: {source: almanac, almanac: x.agl}\ninterference:"), (), "x.agl"),
    ],
    ids=["no file", "key", "kind", "folder", "overlay", "port", "almanac"],
)  # fmt: skip
def test_bad_input_is_refused(
    scenario: Callable[[Path], Path], more: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    done = navsim("plan", scenario(tmp_path), *more, "--no-browser", cwd=tmp_path, code=2)
    assert said in done.stderr
    assert done.stdout == ""


def test_files_named_beside_a_scenario_stay_beside_it(tmp_path: Path) -> None:
    scenario = tmp_path / "sky.yaml"
    shutil.copy(SCENARIOS / "data" / "nominal.agl", tmp_path)
    scenario.write_text(FIELD.replace("interference:", "sky: {source: almanac, almanac: nominal.agl}\ninterference:"))
    (tmp_path / "other").mkdir()
    done = navsim("plan", scenario, "-o", "other/p.yaml", "--no-browser", cwd=tmp_path, code=2)
    assert "names files by relative paths (nominal.agl)" in done.stderr


# --- what maps are made of


def proposed(tmp_path: Path, text: str = FIELD) -> PlannedScenario:
    (tmp_path / "p.yaml").write_text(text)
    return PlannedScenario(load(tmp_path / "p.yaml"), text)


UNJAMMED = FIELD.partition("interference:")[0]
STRONG = FIELD.replace("  # the two", "  cn0_reference_m: 2000\n  # the two")


@pytest.mark.parametrize("text", [FIELD, UNJAMMED, UNJAMMED.replace("chi2", "mhss")], ids=["jammed", "chi2", "mhss"])
def test_a_map_says_at_a_place_what_a_flight_finds_there(text: str, tmp_path: Path) -> None:
    proposal = proposed(tmp_path, text)
    found = Outlook(proposal).found().figures
    outlook = Outlook(proposal)
    for name, path in {
        "pdop": "dop/pdop", "hdop": "dop/hdop", "vdop": "dop/vdop", "pdop_max": "dop/pdop_max",
        "fix_horizontal": "fix/rms_horizontal", "fix_vertical": "fix/rms_vertical",
    }.items():  # fmt: skip
        values = outlook.judge(name, proposal.names)(np.repeat(proposal.places()[None], 3, axis=0))
        np.testing.assert_allclose(values, found[path], rtol=1e-9)
        if path in outlook.at(proposal.places()):
            assert outlook.at(proposal.places())[path] == pytest.approx(found[path], rel=1e-9)
    for name in ("hpl_p95", "vpl_p95"):  # by eight epochs of the glide
        (value,) = outlook.judge(name, proposal.names)(proposal.places()[None])
        level = found[f"integrity/{name}"]
        assert value == (pytest.approx(level, rel=0.05) if np.isfinite(level) else np.inf)


def test_where_strength_depends_on_places_maps_are_made_of_signals(tmp_path: Path) -> None:
    proposal = proposed(tmp_path, STRONG)
    outlook = Outlook(proposal)
    assert outlook.placed
    found = outlook.found().figures | {"dop/hidden": 0.0}  # nothing is before them
    places = proposal.places()[None]
    for name in QUANTITIES:
        (value,) = outlook.judge(name, proposal.names)(places)
        paths = {"pdop_max": "dop/pdop_max", "fix_horizontal": "fix/rms_horizontal", "fix_vertical": "fix/rms_vertical",
                 "hpl_p95": "integrity/hpl_p95", "vpl_p95": "integrity/vpl_p95"}  # fmt: skip
        assert value == pytest.approx(found[paths.get(name, f"dop/{name}")], rel=0.05)


def test_offsets_that_messages_tell_are_numbers_in_maps(shared: Path, tmp_path: Path) -> None:
    day = shared / "data/esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
    document = yaml.safe_load(STRONG)
    document["sky"] = {"source": "navigation", "navigation": [str(day)], "systems": ["gps", "galileo"]}
    document["epoch"] = "2020-06-25T12:00:00Z"
    document.setdefault("signals", {})["system_offsets_ns"] = {"galileo": "broadcast"}
    proposal = proposed(tmp_path, yaml.safe_dump(document))
    (value,) = Outlook(proposal).judge("pdop", proposal.names)(proposal.places()[None])
    assert 0.5 < value < 5.0


def test_a_glimpse_hears_what_the_whole_way_does(tmp_path: Path) -> None:
    """Near a jammer, with the epochs before alone, a small part of all: the same signals are held, as strong."""
    proposal = proposed(tmp_path, STRONG)
    case = prepare(proposal.scenario, proposal.document)
    none = replace(case.environment.pseudolites, names=(), llh=np.empty((0, 3)))
    case = replace(case, environment=replace(case.environment, pseudolites=none))
    whole, brief = screened(case), glimpsed(case)
    assert 7 * brief.motion.time.size < whole.motion.time.size
    lost = 0
    for along, right in ((0.0, 300.0), (-3000.0, -500.0), (20_000.0, 5000.0), (500.0, 40_000.0)):
        llh = llh_from_ecef(proposal.sites(proposal.places() + np.array([along, right, 0.0])))
        ours, theirs = (each.with_sites(llh).shared.signals for each in (brief, whole))
        np.testing.assert_array_equal(ours.time, theirs.time)
        np.testing.assert_array_equal(ours.used, theirs.used)
        np.testing.assert_array_equal(ours.cn0, theirs.cn0)
        np.testing.assert_array_equal(ours.fix_sigma, theirs.fix_sigma)
        lost += int((~ours.used).sum())
    assert lost


def test_places_are_read_as_they_are_written(tmp_path: Path) -> None:
    """In the runway's frame as given; of the paper's frame, and of coordinates, to the millimetre that is written."""
    proposal = PlannedScenario(load(LANDING), LANDING.read_text())
    before = proposal.sites(proposal.places())
    proposal.move(0, proposal.places()[0])
    after = proposal.sites(proposal.places())
    assert np.abs(after - before).max() < 2e-3
    assert proposal.scenario.pseudolites.frame == "runway"
    proposal.undo()
    assert not proposal.unsaved
    assert proposal.text().text == LANDING.read_text()
    text = FIELD.replace("s_m: 400, l1_m: 500", "lat_deg: 56.01, lon_deg: 37.02")
    proposal = proposed(tmp_path, text)
    places = proposal.places()
    proposal.move(0, places[0] + [10.0, 0.0, 0.0])
    np.testing.assert_allclose(proposal.places()[0], places[0] + [10.0, 0.0, 0.0], atol=1e-3)
    assert not proposal.text().lost


def test_beacons_are_shown_and_moved(tmp_path: Path) -> None:
    """Marks behind those of the others; figures are those of a flight, also while one moves."""
    sites = "[{name: mast, s_m: 300, l1_m: 900, height_m: 20}, {lat_deg: 56.01, lon_deg: 37.01}, "
    sites += "{s_m: -250, l1_m: 90}, {s_m: 200, l1_m: -800, height_m: 30}]"
    text = FIELD + f"beacons: {{sites: {sites}, rate_hz: 6, sigma_m: 0.1, range_limit_m: 9000}}\n"
    proposal = proposed(tmp_path, text)
    assert proposal.beacon_names == ("mast", "B2", "B3", "B4")
    np.testing.assert_allclose(proposal.beacons()[[0, 2]], [[-900.0, 300.0, 20.0], [-90.0, -250.0, 0.0]], atol=1e-9)
    plan = AerodromePlan(proposal, area_of(proposal), [], "")
    plan.put(proposal)
    assert plan.places.data["kind"] == ["pseudolite"] * 2 + ["jammer"] + ["beacon"] * 4
    outlook, moved = Outlook(proposal), proposal.beacons()
    moved[:2] += [[50.0, -20.0, 4.0], [10.0, 0.0, 0.0]]
    for number in range(2):
        proposal.move_beacon(number, moved[number])
    np.testing.assert_allclose(proposal.beacons(), moved, atol=2e-3)
    assert "s_m: 280.0, l1_m: 850.0, height_m: 24.0" in proposal.text().text
    found = Outlook(proposal).found().figures
    for path, value in outlook.beacons_at(proposal.beacons()).items():
        assert value == pytest.approx(found[path], rel=1e-8)
    order = {"do": "place", "kind": "beacon", "number": 2, "x": 1, "y": 400}
    assert read_order(json.dumps(order), SourceCounts(2, 1, 3))["number"] == 2
    with pytest.raises(UnknownRequest, match="there are 2"):
        read_order(json.dumps(order), SourceCounts(9, 9, 2))
    with pytest.raises(InputError, match=r"beacons\.sites"):
        proposal.move_beacon(0, np.array([100.0, 3.0, 0.0]))
    proposal.undo()
    assert proposal.beacons()[1, 0] == pytest.approx(moved[1, 0] - 10.0, abs=2e-3)


def test_all_may_be_removed_and_come_again(tmp_path: Path) -> None:
    proposal = proposed(tmp_path, UNJAMMED)
    proposal.remove(1)
    proposal.remove(0)
    assert proposal.names == ()
    Outlook(proposal).found()
    proposal.add(np.array([100.0, 200.0, 5.0]))
    assert proposal.names == ("PL1",)
    np.testing.assert_allclose(proposal.places(), [[100.0, 200.0, 5.0]])
    assert "height_m: 5.0" in proposal.text().text


@contextmanager
def tunnelled(port: int) -> Iterator[int]:
    """A port whose connections are passed on to another one, as `ssh -L` does, and its number."""

    def pass_on(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def accept() -> None:
        with suppress(OSError):  # closed at the end
            while True:
                here, _ = listening.accept()
                there = socket.create_connection(("127.0.0.1", port))
                ends.extend((here, there))
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=pass_on, args=pair, daemon=True).start()

    ends: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=accept, daemon=True).start()
        try:
            yield listening.getsockname()[1]
        finally:
            for end in ends:
                end.close()


def orders_are_carried_out_or_refused(looked: Looked) -> None:
    """Malformed orders, then a pull by the mouse."""
    send = "order => { planner.figure().tags[0].data = { order: [order] }; }"
    places = "[...planner.places().data.x, ...planner.places().data.y]"
    before = looked.page.evaluate(places)
    for order, said in (
        ({"do": "place", "kind": "pseudolite", "number": -1, "x": 1, "y": 400}, "number"),
        ({"do": "place", "kind": "pseudolite", "number": "0", "x": 1, "y": 400}, "number"),
        ({"do": "place", "kind": "pseudolite", "number": 0, "x": "1", "y": 400}, "x"),
        ({"do": "place", "kind": "pseudolite", "number": 0, "x": math.nan, "y": 400}, "x"),
        ({"do": "dance"}, "do"),
        ("no order", ""),
    ):
        text = order if isinstance(order, str) else json.dumps(order)
        looked.page.evaluate("document.querySelector('#problems').replaceChildren()")
        looked.page.evaluate(send, text)
        looked.page.wait_for_selector("#problems li")
        assert said in looked.problems()[0]
    looked.rest()
    assert looked.page.evaluate(places) == before
    looked.dragged(0, 30.0, -20.0)
    assert looked.page.evaluate(places) != before
    assert not looked.said, "every request goes the same way, without a word in the console"


@pytest.mark.long
def test_the_page_lives_behind_a_tunnel_and_wrong_orders(browser: Any, tmp_path: Path) -> None:
    """Its websocket connects by the name localhost and another port, and it carries out orders; one that is malformed
    gets a message, changes nothing, and the page goes on."""
    (tmp_path / "field.yaml").write_text(FIELD)
    with served("field.yaml", "-o", "out.yaml", cwd=tmp_path) as (address, process):
        with tunnelled(int(address.rstrip("/").rpartition(":")[2])) as port:
            orders_are_carried_out_or_refused(Looked(browser, f"http://localhost:{port}/"))
        code, last = ended(process)
        assert code == 130
        assert "Traceback" not in last
