"""Common base of all scenario sections: strict keys, unit conversions, validation with places and hints."""

from __future__ import annotations

import ast
import datetime
import difflib
import inspect
import itertools
import math
import re
import sys
import types
import typing
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError

from navsim.formats.units import unit_of, without_unit
from navsim.scenario_files.source import Document, InputError, KeyPath, Problem, dotted

DEG = math.pi / 180.0
DEG_H = DEG / 3600.0
DEG_SQRT_H = DEG / 60.0
MG = 9.80665e-3
KMH = 1.0 / 3.6


def as_tuple(value: Any) -> Any:
    """A list as a tuple, anything else unchanged."""
    return tuple(value) if isinstance(value, list) else value


_FORMS = {
    r"^[0-9a-f]{64}$": "64 hexadecimal digits in small letters",
    r"^[A-Za-z0-9_-]{1,16}$": "1 to 16 of the letters A to Z and a to z, digits, - and _",
    r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*$": "a key: names with dots between them",
    r"^(touchdown|50ft|100ft|200ft|(0|[1-9][0-9]{0,3})(\.[0-9]?[1-9])?m)$": (
        "touchdown, 50ft, 100ft, 200ft, or any height in metres such as 30m or 30.5m"
    ),
}
"""Forms of texts, with their names."""
_SHA, _NAME, _DOTTED, _HEIGHT = _FORMS
Checksum = Annotated[str, Field(pattern=_SHA)]
"""SHA-256 of a file."""
SourceName = Annotated[str, Field(pattern=_NAME)]
"""Name of a source of signals on the ground."""
Dotted = Annotated[str, Field(pattern=_DOTTED)]
"""Key of a scenario."""
HeightName = Annotated[str, Field(pattern=_HEIGHT)]
"""Height above the runway at which errors are evaluated."""


def one_or_more(item: Any) -> BeforeValidator:
    """Takes one `item` for a list of one, and publishes that it does."""
    return BeforeValidator(_several, json_schema_input_type=item | tuple[item, ...])


def _several(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)


@PlainSerializer
def one_or_list(value: tuple[Any, ...]) -> Any:
    """Written form of a tuple: a single value alone."""
    return value[0] if len(value) == 1 else list(value)


