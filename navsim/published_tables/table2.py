"""The paper's Tables 1 and 2, published and computed, and the paper's claims.

A cell of PDOP, HDOP, VDOP, SKO is the mean over the fix epochs from the start of the glide to touchdown. The horizontal
estimation error is the root mean square over runs and over 20 s to touchdown. The paper states neither, nor its sky:
`CALIBRATIONS` are skies that reproduce it (`scripts/calibrate_table2.py`).

Source: `docs/theory/landing.md`, sections 1, 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.environment.sources import environment, glide_epochs
from navsim.geodesy.earth import ecef_from_llh
from navsim.landing.study import Case, findings, fly_all, prepare
from navsim.results.builder import ResultBuilder
from navsim.results.findings import kept
from navsim.results.result import Result
from navsim.results.schema import TABLE2
from navsim.runner.attributes import root_attributes
from navsim.runner.batches import Ensemble
from navsim.runner.executor import Executor
from navsim.runner.findings import among, marks
from navsim.runner.statistics import rms_interval
from navsim.scenario.load import read
from navsim.scenario_files.shipped import path
from navsim.simulation.placement_geometry import Geometry, glide_geometry


@dataclass(frozen=True)
class TableCase:
    """One case: number of pseudolites, S and L1 of Table 1 (m), and the values of Table 2, None if missing.

    dops: PDOP, HDOP, VDOP. sko: horizontal, vertical, m. error: horizontal estimation error, m.
    """

    pseudolites: int
    s: float | None
    l1: float | None
    dops: tuple[float, float, float] | None
    sko: tuple[float, float] | None
    error: float | None

    def assignments(self) -> list[str]:
        """The case as settings of a landing scenario."""
        if self.pseudolites == 0:
            return ["pseudolites.count=0"]
        return [f"pseudolites.count={self.pseudolites}", f"pseudolites.s_m={self.s:g}", f"pseudolites.l1_m={self.l1:g}"]


ROWS = (
    TableCase(0, None, None, (3.67, 1.33, 3.42), (5.74, 14.72), 1.004),
    TableCase(1, 50.0, 4000.0, (2.98, 1.08, 2.77), (4.63, 11.88), None),
    TableCase(1, 200.0, 5000.0, (2.86, 1.03, 2.66), (4.52, 11.61), 0.9798),
    TableCase(1, 500.0, 5000.0, None, None, None),
    TableCase(1, 1000.0, 5000.0, (2.84, 1.03, 2.64), (4.5, 11.54), None),
    TableCase(2, 50.0, 4000.0, (2.52, 0.91, 2.35), (3.92, 10.06), None),
    TableCase(2, 200.0, 5000.0, (2.38, 0.86, 2.22), (3.78, 9.69), None),
    TableCase(2, 1000.0, 5000.0, (2.2, 0.8, 2.05), (3.61, 9.27), 0.8573),
)
"""Tables 1 and 2 of the paper, as `docs/theory/landing.md`, sections 1, 2 give them."""
PUBLISHED = tuple(i for i, row in enumerate(ROWS) if row.dops is not None)
PUBLISHED_DOPS = np.array([ROWS[i].dops for i in PUBLISHED])
PUBLISHED_SKO = np.array([ROWS[i].sko for i in PUBLISHED])


@dataclass(frozen=True)
class Calibration:
    """A sky found for the table: its scenario's name (and that of its files), letter, number of fitted parameters."""

    name: str
    letter: str
    parameters: int
    meaning: str
    weighted: bool = False


CALIBRATIONS = (
    Calibration("table2", "b", 17, "all rows, unit weights, 7 free directions, row 1 held to 0.01"),
    Calibration("table2_row1", "a", 5, "row 1 alone, a real sky; the other rows are predictions"),
    Calibration("table2_almanac", "b'", 8, "all rows, unit weights, a real sky, row 1 held to 0.01"),
    Calibration("table2_weighted", "c", 13, "all rows, weighted, 5 free directions", weighted=True),
)
"""The first is the default. Parameters count the noise of range rates, fitted to the first estimation error."""

