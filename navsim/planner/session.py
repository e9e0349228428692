"""A planner session: one page in one browser, its requests and the answers.

The page sends requests, at most two at a time while the user drags something. It sends the next one, with the present
mouse position, when it has drawn an answer. Here, too, only the latest request counts. A background thread works in
steps from coarse to fine. It stops between two steps when a newer request makes its work obsolete.
"""

from __future__ import annotations

import json
import math
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from bokeh.document import Document as Page
from bokeh.models import ColumnDataSource

from navsim.defect import Defect
from navsim.planner.drawing import AerodromePlan, Outline, ShownArea, SkyPlan, area_of, reach_of
from navsim.planner.outlook import QUANTITIES, Outlook, Performance, Places
from navsim.planner.proposal import PlannedScenario
from navsim.planner.requests import SourceCounts, UnknownRequest, read_order
from navsim.planner.target import Consent, Target
from navsim.results.result import ResultError
from navsim.scenario_files.source import InputError

DRAGGED, RESTING = 51, 101
"""Cells of a side of a map while something moves, and at rest."""
THINNED = 8
"""Thinning of fix epochs for fast maps while something moves."""
_COARSER = (51, 31, 21, 13, 9)
_SLOWEST = 0.09
"""Time for a map of a slow quantity while something moves, s, which determines its number of cells."""
_LONGEST = 15.0
"""And at rest in this, s."""
_AT_ONCE = 169
"""Placements of a slow quantity between two checks whether they are still requested."""
ONE_MORE = -1
"""Subject of a map of positions for one more pseudolite."""
FIGURES = (
    ("dop/pdop", "PDOP", "", 4), ("dop/hdop", "HDOP", "", 4), ("dop/vdop", "VDOP", "", 4),
    ("fix/rms_horizontal", "fix, horizontal 1σ", "m", 3), ("fix/rms_vertical", "fix, vertical 1σ", "m", 3),
    ("dop/pdop_max", "worst PDOP", "", 4),
    ("integrity/hpl_p95", "HPL, 95 %", "m", 2), ("integrity/vpl_p95", "VPL, 95 %", "m", 2),
    ("integrity/level_share", "epochs with levels", "%", 1),
    ("beacons/hdop", "HDOP, beacons", "", 3), ("beacons/vdop", "VDOP, beacons", "", 3),
    ("beacons/vdop_max", "worst VDOP, beacons", "", 3),
)  # fmt: skip
"""Figures of the placement: path, name, unit, decimals."""


@dataclass
class Update:
    """Update for the page. values: a map, with its area, or None."""

    news: dict[str, Any] = field(default_factory=dict)
    values: np.ndarray | None = None
    area: ShownArea | None = None
    reach: tuple[float, float] | None = None
    found: Performance | None = None


Work = Callable[[Callable[[], bool]], Iterator[Update]]
"""Finds updates, the coarse ones first; asks now and then whether it is stale."""


