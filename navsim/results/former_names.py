"""Former names of keys of files. Files, and the scenarios of results, are read with them; a warning names the new
one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_OF_ALL = {
    "approach.corner_s": "transition_time_s",
    "sky.lenient": "skip_bad_records",
    "receiver.one_clock": "single_clock",
    "integrity.alarmed_fixes": "on_alarm",
    "integrity.heavier": "heavy_tailed",
    "filter.gaussian_sum.heading_deg": "split_heading_sigma_deg",
    "signals.errors.*.time_s": "correlation_time_s",
}
_FORMER = {
    "landing": _OF_ALL,
    "replay": {
        "lenient": "skip_bad_records",
        "filter.gaussian_sum.heading_deg": "split_heading_sigma_deg",
        "gnss.errors.*.time_s": "correlation_time_s",
    },
    "ranges": {f"bias.{name}.time_s": "correlation_time_s" for name in ("wander", "place", "common")},
}
"""Former keys of each kind of file, "*" for any key or number in a list, with the new last part."""
_PATHS = {
    "/front": "/pareto", "/useful/subsets": "/subsets/number", "/useful/subsets_of_all": "/subsets/number_of_all",
    "/useful": "/subsets", "/audit": "/published", "/fit/letter": "/fit/id",
    "/summary/fixes": "/summary/motion",
}  # fmt: skip
"""Former paths of variables and groups of results."""
_VALUES = {"integrity.error_model": {"heavier": "heavy_tailed"}}
"""Former values of a landing's keys."""


def current(kind: object, path: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Path of a key by its present name."""
    for former, new in _FORMER.get(str(kind), {}).items():
        parts = former.split(".")
        if len(path) >= len(parts) and all(p in ("*", str(q)) for p, q in zip(parts, path, strict=False)):
            return (*path[: len(parts) - 1], new, *path[len(parts) :])
    return path


def renew(data: Any) -> Iterator[tuple[tuple[str | int, ...], tuple[str | int, ...]]]:
    """Give keys and values of a file their present names, in place; yields former and present path of each key.

    Raises KeyError with the present path if both names are there.
    """
    kind = data.get("kind") if isinstance(data, dict) else None
    for former, new in _FORMER.get(str(kind), {}).items():
        for path, section in list(_sections(data, (), former.split(".")[:-1])):
            old = former.rpartition(".")[2]
            if isinstance(section, dict) and old in section:
                if new in section:
                    raise KeyError((*path, new))
                section[new] = section.pop(old)
                yield (*path, old), (*path, new)
    for key, values in _VALUES.items() if kind == "landing" else ():
        *above, last = key.split(".")
        for _, section in _sections(data, (), above):
            if isinstance(section, dict) and isinstance(value := section.get(last), str) and value in values:
                section[last] = values[value]


def present_path(path: str) -> str:
    """Path of a variable of a result by its present name."""
    parts = path.split("/")
    for count in range(len(parts), 1, -1):
        if (begin := "/".join(parts[:count])) in _PATHS:
            return "/".join([_PATHS[begin], *parts[count:]])
    return path


def with_present_names(data: Any) -> Any:
    """The data of a stored scenario, after `renew`."""
    list(renew(data))
    return data


def _sections(node: Any, path: tuple[str | int, ...], parts: list[str]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Sections at a path of keys, with their own paths."""
    if not parts:
        yield path, node
    elif isinstance(node, (dict, list)):
        for key, value in list(node.items()) if isinstance(node, dict) else enumerate(node):
            if parts[0] in ("*", str(key)):
                yield from _sections(value, (*path, key), parts[1:])