CURVES = (0, 2, 6)
"""Rows drawn over the approach: no pseudolite, one and two at 200/5000."""


@dataclass(frozen=True)
class Computed:
    """Results of one calibration; rows as in `ROWS`."""

    dops: np.ndarray
    """(8, 3 PDOP HDOP VDOP, 3 mean smallest largest), unit weights."""
    weighted: np.ndarray
    """(8, 3, 3) sigmas of the fix over that of a satellite's range."""
    sko: np.ndarray
    """(8, 2) m."""
    error: np.ndarray
    """(8, 3) m, value, low, high."""
    time: np.ndarray
    """(t,) s."""
    pdop: np.ndarray
    """(3, t) of `CURVES`."""
    rms: np.ndarray
    """(3, t) horizontal error of `CURVES`, m."""
    found: np.ndarray
    """(8, name) `findings.marks`."""

    def compared(self, calibration: Calibration) -> np.ndarray:
        """DOPs (8, 3) for comparison with the published ones."""
        return (self.weighted if calibration.weighted else self.dops)[:, :, 0]


def geometry(calibration: Calibration) -> tuple[Geometry, list[np.ndarray], float]:
    """The glide under a calibration's sky, the sites (k, 3) of every row, ECEF m, and a satellite's sigma, m."""
    scenario, document = read(path(calibration.name), ROWS[0].assignments())
    sources, scenario, _ = environment(scenario, document)
    trajectory = scenario.trajectory()
    utc = np.array([scenario.epoch.timestamp()])
    here = glide_geometry(trajectory, sources, utc, *glide_epochs(scenario, trajectory))
    sites = []
    for row in ROWS:
        placed, _ = read(path(calibration.name), row.assignments())
        sites.append(ecef_from_llh(placed.pseudolite_positions(trajectory.frame)))
    return here, sites, scenario.signals.range_sigma_m


def compute(
    calibration: Calibration, seed: int, runs: int, executor: Executor, done: Callable[[int], None] = lambda _: None
) -> Computed:
    """All rows under one calibration; `done(n)` receives the number of finished rows."""
    here, sites, sigma = geometry(calibration)
    dops, sigmas = (
        np.stack([statistics(site[None])[0][:, :, 0] for site in sites]) for statistics in (here.dops, here.fix_sigmas)
    )
    error, curves, found = np.empty((len(ROWS), 3)), [], []
    for i, row in enumerate(ROWS):
        case = prepare(*read(path(calibration.name), row.assignments()))
        drawn = i in CURVES
        ensemble = fly_all(case, seed, 0, runs, executor, keep="errors" if drawn else "none")
        found.append(marks(f.name for f in findings(case, ensemble)))
        error[i] = rms_interval(ensemble.per_run("position_square")[:, :2])
        if drawn:
            curves.append(_curve(case, ensemble))
        done(i + 1)
    return Computed(
        dops,
        sigmas / sigma,
        sigmas[:, 1:, 0],
        error,
        case.shared.signals.time,
        np.array([c[0] for c in curves]),
        np.array([c[1] for c in curves]),
        np.array(found),
    )


def compute_all(seed: int, runs: int, executor: Executor, done: Callable[[int], None]) -> dict[Calibration, Computed]:
    """All calibrations, the default one first; `done(n)` receives the number of finished rows of all."""
    found: dict[Calibration, Computed] = {}
    for calibration in CALIBRATIONS:
        before = len(found) * len(ROWS)

        def report(rows: int, before: int = before) -> None:
            done(before + rows)

        found[calibration] = compute(calibration, seed, runs, executor, report)
    return found


def _curve(case: Case, ensemble: Ensemble) -> tuple[np.ndarray, np.ndarray]:
    """PDOP and horizontal RMS error (m) at the fix epochs."""
    square = np.zeros(case.shared.filter_time.size)
    for block in ensemble.blocks("error"):
        square += np.sum(block[:, :, :2] ** 2, axis=(0, 2))
    return case.shared.dop[:, 1], np.sqrt(square[1:] / ensemble.runs)


