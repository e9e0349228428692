"""Strict parser of a page's requests: the session receives a valid request or none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from navsim.planner.outlook import QUANTITIES

_FARTHEST = 1e6
"""Largest distance of a position from the threshold, m."""
_DAY = 86400.0
_MOST = 1e15
"""Largest number of a request."""
_LONGEST = 10_000
"""Characters of an order; the longest that the page sends has some hundred."""


class UnknownRequest(Exception):
    """An order that no page of the planner sends."""


@dataclass(frozen=True)
class SourceCounts:
    """Numbers of pseudolites, jammers and beacons that requests may use."""

    pseudolites: int
    jammers: int
    beacons: int = 0


def read_order(text: object, known: SourceCounts) -> dict[str, Any]:
    """An order, with each of its members of the right type and within its range. Raises UnknownRequest."""
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise UnknownRequest("a request of the page is not text, or too long")
    try:
        order = json.loads(text)
    except (ValueError, RecursionError):
        raise UnknownRequest("a request of the page is not JSON") from None
    if not isinstance(order, dict) or not isinstance(do := order.get("do"), str) or do not in _MEMBERS:
        raise UnknownRequest("the page asks for something that the planner does not do")
    out: dict[str, Any] = {"do": do}
    if "n" in order:
        out["n"] = _number(order["n"], "n", -_MOST, _MOST)
    for name in _MEMBERS[do]:
        if name == "up" and name not in order:  # its height does not change
            continue
        if name not in order:
            raise UnknownRequest(f"{do}: {name} is missing")
        out[name] = _READ[name](order[name], name)
    count = {"jammer": known.jammers, "beacon": known.beacons}.get(out.get("kind", ""), known.pseudolites)
    for name, least in (("number", 0), ("subject", -1)):
        if name in out and not least <= out[name] < count:
            raise UnknownRequest(f"{do}: there is no transmitter with the number {out[name]}; there are {count}")
    return out


def _number(value: object, name: str, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise UnknownRequest(f"{name}: a finite number is needed, not {str(value)[:40]}")
    if not least <= value <= most:
        raise UnknownRequest(f"{name}: {str(value)[:40]} is not from {least:g} to {most:g}")
    return float(value)


def _integer(value: object, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise UnknownRequest(f"{name}: a whole number is needed, not {str(value)[:40]}")
    return value


def _between(least: float, most: float) -> Callable[[object, str], float]:
    return lambda value, name: _number(value, name, least, most)


def _one_of(*choices: Any) -> Callable[[object, str], Any]:
    def read(value: object, name: str) -> Any:
        if not any(type(value) is type(choice) and value == choice for choice in choices):
            raise UnknownRequest(f"{name}: one of {', '.join(map(str, choices))} is needed, not {str(value)[:40]}")
        return value

    return read


_PLACE = ("kind", "number", "x", "y")
_MEMBERS: dict[str, tuple[str, ...]] = {
    "hello": (), "drag": _PLACE, "hasten": ("seconds",), "show": ("quantity", "subject"), "area": ("factor",),
    "save": ("consent",), "place": (*_PLACE, "up"), "add": (), "remove": ("number",), "time": ("seconds",),
    "undo": (), "redo": (),
}  # fmt: skip
"""Members of a request by its type; `n`, its number, is allowed in each."""
_READ: dict[str, Callable[[object, str], Any]] = {
    "kind": _one_of("pseudolite", "jammer", "beacon"),
    "number": _integer,
    "subject": _integer,
    "x": _between(-_FARTHEST, _FARTHEST),
    "y": _between(-_FARTHEST, _FARTHEST),
    "up": _between(-_FARTHEST, _FARTHEST),
    "seconds": _between(0.0, _DAY),
    "factor": _between(1e-3, 1e3),
    "quantity": _one_of(*QUANTITIES),
    "consent": _one_of(True, False),
}