class PlannerSession:
    """A page and its proposal."""

    def __init__(self, page: Page, proposal: PlannedScenario, target: Target, overlay: list[Outline]) -> None:
        self._page, self._proposal, self._target = page, proposal, target
        self._area = area_of(proposal)
        self._quantity, self._subject = "pdop", ONE_MORE
        self._outlook = Outlook(proposal)
        self._reach = (0.0, 1.0)
        self._pace: dict[tuple[str, bool], float] = {}
        self._pool = ThreadPoolExecutor(1, "planner")
        self._wanted: Work | None = None
        self._busy = self._gone = self._settling = False
        self._sequence = 0
        self.plan = AerodromePlan(proposal, self._area, overlay, "window.planner.pan(cb_obj)")
        self.sky = SkyPlan(proposal, self._outlook.horizon)
        self.orders = ColumnDataSource({"order": []}, name="orders")
        self.news = ColumnDataSource({"news": []}, name="news")
        self.news.syncable = False
        self.orders.on_change("data", lambda _name, _old, new: self._ordered(new.get("order", [])))
        for figure in (self.plan.figure, self.sky.figure):
            page.add_root(figure)
        self.plan.figure.tags = [self.orders, self.news]
        self.plan.put(proposal)

    @property
    def unsaved(self) -> bool:
        """Whether there are changes that no file has."""
        return self._proposal.unsaved

    def close(self) -> None:
        """End the session."""
        self._gone, self._wanted = True, None
        self._pool.shutdown(wait=False, cancel_futures=True)

    # --- orders

    def _ordered(self, given: object) -> None:
        for text in given if isinstance(given, list) else [given]:
            order: dict[str, Any] = {}
            try:
                its = self._proposal
                known = SourceCounts(len(its.names), len(its.jammers()), len(its.beacon_names))
                order = read_order(text, known)
                self._execute(order)
            except (InputError, ResultError, UnknownRequest) as error:
                said = [str(p) for p in error.problems] if isinstance(error, InputError) else [str(error)]
                self._tell(self._standing() | {"of": order.get("n"), "problems": said})
                self.plan.put(self._proposal)
                self._settle()

    def _execute(self, order: dict[str, Any]) -> None:
        """Execute a request. Raises InputError, ResultError if it fails."""
        proposal, do = self._proposal, order["do"]
        if do == "hello":
            self._tell(self._standing() | {"quantities": self._choices(), "problems": []})
            self._settle()
        elif do == "drag":
            self._ask(self._dragged(order))
        elif do == "hasten":
            self._ask(self._at_time(float(order["seconds"]), order.get("n")))
        elif do == "show":
            self._quantity, self._subject = str(order["quantity"]), int(order["subject"])
            self._settle(partial=True)
        elif do == "area":
            self._area = replace(self._area, half=min(max(self._area.half * float(order["factor"]), 100.0), 1e5))
            self.plan.show(self._area)
            self._settle(partial=True)
        elif do == "save":
            self._save(bool(order["consent"]))
        else:
            self._change(do, order)
            if self._subject >= len(proposal.names):
                self._subject = ONE_MORE
            self._outlook = Outlook(proposal)
            self.plan.put(proposal)
            self._tell(self._standing() | {"of": order.get("n"), "problems": []})
            self._settle()

    def _change(self, do: str, order: dict[str, Any]) -> None:
        proposal = self._proposal
        if do == "place" and order["kind"] == "jammer":
            proposal.jam_from(int(order["number"]), np.array([order["x"], order["y"]], float))
        elif do == "place":
            number, of_beacon = int(order["number"]), order["kind"] == "beacon"
            up = float(order.get("up", (proposal.beacons() if of_beacon else proposal.places())[number, 2]))
            move = proposal.move_beacon if of_beacon else proposal.move
            move(number, np.array([order["x"], order["y"], up], float))
        elif do == "add":
            up = proposal.scenario.pseudolites.height_m
            proposal.add(np.array([self._area.along, self._area.right + 0.5 * self._area.half, up]))
        elif do == "remove":
            proposal.remove(int(order["number"]))
        elif do == "time":
            proposal.set_epoch(float(order["seconds"]))
        elif do == "undo":
            proposal.undo()
        elif do == "redo":
            proposal.redo()

    def _save(self, consent: bool) -> None:
        try:
            text = self._target.save(self._proposal, consent)
            self._tell(self._standing() | {"saved": text, "asks": "", "problems": []})
        except Consent as question:
            self._tell({"asks": str(question)})

    # --- display of the present proposal

    def _standing(self) -> dict[str, Any]:
        proposal = self._proposal
        scenario = proposal.scenario
        interference = scenario.interference
        return {
            "epoch": f"{scenario.epoch:%Y-%m-%d}", "seconds": proposal.seconds, "asks": "", "saved": "",
            "pseudolites": _listed(proposal.names, proposal.places()),
            "jammers": [
                {"name": jammer.name, "x": round(float(x), 1), "y": round(float(y), 1)}
                for jammer, (x, y, _) in zip(() if interference is None else interference.jammers,
                                             proposal.jammers(), strict=True)
            ],
            "beacons": _listed(proposal.beacon_names, proposal.beacons()),
            "listed": scenario.sky.source == "directions", "subject": self._subject, "quantity": self._quantity,
            "unsaved": proposal.unsaved, "undo": proposal.can_undo, "redo": proposal.can_redo,
            "more": proposal.fresh_name(),
        }  # fmt: skip

    def _choices(self) -> list[dict[str, str]]:
        return [{"name": q.name, "said": q.said, "lacks": self._outlook.lacks(q.name)} for q in QUANTITIES.values()]

    # --- work

    def _settle(self, partial: bool = False) -> None:
        """Compute everything for the present proposal; partial: only the map."""
        outlook, places = self._outlook, self._proposal.places()

        def work(stale: Callable[[], bool]) -> Iterator[Update]:
            quick = outlook.quick(self._quantity)
            judge, sizes = self._judge(outlook), (DRAGGED,) if quick else self._sizes(outlook, _SLOWEST)[:1]
            for size in sizes:
                yield self._mapped(judge, places, size, stale, fresh=True)
            if not partial:
                found = outlook.found()
                yield Update({"figures": _figures(found.figures), "exact": True, "warnings": found.warnings,
                              "shares": _shares(found)}, found=found)  # fmt: skip
            for size in (RESTING,) if quick else self._finer(outlook, sizes[0]):
                yield self._mapped(judge, places, size, stale, fresh=True)

        self._settling = True
        self._ask(work)

    def _finer(self, outlook: Outlook, than: int) -> list[int]:
        """Sizes that follow at rest."""
        allowed = self._sizes(outlook, _LONGEST, (RESTING, *_COARSER))
        return sorted({size for size in (21, DRAGGED, RESTING) if than < size <= allowed[0]})

    def _sizes(self, outlook: Outlook, within: float, of: tuple[int, ...] = _COARSER) -> list[int]:
        """Sizes of maps that are computed within so much time, as far as known, the finest first; at least the
        coarsest."""
        pace = self._pace.get((self._quantity, outlook.placed), within / _COARSER[-2] ** 2)
        return [size for size in of if size * size * pace <= within] or [of[-1]]

    def _judge(self, outlook: Outlook, every: int = 1) -> Places:
        names = self._proposal.names
        if self._subject == ONE_MORE:
            names = (*names, self._proposal.fresh_name())
        return outlook.judge(self._quantity, names, every)

    def _dragged(self, order: dict[str, Any]) -> Work:
        """The map and the figures with a transmitter at another place."""
        outlook, number = self._outlook, int(order["number"])
        place = np.array([order["x"], order["y"]], float)
        places, beacons = self._proposal.places(), self._proposal.beacons()

        def work(stale: Callable[[], bool]) -> Iterator[Update]:
            there = outlook
            if order["kind"] == "beacon":  # on which no map depends
                beacons[number, :2] = place
                figures = outlook.at(places) | outlook.beacons_at(beacons)
                yield Update({"of": order.get("n"), "figures": _figures(figures), "exact": False})
                return
            if order["kind"] == "jammer":
                jammers = self._proposal.jammers()
                jammers[number, :2] = place
                there = outlook.jammed_from(jammers)
            else:
                places[number, :2] = place
            yield self._moving(there, places, order.get("n"), stale)

        return work

    def _at_time(self, seconds: float, number: Any) -> Work:
        """Copy at another time of day."""
        places = self._proposal.places()

        def work(stale: Callable[[], bool]) -> Iterator[Update]:
            there = Outlook(self._proposal, self._proposal.epoch_at(seconds))
            yield self._moving(there, places, number, stale)
            if not stale():
                found = there.found()
                yield Update({"shares": _shares(found)}, found=found)

        return work

    def _moving(self, outlook: Outlook, places: np.ndarray, number: Any, stale: Callable[[], bool]) -> Update:
        size = DRAGGED if outlook.quick(self._quantity) else self._sizes(outlook, _SLOWEST)[0]
        update = self._mapped(self._judge(outlook, THINNED), places, size, lambda: False)
        figures = outlook.at(places)
        update.news |= {"of": number}
        if figures:
            update.news |= {"figures": _figures(figures), "exact": False}
        return update

    def _mapped(
        self, judge: Places, places: np.ndarray, size: int, stale: Callable[[], bool], fresh: bool = False
    ) -> Update:
        """A map with so many cells a side; none if it became obsolete. fresh: with new colours."""
        area, quantity = self._area, QUANTITIES[self._quantity]
        grid = area.grid(size).reshape(-1, 2)
        if self._subject == ONE_MORE:
            up = self._proposal.scenario.pseudolites.height_m
            placements = np.repeat(np.concatenate([places, [[0.0, 0.0, up]]])[None], len(grid), axis=0)
        else:
            placements = np.repeat(places[None], len(grid), axis=0)
        placements[:, self._subject, :2] = grid
        quick, begun = self._outlook.quick(self._quantity), time.perf_counter()
        values = []
        for first in range(0, len(grid), len(grid) if quick else _AT_ONCE):
            if stale():
                return Update()
            values.append(judge(placements[first:] if quick else placements[first : first + _AT_ONCE]))
        found = np.concatenate(values)
        took = time.perf_counter() - begun
        self._pace[self._quantity, self._outlook.placed] = took / len(grid)
        found = np.where(np.isfinite(found), found, np.nan).reshape(size, size)
        reach = reach_of(found) if fresh else self._reach
        map_data = {"said": quantity.said, "unit": quantity.unit, "size": size, "took": took, "low": reach[0],
                "high": reach[1], "subject": self._subject, "quantity": self._quantity}  # fmt: skip
        return Update({"map": map_data}, found, area, reach)

    def _ask(self, work: Work) -> None:
        """Request work, which replaces waiting work."""
        self._wanted = work
        if not self._busy and not self._gone:
            self._busy = True
            self._pool.submit(self._work)

    def _work(self) -> None:
        """Loop of the thread: do the latest requested work, until there is none."""
        while self._wanted is not None:
            work, self._wanted = self._wanted, None
            try:
                for update in work(lambda: self._wanted is not None):
                    self._hand(partial(self._apply, update))
                    if self._wanted is not None:
                        break
            except InputError as error:
                self._hand(partial(self._tell, {"problems": [str(p) for p in error.problems]}))
            except Defect as error:
                self._hand(partial(self._tell, {"problems": [str(error)]}))
            except Exception as error:
                traceback.print_exc()
                self._hand(partial(self._tell, {"problems": [f"{type(error).__name__}: {error}"]}))
        self._hand(self._rested)

    def _hand(self, what: Callable[[], None]) -> None:
        """Have something done where the page may be changed."""
        with suppress(RuntimeError):  # request of a closed page
            self._page.add_next_tick_callback(what)

    def _rested(self) -> None:
        self._busy = False
        if self._wanted is not None:
            self._ask(self._wanted)
        elif self._settling:
            self._settling = False
            self._tell({"resting": True})

    def _apply(self, update: Update) -> None:
        self._page.hold("combine")
        if update.values is not None and update.area is self._area and update.reach is not None:
            self._reach = update.reach
            self.plan.paint(update.values, update.area, update.reach, QUANTITIES[update.news["map"]["quantity"]].label)
        if update.found is not None:
            self.sky.put(update.found.shares)
        if update.news:
            self._tell(update.news)
        self._page.unhold()

    def _tell(self, news: dict[str, Any]) -> None:
        self._sequence += 1
        text = json.dumps(news | {"sequence": self._sequence})
        self.news.data = {"news": [text]}


