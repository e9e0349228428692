"""A result under construction: data are added by path, the schema describes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from navsim.defect import Defect
from navsim.results.result import Result, Stream, Variable
from navsim.results.schema import DTYPES, FINDINGS, LATE, ROOT, Declared, declared, fields

_NONE: Mapping[str, Any] = MappingProxyType({})


class ResultBuilder:
    """Variables of a result so far. It raises a Defect at once for those that the schema does not declare.

    - `layout`: of the result, see `schema.LAYOUTS`.
    - `words`: inserted into all units and meanings, see `schema.WORDS`.
    - `named`: members of the families that a study names, see `schema.FAMILIES`.

    Coordinates with the same labels in every result are present from the start.
    """

    def __init__(self, layout: str, words: Mapping[str, str] = _NONE, **named: Sequence[str]) -> None:
        self.layout = layout
        self.variables: dict[str, Variable] = {}
        self._words = words
        # a study may name a case twice
        families = tuple((family, tuple(dict.fromkeys(members))) for family, members in named.items())
        self._declared = declared(layout, families)
        self._lengths: dict[str, tuple[int, str]] = {}
        for path, one in self._declared.items():
            if one.labels:
                self.put(path, np.array(one.labels))

    def __setitem__(self, path: str, data: Any) -> None:
        self.put(path, data)

    def __getitem__(self, path: str) -> np.ndarray:
        return np.asarray(self.variables[path].data)

    def __contains__(self, path: str) -> bool:
        return path in self.variables

    def put(self, path: str, data: Any, attributes: Mapping[str, Any] = _NONE, **words: str) -> None:
        """Data (an array, a number or a Stream) of a path, with its attributes, and words for its unit and meaning."""
        one = self._declared.get(path)
        if one is None:
            raise Defect(f"{path}: not declared for results of layout {self.layout}")
        data = data if isinstance(data, Stream) else np.asarray(data)
        if data.dtype.kind not in DTYPES[one.of]:
            raise Defect(f"{path}: {data.dtype} where {one.of} is declared")
        if set(attributes) != set(one.attributes):
            raise Defect(f"{path}: attributes {sorted(attributes)} where {sorted(one.attributes)} are declared")
        dims, units, meaning = one.dims, one.units, one.meaning
        if words or self._words:
            every = {**self._words, **words}
            dims = tuple(_fill_template(path, dim, every) for dim in dims)
            units, meaning = _fill_template(path, units, every), _fill_template(path, meaning, every)
        elif fields("".join((*dims, units, meaning))):
            raise Defect(f"{path}: no word for {', '.join(fields(''.join((*dims, units, meaning))))}")
        if len(data.shape) != len(dims):
            raise Defect(f"{path}: {len(data.shape)} dimensions where {', '.join(dims) or 'none'} are declared")
        self._measure(path, one, dims, data.shape)
        self.variables[path] = Variable(dims, data, units, meaning, dict(attributes))

    def _measure(self, path: str, one: Declared, dims: tuple[str, ...], shape: tuple[int, ...]) -> None:
        """Raise Defect where a dimension has another length than elsewhere: data would be stored cut or stretched."""
        for dim, coordinate, length in zip(dims, one.coordinates, shape, strict=True):
            coordinate = coordinate or f"/{dim}"  # that of an axis whose name came with the data
            due, first = self._lengths.setdefault(coordinate, (length, path))
            if due != length:
                raise Defect(f"{path}: {length} values along {dim}, which has {due} in {first}")

    def result(self, attributes: dict[str, Any]) -> Result:
        """The result without its findings and `LATE` attributes, which come last.

        Raises Defect for a missing variable or root attribute, or one too many.
        """
        lacking = [path for path in missing(self._declared, self.variables) if not path.startswith(FINDINGS)]
        lacking += [path for path in self._lengths if path not in self.variables]
        if lacking:
            raise Defect(f"a result of layout {self.layout} without {', '.join(lacking)}")
        due = {name for name, (layouts, _) in ROOT.items() if self.layout in layouts and name not in LATE}
        if set(attributes) != due:
            raise Defect(f"root attributes of layout {self.layout}: {', '.join(sorted(due ^ set(attributes)))}")
        return Result(attributes, self.variables)


def missing(due: Mapping[str, Declared], there: Mapping[str, Any]) -> list[str]:
    """Paths that every result has, and this one has not."""
    return [path for path, one in due.items() if not one.when and path not in there]


def _fill_template(path: str, text: str, words: Mapping[str, str]) -> str:
    try:
        return text.format_map(words) if "{" in text else text
    except KeyError as error:
        raise Defect(f"{path}: no word for {error.args[0]}") from None
