"""References for the methods used in results. `sources.bib` is the one bibliography, printed as text and as BibTeX.

Sources are those of `docs/theory` and the modules, with their data. Some titles are missing there (Singer, van Loan,
Anderson, Blanch, Gold, Storn, Satterthwaite). They are taken from citations of the same volume and year. Text has
family names only, BibTeX also initials.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files as packaged
from typing import Any

from navsim.results.result import Result, scenario_of

_PLACES = ("journal", "booktitle", "institution", "publisher", "howpublished")
"""Fields of BibTeX for where a source came out."""
_MOST_NAMED = 4
"""Authors that text names; of more, the first."""


@dataclass(frozen=True)
class Source:
    """A source."""

    key: str
    entry: str
    """Its entry of BibTeX."""
    fields: Mapping[str, str]
    """Fields of the entry, without brackets."""

    @property
    def authors(self) -> list[str]:
        """Family names of authors or editors, `others` for et al."""
        names = self.fields.get("author") or self.fields.get("editor")
        return [name.partition(",")[0] for name in names.split(" and ")] if names else []

    def text(self) -> str:
        """Entry of a list of references."""
        of = self.fields.get
        named = [name for name in self.authors if name != "others"]
        who = " et al." if len(named) < len(self.authors) or len(named) > _MOST_NAMED else ""
        who = (named[0] if who else " & ".join([", ".join(named[:-1]), named[-1]] if named[1:] else named)) + who
        volume = of("volume", "") + (f"({of('number')})" if of("number") else "")
        year = f"({of('year')})" if of("year") else ""
        edition = f"{of('edition')} edition" if of("edition") else ""
        place = ", ".join(part for part in (edition, *map(of, _PLACES)) if part)
        where = " ".join(part for part in (place, volume, year) if part)
        note = of("note", "")
        parts = (of("title"), where, note[:1].upper() + note[1:], f"DOI {of('doi')}" if of("doi") else "")
        return (f"{who}: " if who else "") + ". ".join(part for part in parts if part) + "."


def _read(entry: str) -> Source:
    """A source from its entry, which has a line for each field."""
    key = entry[entry.index("{") + 1 : entry.index(",")]
    fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", entry, re.MULTILINE))
    return Source(key, entry, {name: re.sub("[{}]", "", value) for name, value in fields.items()})


_FILE = packaged(__package__).joinpath("sources.bib")
SOURCES = {source.key: source for source in map(_read, _FILE.read_text(encoding="utf-8").rstrip().split("\n\n"))}
"""All sources by their keys."""


@dataclass(frozen=True)
class Method:
    """Something results rest on. page: of the documentation that works it out. sources: keys of `SOURCES`. used:
    whether a result of this scenario, and these root attributes, rests on it."""

    name: str
    page: str
    sources: tuple[str, ...]
    used: Callable[[Mapping[str, Any], Mapping[str, Any]], bool]


_FLYING = ("landing", "sweep", "optimize", "table2", "integrity-table", "live")
"""Kinds whose results are of landings."""


def of_landing(_: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    return root["kind"] in _FLYING


def _kind(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda _, root: root["kind"] in names


def filtered(scenario: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    """Whether a navigation filter is in it."""
    if root["kind"] in ("optimize", "sweep"):
        return root.get("method") not in ("dop", None)
    return root["kind"] in ("landing", "table2", "live", "replay")


def _filter(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: filtered(scenario, root) and at(scenario, "filter", "kind") in names


def _method(name: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda _, root: root.get("method") == name


def _integrity(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: of_landing(scenario, root) and at(scenario, "integrity", "method") in names


def _sky(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: of_landing(scenario, root) and at(scenario, "sky", "source") in names


def _named(nominal: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    """Method of a satellite system that flies only if it is named; nominal: source of its design."""

    def flies(scenario: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
        named = (f"nominal-{name}" for name in at(scenario, "sky", "systems") or ())
        return of_landing(scenario, root) and nominal in (at(scenario, "sky", "source"), *named)

    return flies


def at(scenario: Mapping[str, Any], *keys: str) -> Any:
    """A setting; None where the scenario has none there."""
    node: Any = scenario
    for key in keys:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node


_LANDING, _FILTER, _WATCH = "docs/theory/landing.md", "docs/theory/filter.md", "docs/theory/integrity.md"
_SIGNALS = "docs/theory/signals.md"
METHODS = (
    Method("the landing, its sensors and its signals", _LANDING, ("landing_paper", "groves2013"), of_landing),
    Method(
        "fixes by weighted least squares, dilution of precision",
        _LANDING,
        ("kaplan2017", "misra2006", "groves2013"),
        of_landing,
    ),
    Method("GLONASS satellites", _SIGNALS, ("glonass_icd",), _sky("nominal-glonass", "nominal", "navigation")),
    Method("GPS satellites", _SIGNALS, ("is_gps_200",), _sky("nominal-gps", "nominal", "navigation")),
    Method("Galileo satellites", "docs/real-signals.md", ("galileo_icd",), _named("nominal-galileo")),
    Method("BeiDou satellites", "docs/real-signals.md", ("beidou_icd",), _named("nominal-beidou")),
    Method("QZSS satellites", "docs/real-signals.md", ("qzss_is",), _named("nominal-qzss")),
    Method(
        "satellites by almanacs or two-line elements",
        "docs/real-signals.md",
        ("glonass_icd", "is_gps_200", "vallado2006"),
        _sky("almanac"),
    ),
    Method("precise orbits", "docs/real-signals.md", ("schenewerk2003",), _sky("orbits")),
    Method(
        "ionosphere and troposphere",
        _SIGNALS,
        ("is_gps_200", "saastamoinen1972"),
        lambda scenario, root: (
            of_landing(scenario, root)
            and any(at(scenario, "signals", part) is not None for part in ("ionosphere", "troposphere"))
        ),
    ),
    Method(
        "inertial sensors and their errors",
        "docs/imu.md",
        ("ieee952", "titterton2004"),
        lambda scenario, root: filtered(scenario, root) and root["kind"] != "replay",
    ),
    Method(
        "ground stations: angles, and limits of presets",
        "docs/theory/ground-stations.md",
        ("annex10", "cfr171"),
        lambda scenario, root: (
            of_landing(scenario, root)
            and any(at(scenario, name) for name in ("azimuth_station", "elevation_station", "dme"))
        ),
    ),
    Method("strapdown mechanisation", _FILTER, ("savage1998", "groves2013"), filtered),
    Method("error model and update of the navigation filter", _FILTER, ("groves2013", "barfoot2017"), filtered),
    Method("filter on the two-frames group", _FILTER, ("barrau2023", "fornasier2023"), _filter("tfg", "gaussian-sum")),
    Method(
        "reset of the covariance after a correction",
        _FILTER,
        ("mueller2017",),
        _filter("eskf", "first-estimates", "observability-constrained", "left-invariant", "tfg", "gaussian-sum", "rts"),
    ),
    Method(
        "error-state filter with first-estimates Jacobians",
        "docs/theory/first-estimates.md",
        ("huang2010", "li2013"),
        _filter("first-estimates"),
    ),
    Method(
        "observability-constrained error-state filter",
        "docs/theory/first-estimates.md",
        ("huang2010", "hesch2014"),
        _filter("observability-constrained"),
    ),
    Method("left-invariant filter", _FILTER, ("barrau2017",), _filter("left-invariant")),
    Method("Gaussian sum", "docs/theory/gaussian-sum.md", ("alspach1972", "runnalls2007"), _filter("gaussian-sum")),
    Method("Rauch-Tung-Striebel smoother", "docs/filter.md", ("rauch1965",), _filter("rts")),
    Method("batch smoother", "docs/filter.md", ("bell1994", "rauch1965"), _filter("map")),
    Method(
        "consistency: each state's sigma, NEES, NIS and their bands",
        "docs/theory/consistency.md",
        ("barshalom2001", "satterthwaite1946", "worsley1982"),
        lambda scenario, root: filtered(scenario, root) or root["kind"] in ("mls-elevation", "azimuth-tracking"),
    ),
    Method(
        "linear covariance analysis and error budget", "docs/covariance.md", ("maybeck1979",), _method("covariance")
    ),
    Method(
        "rare events by importance sampling",
        "docs/rare-events.md",
        ("bryson1975", "owen2000", "veach1995", "bucklew2004", "rubinstein2004"),
        _method("rare"),
    ),
    Method("fixes watched by their residuals", _WATCH, ("brown1994", "walter1995"), _integrity("chi2")),
    Method("fixes watched by solution separation", _WATCH, ("blanch2015", "araim2017"), _integrity("mhss")),
    Method(
        "filters watched by solution separation",
        _WATCH,
        ("brenner1996", "young2003", "blanch2015", "araim2017"),
        _integrity("filter"),
    ),
    Method(
        "protection levels of augmentation systems, alert limits",
        _WATCH,
        ("do229", "annex10"),
        lambda scenario, root: of_landing(scenario, root) and at(scenario, "integrity") is not None,
    ),
    Method(
        "interference",
        "docs/theory/interference.md",
        ("kaplan2017", "betz2001ntm", "betz2001", "itu526", "gold1967", "elrod1996"),
        lambda scenario, root: of_landing(scenario, root) and bool(at(scenario, "interference")),
    ),
    Method("search for placements", "docs/placement.md", ("storn1997", "deb2000", "jones1998"), _kind("optimize")),
    Method("alignment in flight", "docs/replay-method.md", ("wu2013", "groves2013"), _kind("replay")),
    Method("tuning by likelihood", "docs/replay-method.md", ("mehra1970", "harvey1989"), _kind("replay", "ranges")),
    Method(
        "elevation on an MLS approach",
        "docs/theory/elevation.md",
        ("elevation_paper", "barshalom2001", "singer1970", "vanloan1978", "anderson1978"),
        _kind("mls-elevation"),
    ),
    Method(
        "tracking with onboard data",
        "docs/theory/atc.md",
        ("atc_paper", "singer1970", "barshalom2001"),
        _kind("atc-tracking"),
    ),
    Method(
        "azimuth from load factors",
        "docs/theory/azimuth.md",
        ("azimuth_paper", "singer1970"),
        _kind("azimuth-tracking"),
    ),
    Method(
        "axes of the landing circuit",
        "docs/theory/circuit.md",
        ("gost20058",),
        _kind("atc-tracking", "azimuth-tracking"),
    ),
)
"""Methods that results use, in the order of a landing."""


def methods_of(results: Iterable[Result]) -> list[Method]:
    """Methods that these results use, from their scenarios and root attributes. Raises KeyError for a result
    without."""
    # methods of the varied scenario; values on its axes may use more
    known = [(scenario_of(result), result.attributes) for result in results]
    return [method for method in METHODS if any(method.used(scenario, root) for scenario, root in known)]


def sources_of(methods: Sequence[Method]) -> list[Source]:
    """The sources of methods, each once, in the order in which they are named."""
    return [SOURCES[key] for key in dict.fromkeys(key for method in methods for key in method.sources)]


def cited(methods: Sequence[Method]) -> str:
    """Methods with the numbers of their sources, and the numbered sources, as text."""
    sources = sources_of(methods)
    number = {source.key: i for i, source in enumerate(sources, 1)}
    lines = [f"{method.name} {numbered(method, number)}; {method.page}" for method in methods]
    return "\n".join([*lines, "", *(f"[{i}] {source.text()}" for i, source in enumerate(sources, 1))])


def numbered(method: Method, number: Mapping[str, int]) -> str:
    """The numbers of a method's sources in brackets."""
    return "".join(f"[{number[key]}]" for key in method.sources)


def bibtex(methods: Sequence[Method]) -> str:
    """The sources of methods as a file of BibTeX."""
    return "\n\n".join(source.entry for source in sources_of(methods)) + "\n"