# Every number of every section has both ends (tests/unit/test_bounds.py): wide enough for anything that flies, narrow
# enough that no square, quotient or sum of them overflows or vanishes.
Sigma = Annotated[float, Field(ge=1e-9, le=1e6)]
"""A standard deviation that is not 0, or another size, in the unit of its key."""
NonNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Signed = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A place, an offset, an error, in the unit of its key."""
Variance = Annotated[float, Field(ge=1e-18, le=1e12)]
LONGEST_FLIGHT = 1e6
"""Longest simulation, s. The memory estimate limits flights further."""
FlightTime = Annotated[float, Field(ge=0.0, le=LONGEST_FLIGHT)]
"""A time in a flight, s after time 0."""
EndTime = Annotated[float, Field(gt=0.0, le=LONGEST_FLIGHT)]
"""When a flight, or a part of it, ends, s after time 0."""
Stretch = Annotated[float, Field(ge=0.01, le=LONGEST_FLIGHT)]
"""Duration of a part of a flight, s."""
ScanPeriod = Annotated[float, Field(ge=0.001, le=60.0)]
"""Between measurements, s."""
CorrelationTime = Annotated[float, Field(ge=1e-3, le=1e9)]
"""Correlation time of an exponentially correlated error, s."""
Latency = Annotated[float, Field(ge=0.0, le=30.0)]
FIX_LATENCIES = (-1.0, 5.0)
"""Bounds of the latency of fixes, s; below zero they are stamped before the time they are valid."""
FixLatency = Annotated[float, Field(ge=0.0, le=FIX_LATENCIES[1])]
"""From the time a fix is valid to the time the filter gets it, s."""
RecordedLatency = Annotated[float, Field(ge=FIX_LATENCIES[0], le=FIX_LATENCIES[1])]
"""Latency of a recorded fix relative to its time stamp, s."""
Decay = Annotated[float, Field(ge=1e-9, le=1e3)]
"""Its reciprocal, 1/s."""
Size = Annotated[float, Field(ge=0.1, le=1e5)]
"""A length on the ground, m."""
LogTime = Annotated[float, Field(ge=-1e12, le=1e12)]
"""A time as a recording counts it, s."""
Latitude = Annotated[float, Field(ge=-89.0, le=89.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=360.0)]
Azimuth = Annotated[float, Field(ge=0.0, le=360.0)]
Elevation = Annotated[float, Field(ge=-90.0, le=90.0)]
_FIRST_YEAR, _LAST_YEAR = 1970, 2199
_UTC_FORMAT = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}(:\d{2}(\.\d{1,6})?)?Z")


def _utc(value: Any) -> Any:
    if isinstance(value, datetime.datetime):
        return value
    if not (isinstance(value, str) and _UTC_FORMAT.fullmatch(value)):
        raise ValueError("expected a UTC time such as 2018-09-13T12:00:00Z")
    time = datetime.datetime.fromisoformat(value)
    if not _FIRST_YEAR <= time.year <= _LAST_YEAR:
        raise ValueError(f"expected a time in the years {_FIRST_YEAR} to {_LAST_YEAR}")
    return time


def utc_text(time: datetime.datetime) -> str:
    """A UTC time such as 2018-09-13T12:00:00Z, with as many decimals as it has."""
    return time.strftime("%Y-%m-%dT%H:%M:%S.%f").rstrip("0").rstrip(".") + "Z"


Utc = Annotated[datetime.datetime, BeforeValidator(_utc), PlainSerializer(utc_text, when_used="json")]
Triple = Annotated[tuple[Signed, Signed, Signed], BeforeValidator(as_tuple)]
Pair = Annotated[tuple[Signed, Signed], BeforeValidator(as_tuple)]


T = typing.TypeVar("T")


def _distinct(values: tuple[T, ...]) -> tuple[T, ...]:
    for i, value in enumerate(values):
        if value in values[:i]:
            raise ValueError(f"{value} is given twice; write it once")
    return values


PairOf = Annotated[tuple[T, T], BeforeValidator(as_tuple)]
"""A YAML list of two of a type, kept as a tuple."""
TripleOf = Annotated[tuple[T, T, T], BeforeValidator(as_tuple)]
"""A YAML list of three of a type, kept as a tuple."""
ListOf = Annotated[tuple[T, ...], BeforeValidator(as_tuple)]
"""A YAML list of a type, kept as a tuple."""
DistinctListOf = Annotated[tuple[T, ...], BeforeValidator(as_tuple), AfterValidator(_distinct)]
"""A YAML list of distinct values of a type, kept as a tuple."""


def _as_integer(value: Any) -> Any:
    if isinstance(value, (bool, float)):
        raise ValueError("expected a whole number")
    return value


whole = BeforeValidator(_as_integer)
"""For choices of integers, for which Python would also accept false, true and 2.0."""
Version = Annotated[Literal[1], whole]


@cache
def _classes(module: str) -> dict[str, list[ast.stmt]]:
    """Bodies of the classes at the top of a module's source; inspect would parse all of it again for each class."""
    written = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node.body for node in written.body if isinstance(node, ast.ClassDef)}


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Docstrings of the fields in a class's source; none for a class within a function."""
    out = {}
    for field, below in itertools.pairwise(_classes(model.__module__).get(model.__qualname__, [])):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                out[name] = inspect.cleandoc(text)
    return out