# --- the paper's claims


@dataclass(frozen=True)
class Claim:
    """A claim of the paper: statement, computed value, whether it holds, and explanation."""

    name: str
    says: str
    computed: str
    holds: bool
    reason: str


POINTS = 0.02
"""Largest difference of a reproduced percentage from the printed one, points."""


def claims(dops: np.ndarray, sko: np.ndarray, error: np.ndarray) -> list[Claim]:
    """C1-C4 for PDOP, HDOP, VDOP (8, 3), SKO (8, 2) and estimation error (8, 3 value, low, high)."""
    pdop = dops[:, 0]
    one, two = 1.0 - pdop[1] / pdop[0], 1.0 - pdop[5] / pdop[0]
    ones, twos = [1, 2, 4], [5, 6, 7]
    sko_one, sko_two = (float(1.0 - np.mean(sko[rows] / sko[0])) for rows in (ones, twos))
    best = min(twos, key=lambda i: pdop[i])
    falls = bool(error[0, 0] > error[2, 0] > error[7, 0])
    apart = bool(error[0, 1] > error[2, 2] and error[2, 1] > error[7, 2])
    return [
        Claim(
            "C1",
            "PDOP falls 19 % with one pseudolite at 50/4000 and 32 % with two",
            f"{100 * one:.1f} % and {100 * two:.1f} %",
            bool(abs(one - 0.19) <= POINTS and abs(two - 0.32) <= POINTS),
            "with unit weights rows 1, 2 and 5 cannot come from one geometry: two pseudolites 100 m apart bring hardly "
            "more than one counted twice, so whoever meets the 32 % overshoots the 19 %",
        ),
        Claim(
            "C2",
            "SKO falls 20 % with one pseudolite and 30 % with two, on average",
            f"{100 * sko_one:.1f} % and {100 * sko_two:.1f} %",
            bool(abs(sko_one - 0.20) <= POINTS and abs(sko_two - 0.30) <= POINTS),
            "the table's own averages are 20.7 and 34.3 %, so the second half fails by the paper's own figures",
        ),
        Claim(
            "C3",
            "of the tabled pairs of pseudolites the one at 1000/5000 is best",
            f"best PDOP {pdop[best]:.3f} at {ROWS[best].s:g}/{ROWS[best].l1:g}",
            best == 7,
            "the further apart seen from the aircraft, the better",
        ),
        Claim(
            "C4",
            "the horizontal estimation error falls from none (1.004 m) to one at 200/5000 (0.98 m) to two at 1000/5000",
            f"{error[0, 0]:.3f}, {error[2, 0]:.3f}, {error[7, 0]:.3f} m"
            + ("" if apart else " (95 % intervals overlap)"),
            falls,
            "the direction; by how much it falls is reported in the table",
        ),
    ]


def two_pseudolites_bound(pdop_none: float, pdop_one: float, change: float) -> float:
    """Least PDOP with a second pseudolite on the clock of the first, for any sky.

    change: sigma of the difference of the two lines of sight times the position without pseudolites, in sigmas of a
    pseudolite's range; 0 for pseudolites at one position (`docs/theory/landing.md`, eq. (4)).
    """
    gain = (pdop_none / pdop_one) ** 2 - 1.0
    return float(pdop_none / np.sqrt(1.0 + gain + (np.sqrt(gain) + change) ** 2))


APART = (0.025, 0.0005)
"""Largest horizontal and vertical change between the lines of sight to both pseudolites of row 5 on the glide, rad."""


def published_contradiction() -> tuple[float, float]:
    """Least PDOP of row 5 that rows 1 and 2 allow, with all rounding in its favour, and largest unrounded value of row
    5."""
    none, one, two = (PUBLISHED_DOPS[i] for i in (0, 1, 4))
    change = float(np.dot(APART, none[1:] + 0.005))
    return two_pseudolites_bound(none[0] + 0.005, one[0] - 0.005, change), two[0] + 0.005


