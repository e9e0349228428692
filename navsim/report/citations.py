"""References for the methods used in results: the one bibliography, as text and as BibTeX.

Sources are those of `docs/theory` and the modules, with their data. Some titles are missing there (Singer, van Loan,
Anderson, Blanch, Gold, Storn, Satterthwaite). They are taken from citations of the same volume and year. Names are
family names only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from navsim.results.result import Result

BOOK, ARTICLE, TALK, REPORT, MISC = "book", "article", "inproceedings", "techreport", "misc"
"""BibTeX type of a source."""
_PLACE = {ARTICLE: "journal", TALK: "booktitle", REPORT: "institution", BOOK: "edition", MISC: "howpublished"}
"""The field of BibTeX that holds where a source of a kind came out."""


@dataclass(frozen=True)
class Source:
    """A source."""

    key: str
    kind: str
    authors: tuple[str, ...]
    """Family names, `others` for et al."""
    title: str
    place: str = ""
    """Journal, conference, institution or edition."""
    volume: str = ""
    """Volume, and number in brackets."""
    year: int = 0
    """0 if unknown, or that of the issue in force."""
    note: str = ""
    """Identifiers."""

    def text(self) -> str:
        """Entry of a list of references."""
        named = [name for name in self.authors if name != "others"]
        who = " et al." if len(named) < len(self.authors) else ""
        who = (named[0] if who else " & ".join([", ".join(named[:-1]), named[-1]] if named[1:] else named)) + who
        where = " ".join(part for part in (self.place, self.volume) if part)
        year = f"({self.year})" if self.year else ""
        note = self.note[:1].upper() + self.note[1:]
        parts = (self.title, " ".join(part for part in (where, year) if part), note)
        return (f"{who}: " if who else "") + ". ".join(part for part in parts if part) + "."

    def bibtex(self) -> str:
        """BibTeX entry, in UTF-8."""
        volume, _, number = self.volume.rstrip(")").partition("(")
        fields = {
            "author": " and ".join(name if name == "others" else f"{{{name}}}" for name in self.authors),
            "title": f"{{{self.title}}}",
            _PLACE[self.kind]: self.place,
            "volume": volume.strip(),
            "number": number,
            "year": str(self.year) if self.year else "",
            "note": self.note,
        }
        lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value and value != "{}"]
        return "\n".join([f"@{self.kind}{{{self.key},", *lines, "}"])


_JGCD = "Journal of Guidance, Control, and Dynamics"
_TAES = "IEEE Transactions on Aerospace and Electronic Systems"
_IJRR = "The International Journal of Robotics Research"
_TAC = "IEEE Transactions on Automatic Control"

SOURCES = {
    source.key: source
    for source in (
        Source(
            "landing_paper",
            MISC,
            (),
            "A navigation and landing complex of a small UAV that uses pseudolites",
            note='a Russian study ("the paper"); authors and place are not in the text at hand, the title is ours',
        ),
        Source(
            "groves2013",
            BOOK,
            ("Groves",),
            "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
            "2nd ed.",
            "",
            2013,
        ),
        Source("kaplan2017", BOOK, ("Kaplan", "Hegarty"), "Understanding GPS/GNSS", "3rd ed.", "", 2017),
        Source("misra2006", BOOK, ("Misra", "Enge"), "Global Positioning System", "2nd ed.", "", 2006),
        Source(
            "titterton2004",
            BOOK,
            ("Titterton", "Weston"),
            "Strapdown Inertial Navigation Technology",
            "2nd ed.",
            "",
            2004,
        ),
        Source(
            "savage1998",
            ARTICLE,
            ("Savage",),
            "Strapdown inertial navigation integration algorithm design, parts 1 and 2",
            _JGCD,
            "21",
            1998,
        ),
        Source("is_gps_200", MISC, (), "IS-GPS-200", note="interface specification"),
        Source("galileo_icd", MISC, (), "Galileo OS SIS ICD", note="interface specification"),
        Source("beidou_icd", MISC, (), "BeiDou SIS ICD, open service signal B1I", note="interface specification"),
        Source("qzss_is", MISC, (), "IS-QZSS-PNT", note="interface specification"),
        Source(
            "glonass_icd", MISC, (), "GLONASS ICD, navigational radiosignal in bands L1, L2", "edition 5.1", "", 2008
        ),
        Source(
            "vallado2006", TALK, ("Vallado", "others"), "Revisiting Spacetrack Report 3", "AIAA 2006-6753", "", 2006
        ),
        Source(
            "schenewerk2003",
            ARTICLE,
            ("Schenewerk",),
            "A brief review of basic GPS orbit interpolation strategies",
            "GPS Solutions",
            "6",
            2003,
        ),
        Source(
            "saastamoinen1972",
            ARTICLE,
            ("Saastamoinen",),
            "Contributions to the theory of atmospheric refraction",
            "Bulletin géodésique",
            "105-107",
            1972,
        ),
        Source("ieee952", MISC, (), "IEEE Std 952-1997", "annex C", "", 1997),
        Source("barfoot2017", BOOK, ("Barfoot",), "State Estimation for Robotics", "", "", 2017),
        Source(
            "mueller2017",
            ARTICLE,
            ("Mueller", "Hehn", "D'Andrea"),
            "Covariance correction step for Kalman filtering with an attitude",
            _JGCD,
            "40",
            2017,
        ),
        Source(
            "barrau2017",
            ARTICLE,
            ("Barrau", "Bonnabel"),
            "The invariant extended Kalman filter as a stable observer",
            _TAC,
            "62",
            2017,
        ),
        Source(
            "huang2010",
            ARTICLE,
            ("Huang", "Mourikis", "Roumeliotis"),
            "Observability-based rules for designing consistent EKF SLAM estimators",
            _IJRR,
            "29",
            2010,
        ),
        Source(
            "li2013",
            ARTICLE,
            ("Li", "Mourikis"),
            "High-precision, consistent EKF-based visual-inertial odometry",
            _IJRR,
            "32",
            2013,
        ),
        Source(
            "hesch2014",
            ARTICLE,
            ("Hesch", "Kottas", "Bowman", "Roumeliotis"),
            "Consistency analysis and improvement of vision-aided inertial navigation",
            "IEEE Transactions on Robotics",
            "30",
            2014,
        ),
        Source("barrau2023", ARTICLE, ("Barrau", "Bonnabel"), "The geometry of navigation problems", _TAC, "68", 2023),
        Source(
            "fornasier2023",
            MISC,
            ("Fornasier", "others"),
            "Equivariant symmetries for inertial navigation systems",
            "arXiv 2309.03765",
        ),
        Source(
            "alspach1972",
            ARTICLE,
            ("Alspach", "Sorenson"),
            "Nonlinear Bayesian estimation using Gaussian sum approximations",
            _TAC,
            "17",
            1972,
        ),
        Source(
            "runnalls2007",
            ARTICLE,
            ("Runnalls",),
            "Kullback-Leibler approach to Gaussian mixture reduction",
            _TAES,
            "43",
            2007,
        ),
        Source(
            "rauch1965",
            ARTICLE,
            ("Rauch", "Tung", "Striebel"),
            "Maximum likelihood estimates of linear dynamic systems",
            "AIAA Journal",
            "3",
            1965,
        ),
        Source(
            "bell1994",
            ARTICLE,
            ("Bell",),
            "The iterated Kalman smoother as a Gauss-Newton method",
            "SIAM Journal on Optimization",
            "4",
            1994,
        ),
        Source(
            "barshalom2001",
            BOOK,
            ("Bar-Shalom", "Li", "Kirubarajan"),
            "Estimation with Applications to Tracking and Navigation",
            "",
            "",
            2001,
        ),
        Source(
            "satterthwaite1946",
            ARTICLE,
            ("Satterthwaite",),
            "An approximate distribution of estimates of variance components",
            "Biometrics Bulletin",
            "2",
            1946,
        ),
        Source(
            "worsley1982",
            ARTICLE,
            ("Worsley",),
            "An improved Bonferroni inequality and applications",
            "Biometrika",
            "69",
            1982,
        ),
        Source("maybeck1979", BOOK, ("Maybeck",), "Stochastic Models, Estimation, and Control, vol. 1", "", "", 1979),
        Source("bryson1975", BOOK, ("Bryson", "Ho"), "Applied Optimal Control", "", "", 1975),
        Source(
            "owen2000",
            ARTICLE,
            ("Owen", "Zhou"),
            "Safe and effective importance sampling",
            "Journal of the American Statistical Association",
            "95",
            2000,
        ),
        Source(
            "veach1995",
            TALK,
            ("Veach", "Guibas"),
            "Optimally combining sampling techniques for Monte Carlo rendering",
            "SIGGRAPH",
            "",
            1995,
        ),
        Source("bucklew2004", BOOK, ("Bucklew",), "Introduction to Rare Event Simulation", "", "", 2004),
        Source(
            "brown1994",
            MISC,
            ("Brown", "Chin"),
            "GPS RAIM: Calculation of Thresholds and Protection Radius Using Chi-Square Methods",
            "",
            "",
            1994,
        ),
        Source("walter1995", TALK, ("Walter", "Enge"), "Weighted RAIM for Precision Approach", "ION GPS-95", "", 1995),
        Source(
            "blanch2015",
            ARTICLE,
            ("Blanch", "others"),
            "Baseline Advanced RAIM User Algorithm and Possible Improvements",
            _TAES,
            "51(1)",
            2015,
        ),
        Source(
            "brenner1996",
            ARTICLE,
            ("Brenner",),
            "Integrated GPS/Inertial Fault Detection Availability",
            "NAVIGATION",
            "43(2)",
            1996,
        ),
        Source(
            "young2003",
            ARTICLE,
            ("Young", "McGraw"),
            "Fault Detection and Exclusion Using Normalized Solution Separation and Residual Monitoring Methods",
            "NAVIGATION",
            "50(3)",
            2003,
        ),
        Source(
            "araim2017",
            REPORT,
            (),
            "Reference Airborne Algorithm Description Document, v3.0",
            "WG-C ARAIM Technical Subgroup",
            "",
            2017,
        ),
        Source("do229", MISC, (), "RTCA DO-229, appendix J"),
        Source("annex10", MISC, (), "ICAO Annex 10, volume I"),
        Source(
            "betz2001ntm",
            TALK,
            ("Betz",),
            "Effect of Partial-Band Interference on Receiver Estimation of C/N0",
            "ION NTM",
            "",
            2001,
        ),
        Source(
            "betz2001",
            ARTICLE,
            ("Betz",),
            "Binary Offset Carrier Modulations for Radionavigation",
            "NAVIGATION",
            "48(4)",
            2001,
        ),
        Source("itu526", MISC, (), "Recommendation ITU-R P.526"),
        Source(
            "gold1967",
            ARTICLE,
            ("Gold",),
            "Optimal binary sequences for spread spectrum multiplexing",
            "IEEE Transactions on Information Theory",
            "13(4)",
            1967,
        ),
        Source(
            "elrod1996",
            BOOK,
            ("Elrod", "Van Dierendonck"),
            "Global Positioning System: Theory and Applications II",
            "",
            "",
            1996,
            "their chapter on pseudolites",
        ),
        Source(
            "wu2013",
            ARTICLE,
            ("Wu", "Pan"),
            "Velocity/position integration formula part I: application to in-flight coarse alignment",
            _TAES,
            "49",
            2013,
        ),
        Source(
            "mehra1970",
            ARTICLE,
            ("Mehra",),
            "On the identification of variances and adaptive Kalman filtering",
            _TAC,
            "15",
            1970,
        ),
        Source(
            "harvey1989",
            BOOK,
            ("Harvey",),
            "Forecasting, structural time series models and the Kalman filter",
            "",
            "",
            1989,
        ),
        Source(
            "storn1997",
            ARTICLE,
            ("Storn", "Price"),
            "Differential evolution: a simple and efficient heuristic for global optimization over continuous spaces",
            "Journal of Global Optimization",
            "11",
            1997,
        ),
        Source(
            "deb2000",
            ARTICLE,
            ("Deb",),
            "An efficient constraint handling method for genetic algorithms",
            "Computer Methods in Applied Mechanics and Engineering",
            "186",
            2000,
        ),
        Source(
            "jones1998",
            ARTICLE,
            ("Jones", "Schonlau", "Welch"),
            "Efficient global optimization of expensive black-box functions",
            "Journal of Global Optimization",
            "13",
            1998,
        ),
        Source(
            "singer1970",
            ARTICLE,
            ("Singer",),
            "Estimating optimal tracking filter performance for manned maneuvering targets",
            _TAES,
            "6(4)",
            1970,
        ),
        Source(
            "vanloan1978",
            ARTICLE,
            ("van Loan",),
            "Computing integrals involving the matrix exponential",
            _TAC,
            "23(3)",
            1978,
        ),
        Source(
            "anderson1978",
            ARTICLE,
            ("Anderson",),
            "Second-order convergent algorithms for the steady-state Riccati equation",
            "International Journal of Control",
            "28(2)",
            1978,
        ),
        Source(
            "elevation_paper",
            MISC,
            (),
            "Оптимальне оцінювання кутових координат повітряного судна у процесі заходу на посадку",
            note="optimal estimation of the angular coordinates of an aircraft on approach, in Ukrainian",
        ),
        Source(
            "atc_paper",
            MISC,
            (),
            "Models of state and observation for automated air traffic control",
            note="a Russian paper; its formulas are lost in the text at hand, the title is ours",
        ),
        Source(
            "azimuth_paper",
            ARTICLE,
            (),
            "Azimuth from load factors",
            "Научный вестник НГТУ",
            "78(1)",
            2020,
            "pages 135-146, DOI 10.17212/1814-1196-2020-1-135-146; the title is ours",
        ),
        Source("gost20058", MISC, (), "GOST 20058-80", note="normal Earth axes"),
    )
}
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


def _landing(_: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    return root["kind"] in _FLYING


def _kind(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda _, root: root["kind"] in names


def _filtered(scenario: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    """Whether a navigation filter is in it."""
    if root["kind"] in ("optimize", "sweep"):
        return root.get("method") not in ("dop", None)
    return root["kind"] in ("landing", "table2", "live", "replay")


def _filter(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: _filtered(scenario, root) and _at(scenario, "filter", "kind") in names


def _method(name: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda _, root: root.get("method") == name


def _integrity(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: _landing(scenario, root) and _at(scenario, "integrity", "method") in names


def _sky(*names: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda scenario, root: _landing(scenario, root) and _at(scenario, "sky", "source") in names


def _named(nominal: str) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    """Method of a satellite system that flies only if it is named; nominal: source of its design."""

    def flies(scenario: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
        named = (f"nominal-{name}" for name in _at(scenario, "sky", "systems") or ())
        return _landing(scenario, root) and nominal in (_at(scenario, "sky", "source"), *named)

    return flies


def _at(scenario: Mapping[str, Any], *keys: str) -> Any:
    """A setting; None where the scenario has none there."""
    node: Any = scenario
    for key in keys:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node


_LANDING, _FILTER, _WATCH = "docs/theory/landing.md", "docs/theory/filter.md", "docs/theory/integrity.md"
_SIGNALS = "docs/theory/signals.md"
METHODS = (
    Method("the landing, its sensors and its signals", _LANDING, ("landing_paper", "groves2013"), _landing),
    Method(
        "fixes by weighted least squares, dilution of precision",
        _LANDING,
        ("kaplan2017", "misra2006", "groves2013"),
        _landing,
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
            _landing(scenario, root)
            and any(_at(scenario, "signals", part) is not None for part in ("ionosphere", "troposphere"))
        ),
    ),
    Method(
        "inertial sensors and their errors",
        "docs/imu.md",
        ("ieee952", "titterton2004"),
        lambda scenario, root: _filtered(scenario, root) and root["kind"] != "replay",
    ),
    Method("strapdown mechanisation", _FILTER, ("savage1998", "groves2013"), _filtered),
    Method("error model and update of the navigation filter", _FILTER, ("groves2013", "barfoot2017"), _filtered),
    Method("filter on the two-frames group", _FILTER, ("barrau2023", "fornasier2023"), _filter("tfg", "gaussian-sum")),
    Method(
        "error-state filter with reset of its covariance",
        _FILTER,
        ("mueller2017",),
        _filter("eskf", "first-estimates", "observability-constrained"),
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
    Method("smoother", "docs/filter.md", ("rauch1965",), _filter("rts")),
    Method("batch smoother", "docs/filter.md", ("bell1994", "rauch1965"), _filter("map")),
    Method(
        "consistency: each state's sigma, NEES, NIS and their bands",
        "docs/theory/consistency.md",
        ("barshalom2001", "satterthwaite1946", "worsley1982"),
        lambda scenario, root: _filtered(scenario, root) or root["kind"] in ("mls-elevation", "azimuth-tracking"),
    ),
    Method(
        "linear covariance analysis and error budget", "docs/covariance.md", ("maybeck1979",), _method("covariance")
    ),
    Method(
        "rare events by importance sampling",
        "docs/rare-events.md",
        ("bryson1975", "owen2000", "veach1995", "bucklew2004"),
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
        lambda scenario, root: _landing(scenario, root) and _at(scenario, "integrity") is not None,
    ),
    Method(
        "interference",
        "docs/theory/interference.md",
        ("kaplan2017", "betz2001ntm", "betz2001", "itu526", "gold1967", "elrod1996"),
        lambda scenario, root: _landing(scenario, root) and bool(_at(scenario, "interference")),
    ),
    Method("search for placements", "docs/placement.md", ("storn1997", "deb2000", "jones1998"), _kind("optimize")),
    Method("alignment in flight", "docs/replay.md", ("wu2013", "groves2013"), _kind("replay")),
    Method("tuning by likelihood", "docs/replay.md", ("mehra1970", "harvey1989"), _kind("replay")),
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
    import yaml

    # methods of the varied scenario; values on its axes may use more
    known = [(yaml.safe_load(str(result.attributes["scenario"])), result.attributes) for result in results]
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
    return "\n\n".join(source.bibtex() for source in sources_of(methods)) + "\n"