def _describe(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Add the docstrings of the fields to a schema.

    pydantic's `use_attribute_docstrings` would read every class's source at every start, although only `navsim schema`
    needs it.
    """
    _count_items(schema)
    for part in model.__mro__:
        if issubclass(part, Section) and part is not Section:
            for name, text in _docstrings(part).items():
                key = model.model_fields[name].alias or name
                if key in schema["properties"]:  # `SkipJsonSchema` leaves a key out
                    schema["properties"][key].setdefault("description", text)


def _count_items(node: Any) -> None:
    """Give lists the words for their lengths: behind a validator pydantic takes them for texts."""
    if isinstance(node, dict):
        if node.get("type") == "array":
            for text, items in (("minLength", "minItems"), ("maxLength", "maxItems")):
                if text in node:
                    node[items] = node.pop(text)
        for child in node.values():
            _count_items(child)
    elif isinstance(node, list):
        for child in node:
            _count_items(child)


class Section(BaseModel):
    """A part of a scenario: immutable, no unknown keys, no silent conversions, finite numbers."""

    # nested sections are built with their parents, and separately only on demand
    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        json_schema_extra=_describe,
        defer_build=True,
    )

    @classmethod
    def completed(cls, document: Document) -> Any:
        """The data of a document, with what a section takes from files of results. Raises InputError."""
        return document.data


S = typing.TypeVar("S", bound=Section)


def validated(model: type[S], document: Document) -> S:
    """The document as `model`. Raises InputError with every problem found, each at its line."""
    try:
        return model.model_validate(model.completed(document))
    except ValidationError as error:
        found = _without_repeats(document, [dict(e) for e in error.errors(include_url=False)])
        problems = [_problem(model, document, e) for e in found]
        unique = {str(p): p for p in problems}
        order = sorted(unique.values(), key=lambda p: (p.place.line, p.place.column))
        raise InputError(order) from None


def _without_repeats(document: Document, errors: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Errors without repeated ones about a text as a number, or a number as one of some words, for keys that accept
    either; and without missing keys that an unknown preset may have."""
    words, numbers = {"literal_error"}, ("float", "int", "greater", "less", "finite", "multiple")
    out = []
    unknown = [each["loc"][:-1] for each in errors if each["type"] in words and each["loc"][-1] == "preset"]
    for one in errors:
        if one["type"] == "missing" and one["loc"][:-1] in unknown:
            continue
        path = _data_path(document.data, one["loc"], absent_leaf=False)
        others = {other["type"] for other in errors if _data_path(document.data, other["loc"], False) == path}
        is_text = isinstance(_value_at(document.data, path), str)
        numeric = any(each.startswith(numbers) for each in others)
        if others & words and numeric and (one["type"] in words) != is_text:
            continue
        out.append(one)
    return out


def reject(message: str, *path: str | int) -> ValueError:
    """An error for model validators to raise, about the key at `path` below the section."""
    return KeyedError(message, path)


class KeyedError(ValueError):
    """A cross-check that failed, with the key it is best reported at."""

    def __init__(self, message: str, path: KeyPath) -> None:
        super().__init__(message)
        self.path = path


def _problem(model: type[Section], document: Document, error: dict[str, Any]) -> Problem:
    cause = error.get("ctx", {}).get("error")
    kind = error["type"]
    path = _data_path(document.data, error["loc"], absent_leaf=kind == "missing")
    if isinstance(cause, KeyedError):
        path = (*path, *cause.path)
        return Problem(document.place(path), dotted(path), str(cause))
    place = document.place(path)
    key = dotted(path)
    if kind == "extra_forbidden":
        near = _nearest_key(str(path[-1]), _keys_at(model, error["loc"][:-1]))
        return Problem(place, key, "unknown key; " + (_elsewhere(model, path[-1], near) or near))
    if kind == "missing" and isinstance(error["loc"][-1], int):
        return Problem(place, key, f"the list is too short: value {error['loc'][-1] + 1} is missing")
    if kind == "missing":
        return Problem(place, key, "this key is required")
    message = error["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:] if message else kind
    if kind in ("literal_error", "union_tag_invalid", "union_tag_not_found"):
        context = error["ctx"]
        expected = str(context.get("expected") or context.get("expected_tags") or context["discriminator"])
        if kind != "literal_error":
            tag = str(context["discriminator"]).strip("'")
            path = (*path, tag)
            place, key = document.place(path), dotted(path)
        if kind == "union_tag_not_found":
            return Problem(place, key, "this key is required")
        given = _value_at(document.data, path)
        choices = [c.strip(" '") for c in expected.replace(" or ", ",").split(",")]
        if error["loc"][-1] == "[key]":  # so pydantic marks the key of a mapping
            return Problem(place, key, "unknown key; " + hint(str(path[-1]), choices))
        if isinstance(given, str) and given in choices:  # a number in quotation marks
            return Problem(place, key, f"a number is needed, not the text {given!r}; allowed: {', '.join(choices)}")
        said = f"allowed: {', '.join(choices)}"
        if path[-1] == "operation":  # another operation has weaker limits
            same = [one for one in choices if _spelling(one) == _spelling(str(given))]
            said = "".join(f"did you mean '{one}'? " for one in same) + said
        elif isinstance(given, str):  # no number is nearest to another by its digits
            said = hint(given, choices)
        return Problem(place, key, f"{_as_written(given)} is not allowed; {said}")
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return Problem(place, key, _section_needed(model, error["loc"], error.get("input")))
    elif kind == "tuple_type":
        return Problem(place, key, _list_needed(model, error["loc"], error.get("input")))
    elif kind == "string_type":
        message = "expected a text"
        if isinstance(given := error.get("input"), (int, float)):
            return Problem(place, key, f'{message}, not {_shown(given)}; in quotation marks it is one: "{given}"')
    elif kind in ("bool_type", "bool_parsing"):
        message = "expected true or false"
    elif kind == "too_short":
        return Problem(place, key, f"expected a list of at least {error['ctx']['min_length']}, not an empty one")
    elif kind == "too_long":
        most, length = error["ctx"]["max_length"], error["ctx"]["actual_length"]
        text = f"expected a list of at most {most} values, not of {length}; commas part them, decimals take a point"
        return Problem(place, key, text)
    elif kind == "string_pattern_mismatch":
        message = f"expected {_FORMS[error['ctx']['pattern']]}"
    elif kind in ("float_type", "int_type"):
        message = f"expected {'a number' if kind == 'float_type' else 'a whole number'}"
    elif kind in _BOUNDS:
        (bound,) = error["ctx"].values()
        message = f"must be {_BOUNDS[kind]} {bound:.15g}"
    given = error.get("input")
    if kind in ("float_type", "int_type") and isinstance(given, str) and (said := _of_number(key, given)):
        return Problem(place, key, said)
    if kind == "value_error" and isinstance(given, (dict, list, tuple)):
        return Problem(place, key, message)  # errors of a validator of a whole section contain the given value
    shown = _shown(given)
    unit = ""
    if kind in _BOUNDS:
        leaf = error["loc"][-1]
        absent = isinstance(leaf, str) and path[-1:] != (leaf,)
        if absent and leaf in _keys_at(model, error["loc"][:-1]):  # no key of the file: it follows from others
            key = dotted((*path, leaf))
            message = f"follows from the other keys; {message}"
        unit = f" {found}" if (found := unit_of(key)) else ""
        shown = f"{given:.15g}" if isinstance(given, float) else shown
    return Problem(place, key, f"{message}{unit}, not {shown}{unit}")


def _section_needed(model: type[Section], location: tuple[str | int, ...], given: Any) -> str:
    """Error about a value where a section is needed, with the key that takes such a value."""
    message = f"expected a section, a mapping of keys to values, not {_shown(given)}"
    sections = _sections_at(model, location)
    fields = [(one, field.alias or name, field) for one in sections for name, field in one.model_fields.items()]
    if given is None and isinstance(location[-1], str):
        parents = [one.model_fields.get(location[-1]) for one in _sections_at(model, location[:-1])]
        required = any(field is not None and field.is_required() for field in parents)
        return f"{message}; " + ("the key is required" if required else "without the key it has its defaults")
    if isinstance(given, (list, tuple)) and any(isinstance(each, dict) for each in given):
        return f"{message}: without the dash before its keys"
    meant = {name: word for _, name, field in fields if (word := _choice(field.annotation, given))}
    meant = meant or dict([(name, str(given)) for one, name, _ in fields if _fits(one, name, given)][:1])
    ask = f"did you mean {' or '.join(f'{{{name}: {word}}}' for name, word in meant.items())}? " if meant else ""
    return f"{message}; {ask}allowed: {', '.join(dict.fromkeys(name for _, name, _ in fields))}"


def _list_needed(model: type[Section], location: tuple[str | int, ...], given: Any) -> str:
    """Error about a value where a list is needed."""
    message = f"expected a list, not {_shown(given)}"
    parents = _sections_at(model, location[:-1])
    fields = [one.model_fields[str(location[-1])] for one in parents if str(location[-1]) in one.model_fields]
    if given is None:
        return f"{message}; [] is an empty one"
    if isinstance(given, dict) or any(_models_in(field.annotation) for field in fields):
        return f"{message}; begin each entry with a dash"
    length = max((_length(field.annotation) for field in fields), default=0)
    if length and isinstance(given, int | float):
        return f"expected {length} numbers in brackets, [{', '.join('abcdef'[:length])}], not {_shown(given)}"
    alone = any(_fits(one, str(location[-1]), (given,)) for one in parents)
    return f"{message}; one value in brackets is one: [{given}]" if alone else message


def _length(annotation: Any) -> int:
    """Length of the lists of a type, 0 for any length or none."""
    args = typing.get_args(annotation)
    if typing.get_origin(annotation) is tuple:
        return 0 if ... in args else len(args)
    return max(map(_length, args), default=0)


def _fits(section: type[Section], name: str, value: Any) -> bool:
    """Whether a key of a section can have a number, or a list, whatever the other keys are."""
    if isinstance(value, bool) or not isinstance(value, (int, float, tuple)):
        return False
    try:
        section.model_validate({name: value})
    except ValidationError as error:
        return all(each["loc"] and each["loc"][0] != name for each in error.errors(include_url=False))
    return True


def _choice(annotation: Any, given: Any) -> str:
    """A value as YAML has it, if a type chooses from such values; in brackets, if a list of the type does; else ""."""
    if typing.get_origin(annotation) is Literal:
        return (
            str(given) if any(given == one and type(given) is type(one) for one in typing.get_args(annotation)) else ""
        )
    word = next(filter(None, (_choice(part, given) for part in typing.get_args(annotation))), "")
    return f"[{word}]" if word and typing.get_origin(annotation) is tuple else word


_BOUNDS = {
    "less_than": "below", "less_than_equal": "at most", "greater_than": "above", "greater_than_equal": "at least",
}  # fmt: skip
"""Kinds of errors of numbers that are beyond a bound, and the words for it."""


def _shown(given: Any) -> str:
    """A value of a file in an error, cut off where it is long."""
    if isinstance(given, (int, float, str, bool, type(None))):
        return _as_written(given)[:60]
    return "a " + _noun(given)


def _as_written(value: Any) -> str:
    """A value as YAML has it."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else repr(value)


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_COMMA = re.compile(r"[-+]?\d+,\d+")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")


def _of_number(key: str, text: str) -> str:
    """Error about a text that begins with a number, where a number is needed; "" for other texts."""
    unit = unit_of(key)
    if _THOUSANDS.fullmatch(text):
        decimals, thousands = text.replace(",", "."), text.replace(",", "")
        ways = f"a point for the decimals, {decimals}, or nothing between thousands, {thousands}"
        return f"a number is needed, with {ways}, not {text!r}"
    if _COMMA.fullmatch(text):
        return f"a number is needed, with a point for the decimals: {text.replace(',', '.')}, not {text!r}"
    begins = _NUMBER.match(text.strip())
    if begins is None:
        return ""
    if begins[0] == text.strip():
        return f"a number is needed, not a text: without quotation marks, {begins[0]}"
    in_unit = f", in {unit} by the key's name," if unit else ""
    return f"a plain number is needed{in_unit} and nothing behind it, not {text[:60]!r}"


_FOREIGN = re.compile(
    "ft|feet|inch|in|nm|nmi|mi|miles|kt|kts|knots?|mph|kmh|kph|fpm|mps|m_s|ms|km|cm|mm|m|deg|rad|mrad|arcmin|"
    "min|hours?|h|days?|ns|us|s|hz|khz|mhz|ghz|g|mg|ug|hpa|mbar|pa|inhg|c|f|k|w|mw|dbm|dbw|db|ppm|percent"
)
"""Suffixes of key names with units that users write."""

_SAME = {("dbm", "dBW"): " (30 dBm is 0 dBW)", ("dbw", "dBm"): " (0 dBW is 30 dBm)"}
"""One power in the units of two suffixes: the number cannot stay."""


def _nearest_key(given: str, allowed: list[str]) -> str:
    """Suggested key: the same one with the existing unit, else a similar spelling."""
    for key in allowed:
        begins, unit = without_unit(key), unit_of(key)
        if unit and given.startswith(f"{begins}_") and _FOREIGN.fullmatch(given.removeprefix(f"{begins}_").lower()):
            same = _SAME.get((given.rpartition("_")[2].lower(), unit), "")
            return f"did you mean '{key}', in {unit}{same}? allowed: {', '.join(allowed)}"
    return hint(given, allowed)


def _elsewhere(model: type[Section], name: str | int, near: str) -> str:
    """Where a kind of file has a key of this name, if nothing near it is allowed; else ""."""
    if near.startswith("did you mean"):
        return ""
    found = [key for key in _every_key(model) if key.rpartition(".")[2] == name]
    return f"did you mean '{found[0]}'?" if len(found) == 1 else ""


@cache
def _every_key(model: type[Section]) -> tuple[str, ...]:
    from navsim.scenario_files.keys import rows

    return tuple(row.key for row in rows(model.model_json_schema()))


def _noun(value: Any) -> str:
    if isinstance(value, dict):
        return "mapping"
    return "list" if isinstance(value, (list, tuple)) else type(value).__name__


_OTHER_WORDS = {"msl": "geoid", "amsl": "geoid", "sea level": "geoid", "wgs84": "ellipsoid", "wgs-84": "ellipsoid",
                "hae": "ellipsoid", "localizer": "azimuth_station", "localiser": "azimuth_station",
                "glide_path": "elevation_station", "glidepath": "elevation_station"}  # fmt: skip
"""Words of other tools, and navsim's own for them."""


_DIGIT = re.compile(r"(?<!\d)[123]$")
"""Number of a category at the end of a word, CAT 1, that navsim writes in Roman digits, CAT-I."""


def _spelling(word: str) -> str:
    """A word without what tells no two operations apart: capitals, blanks, dashes, the sort of digits."""
    return _DIGIT.sub(lambda digit: "i" * int(digit[0]), re.sub(r"[\s_-]", "", word.lower()))


def hint(given: str, allowed: list[str]) -> str:
    """List the allowed words; before them the one that was meant: in capitals or small letters, by another name, or
    by a part of it."""
    spelt = {one.lower(): one for one in allowed}
    meant = _OTHER_WORDS.get(given.lower(), given.lower())
    near = difflib.get_close_matches(meant, list(spelt), n=1, cutoff=0.6)
    if not near and len(meant) > 2:
        having = [one for one in spelt if meant in one]
        near = having if len(having) == 1 else []
    ask = f"did you mean '{spelt[near[0]]}'? " if near else ""
    return f"{ask}allowed: {', '.join(allowed)}"


def _data_path(data: Any, location: tuple[str | int, ...], absent_leaf: bool) -> KeyPath:
    """pydantic's location without the tags of unions, which are no keys of the file.

    absent_leaf: the last part is a missing key.
    """
    path: KeyPath = ()
    for index, part in enumerate(location):
        last = absent_leaf and index == len(location) - 1
        if isinstance(data, dict) and (part in data or last):
            path = (*path, part)
            data = data.get(part)
        elif isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data):
            path = (*path, part)
            data = data[part]
    return path


def _value_at(data: Any, path: KeyPath) -> Any:
    for part in path:
        data = data.get(part) if isinstance(data, dict) else data[part]
    return data


def _keys_at(model: Any, location: tuple[str | int, ...]) -> list[str]:
    """The keys allowed in the section that pydantic's location leads to."""
    fields = (each for one in _sections_at(model, location) for each in one.model_fields.items())
    return [field.alias or name for name, field in fields]


def _sections_at(model: Any, location: tuple[str | int, ...]) -> list[type[Section]]:
    """The sections that pydantic's location leads to, several in a union."""
    here: list[Any] = [model]
    for part in location:
        below: list[Any] = []
        for one in here:
            if not (isinstance(one, type) and issubclass(one, BaseModel)):
                continue
            if part in one.model_fields:
                below += _models_in(one.model_fields[str(part)].annotation)
            elif any(part in typing.get_args(f.annotation) for f in one.model_fields.values()):
                below = [one]  # tag of a union: keep the member that has it
                break
        here = below or here
    return here


def _models_in(annotation: Any) -> list[Any]:
    """All section classes within a type: through unions, tuples, Annotated."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if typing.get_origin(annotation) is not None or isinstance(annotation, types.UnionType):
        return [m for a in typing.get_args(annotation) for m in _models_in(a)]
    return []


__all__ = [
    "DEG", "DEG_H", "DEG_SQRT_H", "KMH", "MG", "Azimuth", "Checksum", "CorrelationTime", "Decay", "DistinctListOf",
    "Elevation", "Latitude", "ListOf", "LogTime", "Longitude", "NonNegative", "Pair", "PairOf", "ScanPeriod", "Section",
    "Sigma", "Signed", "Size", "Stretch", "Triple", "Utc", "Variance", "Version", "as_tuple", "hint", "one_or_list",
    "one_or_more", "reject", "validated", "whole",
]  # fmt: skip