def _listed(names: tuple[str, ...], places: np.ndarray) -> list[dict[str, Any]]:
    """Transmitters with their places (n, 3), to the millimetre."""
    return [
        {"name": name, "x": round(float(x), 3), "y": round(float(y), 3), "up": round(float(up), 3)}
        for name, (x, y, up) in zip(names, places, strict=True)
    ]


def _figures(values: dict[str, float]) -> list[dict[str, Any]]:
    out = []
    for path, said, unit, decimals in FIGURES:
        if path in values:
            value = values[path] * (100.0 if unit == "%" else 1.0)
            text = f"{value:.{decimals}f}" if math.isfinite(value) else "none"
            out.append({"path": path, "said": said, "unit": unit, "value": text})
    if values.get("lost"):
        out.append({"path": "lost", "said": "epochs without a fix", "unit": "", "value": f"{values['lost']:.0f}"})
    return out


def _shares(found: Performance) -> list[dict[str, Any]]:
    """Sources by their contribution, used ones first."""
    of = found.figures["dop/pdop"]
    out = []
    for each in found.shares:
        used = each.used and math.isfinite(of)
        without = None if not used else each.without if math.isfinite(each.without) else "none"
        out.append({
            "name": each.name, "used": each.used, "ground": each.ground, "elevation": round(each.elevation, 1),
            "without": without, "more": without / of - 1.0 if isinstance(without, float) else None,
        })  # fmt: skip
    worth = {"none": math.inf, None: -1.0}
    return sorted(out, key=lambda s: worth.get(s["without"], s["without"]), reverse=True)
