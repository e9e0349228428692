"""Whether a result holds what the schema declares for its layout: all that must be there, nothing else, as said."""

from __future__ import annotations

import re

import numpy as np

from navsim.results.builder import missing
from navsim.results.result import Result
from navsim.results.schema import CHECKSUMS, CONTENTS, COVARIANCE, DTYPES, LAYOUTS, RARE, ROOT, declared


def layout_of(result: Result) -> str:
    """The layout a result has in the schema."""
    kind = str(result.attributes["kind"])
    of_method = {"covariance": COVARIANCE, "rare": RARE} if kind == "landing" else {}
    return of_method.get(str(result.attributes.get("method")), kind)


def named(result: Result) -> dict[str, tuple[str, ...]]:
    """The members of the families that the study named, from what is there."""

    def under(group: str) -> tuple[str, ...]:
        paths = (path for path in result.variables if path.startswith(f"{group}/"))
        return tuple(dict.fromkeys(path.removeprefix(f"{group}/").split("/")[0] for path in paths))

    found = {"system": under("/navigation"), "case": under("/cases"), "varied": under("/sweep/axes")}
    found["sensor"] = tuple(dict.fromkeys((*under("/aiding"), *under("/summary/aiding"))))
    numbered = (re.fullmatch(r"/sweep/requirement_(\d+)", path) for path in result.variables)
    found["number"] = tuple(match[1] for match in numbered if match)
    if "/outcome/combination" in result:
        found["dimension"] = result.variables["/outcome/combination"].dims
    return found


def as_declared(result: Result) -> None:
    """Fails where a variable is not declared, is lacking, or is not what it is declared to be."""
    layout = layout_of(result)
    assert layout in LAYOUTS
    due_attributes = {name for name, (layouts, _) in ROOT.items() if layout in layouts}
    assert set(result.attributes) == due_attributes - {CHECKSUMS, CONTENTS}
    due = declared(layout, tuple(named(result).items()))
    assert sorted(set(result.variables) - set(due)) == []
    assert missing(due, result.variables) == []
    for path, variable in result.variables.items():
        one, data = due[path], np.asarray(variable.data)
        assert variable.units, path
        assert variable.long_name, path
        for said, given in (
            (one.units, variable.units),
            (one.meaning, variable.long_name),
            *zip(one.dims, variable.dims, strict=True),
        ):
            pattern = re.sub(r"\\{\w+\\}", ".*", re.escape(said))
            assert re.fullmatch(pattern, given), (path, said, given)
        assert data.dtype.kind in DTYPES[one.of], path
        assert set(variable.attributes) == set(one.attributes), path
        if one.labels:
            assert tuple(data) == one.labels, path
        for dim, coordinate, length in zip(variable.dims, one.coordinates, data.shape, strict=True):
            assert result[coordinate or f"/{dim}"].shape == (length,), (path, dim)
