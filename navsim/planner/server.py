"""The planner's server: at this machine's own address alone, for a page that comes from it, with one file to write."""

from __future__ import annotations

import asyncio
import logging
import secrets
import webbrowser
from collections.abc import Callable
from importlib.resources import files as packaged
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document as Page
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.web import ErrorHandler

import navsim
from navsim.planner.drawing import Outline
from navsim.planner.proposal import PlannedScenario
from navsim.planner.session import PlannerSession
from navsim.planner.target import Target
from navsim.scenario_files.base import DEG
from navsim.scenario_files.source import Document

ADDRESS = "127.0.0.1"
_OWN_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this machine in addresses of its pages, with any port: one of a tunnel differs."""
MOST_PAGES = 10
"""Pages that may be open at once."""
_LIFETIME_MS = 15_000
"""A page that never connects, or went away, is dropped after this time."""
LOST = "a page of the planner was closed with changes that were not saved"
KEPT = "changes in the planner were not saved"


class _OwnPages(BokehTornado):  # type: ignore[misc] # Bokeh has no types
    """Serve Bokeh's pages only to this machine's own names and this server's own pages.

    A page of another site could otherwise reach the planner by a name of its own that points to 127.0.0.1 (DNS
    rebinding), or include its script.
    """

    is_full: Callable[[], bool] = staticmethod(lambda: False)

    def find_handler(self, request: HTTPServerRequest, **options: Any) -> Any:
        """Handler of a request; an error handler for anything but the planner's page."""
        status = 200
        if not is_own(request.headers.get("Host"), request.headers.get("Origin")):
            status = 403
        elif request.path.rstrip("/") not in ("", "/ws", "/favicon.ico") and not request.path.startswith("/static/"):
            status = 404
        elif request.path == "/" and self.is_full():
            status = 503
        if status != 200:
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": status})
        return super().find_handler(request, **options)


def is_own(host: str | None, origin: str | None) -> bool:
    """Whether a request is for this machine by one of its names and, if a page sent it, by a page of this server."""
    try:
        named = urlsplit(f"//{host}").hostname
        if host is None or named not in _OWN_NAMES:
            return False
        return origin is None or origin.lower() in (f"http://{host.lower()}", f"https://{host.lower()}")
    except ValueError:
        return False


class Planner:
    """The pages of one scenario file."""

    def __init__(self, document: Document, text: str, target: Path, overlay: list[Outline]) -> None:
        self._document, self._text, self._target, self._overlay = document, text, target, overlay
        self._open: list[PlannerSession] = []

    def serve(self, port: int, browser: bool, text: Callable[[str], None], warned: Callable[[str], None]) -> None:
        """Serve until something ends it.

        text: receives the address; warned: receives unsaved changes. Raises OSError for a port that is not available.
        """
        for name in ("bokeh", "tornado"):
            logging.getLogger(name).setLevel(logging.ERROR)
        asyncio.set_event_loop(asyncio.new_event_loop())
        sockets, port = bind_sockets(ADDRESS, port)
        application = Application(FunctionHandler(lambda page: self._open_session(page, warned)))
        tornado = _OwnPages(
            {"/": application},
            extra_websocket_origins=["*"],  # `is_own` has looked at them
            secret_key=secrets.token_bytes(32),
            sign_sessions=True,  # no page without having been served
            check_unused_sessions_milliseconds=_LIFETIME_MS,
            unused_session_lifetime_milliseconds=_LIFETIME_MS,
        )
        tornado.is_full = lambda: len(self._open) >= MOST_PAGES
        http = HTTPServer(tornado)
        http.add_sockets(sockets)
        server = BaseServer(IOLoop.current(), tornado, http)
        server.start()
        address = f"http://{ADDRESS}:{port}/"
        text(address)
        if browser:
            webbrowser.open(address)
        try:
            server.io_loop.start()
        finally:
            if any(each.unsaved for each in self._open):
                warned(KEPT)
            for each in self._open:
                each.close()

    def _open_session(self, page: Page, warned: Callable[[str], None]) -> None:
        proposal = PlannedScenario(self._document, self._text)
        session = PlannerSession(page, proposal, Target(self._target), self._overlay)
        self._open.append(session)

        def closed(_: Any) -> None:
            if session in self._open:
                self._open.remove(session)
                if session.unsaved:
                    warned(LOST)
            session.close()

        page.on_session_destroyed(closed)
        folder = packaged(__package__)
        read = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in _PARTS}
        shared = packaged("navsim.page").joinpath("page.css").read_text(encoding="utf-8")
        environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
        scenario = proposal.scenario
        page.title = scenario.title or self._document.file
        page.template = environment.from_string(read["planner.html"])
        page.template_variables.update({
            "heading": scenario.title or Path(self._document.file).name, "file": self._document.file,
            "target": str(self._target), "version": navsim.__version__,
            "style": Markup(shared.partition("* {")[0] + read["planner.css"]),  # ours
            "script": Markup(read["planner.js"]),  # the same
        })  # fmt: skip


_PARTS = ("planner.html", "planner.css", "planner.js")


def outlines(proposal: PlannedScenario, found: list[tuple[str, list[list[tuple[float, float]]], str]]) -> list[Outline]:
    """Features of `formats.geojson.lines` in axes of the runway, from longitude and latitude."""
    height = proposal.threshold[2]
    out: list[Outline] = []
    for what, parts, name in found:
        seen = []
        for part in parts:
            lon_lat = np.array(part) * DEG
            s_l1 = proposal.plane.places(np.column_stack([lon_lat[:, 1], lon_lat[:, 0], np.full(len(part), height)]))
            seen.append(np.column_stack([-s_l1[:, 1], s_l1[:, 0]]))
        out.append((what, seen, name))
    return out