def relative_difference(computed: np.ndarray, published: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest relative difference from the published cells."""
    relative = computed[list(PUBLISHED)] / published - 1.0
    return float(np.sqrt(np.mean(relative**2))), float(np.max(np.abs(relative)))


def result(found: dict[Calibration, Computed], seed: int, runs: int) -> Result:
    """All calibrations as one result of kind table2."""
    draft = ResultBuilder(TABLE2)
    draft["/calibration"] = draft["/claims/calibration"] = np.array([c.name for c in found], dtype=object)
    draft["/case"] = np.arange(1, len(ROWS) + 1)
    nan = float("nan")
    draft["/table/pseudolites"] = np.array([r.pseudolites for r in ROWS])
    draft["/table/s"] = np.array([nan if r.s is None else r.s for r in ROWS])
    draft["/table/l1"] = np.array([nan if r.l1 is None else r.l1 for r in ROWS])
    for i, name in enumerate(("pdop", "hdop", "vdop")):
        draft[f"/published/{name}"] = np.array([nan if r.dops is None else r.dops[i] for r in ROWS])
        draft[f"/table/{name}"] = np.stack([c.dops[:, i] for c in found.values()])
        draft[f"/weighted/{name}"] = np.stack([c.weighted[:, i] for c in found.values()])
    for i, name in enumerate(("rms_horizontal", "rms_vertical")):
        draft[f"/published/{name}"] = np.array([nan if r.sko is None else r.sko[i] for r in ROWS])
        draft[f"/table/{name}"] = np.stack([c.sko[:, i] for c in found.values()])
    draft["/published/error_horizontal"] = np.array([nan if r.error is None else r.error for r in ROWS])
    draft.put("/table/error_horizontal", np.stack([c.error for c in found.values()]), {"runs": runs})
    draft["/fit/parameters"] = np.array([c.parameters for c in found])
    draft["/fit/id"] = np.array([c.letter for c in found], dtype=object)
    draft["/fit/meaning"] = np.array([c.meaning for c in found], dtype=object)
    draft["/fit/weighted"] = np.array([c.weighted for c in found]).astype(np.int8)
    fits = np.array(
        [
            [*relative_difference(c.compared(k), PUBLISHED_DOPS), *relative_difference(c.sko, PUBLISHED_SKO)]
            for k, c in found.items()
        ]
    )
    for j, name in enumerate(("dop_rms", "dop_max", "sko_rms", "sko_max")):
        draft[f"/fit/{name}"] = fits[:, j]
    judged = [claims(c.compared(k), c.sko, c.error) for k, c in found.items()]
    draft["/claims/claim"] = np.array([c.name for c in judged[0]], dtype=object)
    draft["/claims/says"] = np.array([c.says for c in judged[0]], dtype=object)
    draft["/claims/reason"] = np.array([c.reason for c in judged[0]], dtype=object)
    draft["/claims/computed"] = np.array([[c.computed for c in each] for each in judged], dtype=object)
    draft["/claims/holds"] = np.array([[c.holds for c in each] for each in judged]).astype(np.int8)
    first = next(iter(found.values()))
    draft["/approach/time"] = first.time
    draft["/approach/pseudolites"] = np.array([ROWS[i].pseudolites for i in CURVES])
    draft["/approach/curve"] = np.array(CURVES) + 1
    draft["/approach/pdop"] = first.pdop
    draft["/approach/rms_horizontal"] = first.rms
    cases = [f"calibration {c.letter}, case {row + 1}" for c in found for row in range(len(ROWS))]
    least, printed_most = published_contradiction()
    attributes = root_attributes(
        "table2",
        seed,
        read(path(next(iter(found)).name))[0],
        least_pdop_of_case_6_from_cases_1_and_2=least,
        largest_pdop_of_case_6_printed=printed_most,
    )
    attributes["title"] = "Tables 1 and 2 of the landing paper, published and computed"
    out = draft.result(attributes)
    out.variables.update(kept(among(np.concatenate([c.found for c in found.values()]), "cases", cases.__getitem__)))
    return out
