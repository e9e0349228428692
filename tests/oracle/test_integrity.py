"""Integrity monitors against published worked examples, closed forms and outside programs."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from navsim.gnss.dop import geometry_covariance
from navsim.gnss.sky import unit_vector
from navsim.integrity import sbas_gbas
from navsim.integrity.araim import Allocation, Fault, Levels, levels
from navsim.integrity.exclusion import NOTHING, alone, contained, least_rms
from navsim.integrity.innovations import InnovationTest, detection
from navsim.integrity.monitoring import QUIET
from navsim.integrity.observability import possible
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.risk import silent
from navsim.integrity.solution import Correlated, Independent, MonitoredFix, rows_of, solve
from navsim.landing.integrity import REGIONS, ApproachLimits, stanford_regions
from navsim.scenario.integrity import OPERATIONS, LimitsSection
from navsim.statistics import chi_square, normal
from tests.conftest import DATA, Within
from tests.formulas import SteadyWalk, undetected_by_separation

EAST, NORTH, UP = range(3)
CASE = "raim_weighted_6_satellites_2_pseudolites"


@pytest.fixture(scope="module")
def cases() -> dict[str, Any]:
    return json.loads((DATA / "integrity.json").read_text())


def rows_towards(azimuth_elevation_deg: list[list[float]], clock: list[int] | None = None) -> np.ndarray:
    azimuth, elevation = np.radians(np.array(azimuth_elevation_deg, float)).T
    return rows_of(unit_vector(azimuth, elevation)[None], np.array(clock or [0] * azimuth.size))


def solved(rows: np.ndarray, sigma: list[float]) -> MonitoredFix:
    return solve(rows, np.ones(rows.shape[:2], bool), Independent(np.array(sigma, float)[None]))


def raim(cases: dict[str, Any], p_fa: float | None = None) -> Monitor:
    given = cases[CASE]["inputs"]
    solution = solved(rows_towards(given["azimuth_elevation_deg"], given["clock"]), given["sigma_m"])
    return Monitor(solution, ChiSquareTest(p_fa or given["p_fa"], given["p_md"]))


@pytest.mark.parametrize("number", range(4))
@pytest.mark.validates("ARAIM protection levels and fault modes under random skies", "sidereon 3.0.4", "(relative)",
                       fault_modes="1e-7", levels="0.071 m", unmonitored_probability="3e-4")  # fmt: skip
def test_separation_of_another_program(number: int, within: Within) -> None:
    """Skies of one and two systems, sigmas, bounds and priors of their own for each satellite. Its levels are as near
    as it wants them, 0.05 m along each axis."""
    case = json.loads((DATA / "sidereon.json").read_text())[number]
    system, expected = np.array(case["system"]), case["expected"]
    rows, count = rows_towards(case["azimuth_elevation_deg"], case["system"]), system.size
    faults = [Fault((i,), prior) for i, prior in enumerate(case["p_sat"])]
    faults += [Fault(tuple(np.flatnonzero(system == i)), prior) for i, prior in enumerate(case["p_const"]) if prior]
    bounding = np.array(case["sigma_int_m"])[None]
    found = levels(
        rows, np.ones((1, count), bool), Independent(bounding), Independent(case["sigma_ratio_acc"] * bounding),
        np.array(case["b_nom_m"])[None], faults, lpv(),
    )  # fmt: skip
    assert found.unmonitored[0] == pytest.approx(expected["p_unmonitored"], rel=within["unmonitored_probability"])
    close: dict[str, Any] = {"rtol": within["fault_modes"]}
    for mode in expected["modes"][1:]:  # the first is that nothing is wrong
        k = count + "GE".index(mode["constellation"]) if mode["constellation"] else int(mode["excluded"][0][1:]) - 1
        assert faults[k].prior == mode["prior"]
        assert found.monitored[k, 0] == mode["monitorable"]
        if mode["monitorable"]:
            np.testing.assert_allclose(found.spread.separate_sigma[k, 0], mode["sigma"], **close)
            np.testing.assert_allclose(found.spread.separate_bias[k, 0], mode["bias"], **close)
            np.testing.assert_allclose(found.threshold[k, 0], mode["threshold"], **close)
    assert found.accuracy[0, UP] == pytest.approx(expected["sigma_acc_v"], rel=within["fault_modes"])
    assert found.emt[0] == pytest.approx(expected["emt"], rel=within["fault_modes"])
    ours = [found.horizontal[0], found.vertical[0]]
    assert ours == pytest.approx([expected["hpl"], expected["vpl"]], abs=within["levels"])


@pytest.mark.validates("Square root of the chi-square threshold", "L3NAV (Brown & Chin 1994)", printed_values="5e-4",
                       computed_values="1e-8")  # fmt: skip
def test_thresholds(cases: dict[str, Any], within: Within) -> None:
    entry = cases["chi2_threshold_sqrt"]
    for case in entry["cases"]:
        ours = [math.sqrt(chi_square.exceeded(case["p_fa"], n)) for n in case["dof"]]
        np.testing.assert_allclose(ours, case["published"], rtol=0, atol=within["printed_values"])
        np.testing.assert_allclose(ours, case["expected"], rtol=0, atol=within["computed_values"])


@pytest.mark.validates("Chi-square thresholds at 1e-3", "RTKLIB, table of pntpos", printed_values="0.051")
def test_table_of_rtklib(cases: dict[str, Any], within: Within) -> None:
    entry = cases["chi2_table_rtklib"]
    ours = [chi_square.exceeded(1e-3, n) for n in entry["dof"]]
    np.testing.assert_allclose(ours, entry["published"], rtol=0, atol=within["printed_values"])


@pytest.mark.validates("Range bias that the residual test misses", "SciPy ncx2 (kshana), quadrature", bias="1e-6")
def test_missed_bias(cases: dict[str, Any], within: Within) -> None:
    entry = cases["pbias"]
    for spot in entry["spot"]:
        ours = ChiSquareTest(spot["p_fa"], spot["p_md"]).bias(np.array([spot["dof"]]))[0]
        assert ours == pytest.approx(spot["expected"], abs=within["bias"])
    for name, row in entry["table_dof_1_to_12"].items():
        p_fa, p_md = (float(part.split("=")[1]) for part in name.split(","))
        np.testing.assert_allclose(ChiSquareTest(p_fa, p_md).bias(np.arange(1, 13)), row, rtol=0, atol=within["bias"])


@pytest.mark.validates("Noncentrality of Baarda's reliability", "Baarda 1968, Teunissen 2024", computed_values="1e-9",
                       printed_values="5e-4")  # fmt: skip
def test_baarda(cases: dict[str, Any], within: Within) -> None:
    """His test is of one range, two-sided; what is missed on the far side does not count."""
    entry = cases["baarda_noncentrality"]
    root = -normal.quantile(0.5 * entry["alpha"]) - normal.quantile(entry["beta"])
    assert root == pytest.approx(entry["delta0"], abs=within["computed_values"])
    assert root**2 == pytest.approx(entry["published"]["lambda0"], abs=within["printed_values"])
    ours = chi_square.noncentrality(chi_square.exceeded(entry["alpha"], 1), 1, entry["beta"])
    assert ours == pytest.approx(entry["lambda0"], abs=within["printed_values"])


def left_of(monitor: Monitor, errors: np.ndarray) -> np.ndarray:
    """Residuals (e, s, m), m, of fixes from ranges with these errors, which are independent."""
    assert isinstance(monitor.solution.noise, Independent)
    return monitor.solution.residuals(errors) * monitor.solution.noise.sigma[..., None]


@pytest.mark.validates("RAIM of 6 satellites and 2 pseudolites: test statistic, slopes, levels",
                       "sidereon 3.0.4 (reliability); independent script", "(relative)",
                       every_number="1e-8")  # fmt: skip
def test_weighted_raim(cases: dict[str, Any], within: Within) -> None:
    entry = cases[CASE]
    monitor, expected = raim(cases), entry["expected"]
    solution = monitor.solution
    close = {"rtol": within["every_number"], "atol": 1e-12}
    assert solution.degrees[0] == expected["dof"]
    np.testing.assert_allclose(solution.redundancy[0], expected["redundancy"], **close)
    np.testing.assert_allclose(monitor.test.threshold(solution.degrees), expected["threshold2"], **close)
    np.testing.assert_allclose(monitor.test.bias(solution.degrees), expected["pbias"], **close)
    np.testing.assert_allclose(monitor.slopes[0], np.transpose([expected["slope_h"], expected["slope_v"]]), **close)
    np.testing.assert_allclose(monitor.levels[0], [expected["hpl"], expected["vpl"]], **close)
    np.testing.assert_allclose(monitor.minimal_bias[0], expected["mdb"], **close)
    sigma = np.sqrt(np.diag(solution.covariance[0]))
    np.testing.assert_allclose(sigma, [expected["sigma_e"], expected["sigma_n"], expected["sigma_u"]], **close)

    errors = np.array(entry["inputs"]["range_errors_m"])
    biased = errors.copy()
    biased[entry["inputs"]["biased"]["index"]] += entry["inputs"]["biased"]["add_m"]
    both = np.stack([errors, biased], axis=1)[None]
    np.testing.assert_allclose((solution.estimator @ both)[0, :, 0], expected["x"][:3], **close)
    assert monitor.statistic(left_of(monitor, both))[0] == pytest.approx(
        [expected["wsse"], entry["expected_biased"]["wsse"]], rel=within["every_number"]
    )
    np.testing.assert_allclose(monitor.each(both)[0, :, 0], expected["w_test"], **close)
    np.testing.assert_allclose(monitor.each(both)[0, :, 1], entry["expected_biased"]["w_test"], **close)
    assert np.abs(monitor.each(both)[0, :, 1]).argmax() == entry["expected_biased"]["largest"]


@pytest.mark.validates("Choice of the range that RAIM excludes", "independent script (w tests)", "(relative)",
                       every_number="1e-8")  # fmt: skip
def test_exclusion(cases: dict[str, Any], within: Within) -> None:
    """Without a range the square of the residuals is smaller by that of its w. 25 m on one of them: the largest is its
    own, but the rest passes without another one, too, so nothing is excluded; by the RMS it is. From 60 m on it is."""
    entry = cases[CASE]
    monitor, given = raim(cases), entry["inputs"]
    source, seen = given["biased"]["index"], entry["expected_biased"]
    rows = rows_towards(given["azimuth_elevation_deg"])
    errors = np.repeat(np.array(given["range_errors_m"])[:, None], 2, axis=1)
    errors[source] += [given["biased"]["add_m"], 60.0]
    passes, rms = np.empty((8, 1, 2), bool), np.empty((8, 1, 2))
    for i in range(8):
        kept = np.arange(8)[None] != i
        rest = Monitor(solve(rows, kept, monitor.solution.noise), monitor.test)
        residual = left_of(rest, errors[None])
        statistic = rest.statistic(residual)
        assert statistic[0, 0] == pytest.approx(seen["wsse"] - seen["w_test"][i] ** 2, rel=within["every_number"])
        passes[i] = statistic <= rest.threshold[:, None]
        rms[i] = np.sqrt((residual**2).sum(axis=1) / 7)
    inside = contained(np.eye(8, dtype=bool), np.ones((1, 8), bool))
    assert list(np.flatnonzero(passes[:, 0, 0])) == [0, source]
    assert list(alone(passes, inside)[0]) == [NOTHING, source]
    assert list(least_rms(passes, rms, np.full((8, 1), 7))[0]) == [source, source]
    assert list(least_rms(passes, rms, np.full((8, 1), 4))[0]) == [NOTHING, NOTHING]


def ring(count: int, elevation_deg: float, first_deg: float) -> list[list[float]]:
    return [[first_deg + 360.0 * i / count, elevation_deg] for i in range(count)]


def lpv(p_unmonitored: float = 8e-8) -> Allocation:
    return Allocation(p_unmonitored=p_unmonitored)


@pytest.mark.parametrize("name", ["two_rings", "two_rings_with_ground"])
@pytest.mark.validates("RAIM and ARAIM levels of two rings of sources", "closed form", "m, or without unit",
                       every_number="1e-7")  # fmt: skip
def test_two_rings(name: str, cases: dict[str, Any], within: Within) -> None:
    given, expected = cases[name]["inputs"], cases[name]["expected"]
    places = ring(given["n1"], given["elevation1_deg"], given["azimuth1_first_deg"]) + ring(
        given["n2"], given["elevation2_deg"], given["azimuth2_first_deg"]
    )
    count = len(places)
    rows, used = rows_towards(places), np.ones((1, count), bool)
    noise = Independent(np.full((1, count), given["sigma_m"]))
    monitor = Monitor(solve(rows, used, noise), ChiSquareTest(given["p_fa"], given["p_md"]))
    near = {"rtol": 0, "atol": within["every_number"]}
    np.testing.assert_allclose(monitor.levels[0], [expected["hpl_slope"], expected["vpl_slope"]], **near)
    for which, at in (("1", 0), ("2", given["n1"])):
        assert monitor.solution.redundancy[0, at] == pytest.approx(
            expected[f"redundancy_{which}"], abs=within["every_number"]
        )
        slopes = [expected[f"slope_{axis}_{which}"] for axis in "hv"]
        np.testing.assert_allclose(monitor.slopes[0, at], slopes, **near)
    wanted = expected["mhss"]
    faults = [Fault((i,), wanted["p_sat"]) for i in range(count)]
    found = levels(rows, used, noise, noise, np.zeros((1, count)), faults, lpv(), unlisted=0.0)
    np.testing.assert_allclose(found.level[0], [wanted["pl_e"], wanted["pl_n"], wanted["vpl"]], **near)
    assert found.horizontal[0] == pytest.approx(wanted["hpl"], abs=within["every_number"])


@pytest.mark.validates("ARAIM protection levels of a published example", "ADD v3.0, appendix D",
                       printed_sigma="5e-5 m", printed_level="0.1 m", computed_values="2e-4 m")  # fmt: skip
def test_worked_example_of_araim(cases: dict[str, Any], within: Within) -> None:
    entry = cases["araim_add_v3_appendix_d"]
    given, expected, published = entry["inputs"], entry["expected"], entry["published"]
    rows = np.array(given["G"])[None]
    count = rows.shape[1]
    faults = [Fault((i,), given["p_sat"]) for i in range(count)]
    faults += [Fault(tuple(members), given["p_const"]) for members in given["constellations"]]
    found = levels(
        rows, np.ones((1, count), bool),
        *(Independent(np.sqrt(given[name])[None]) for name in ("c_int_m2", "c_acc_m2")),
        np.full((1, count), given["b_nom_m"]), faults, lpv(given["p_threshold"]),
    )  # fmt: skip
    assert found.monitored.sum() == expected["n_fault_modes"]
    assert found.unmonitored[0] == pytest.approx(expected["p_unmonitored"], rel=1e-6)
    apart = found.threshold[-2:, 0, UP] / expected["k_fa_v"]
    for i, (ours, wanted, printed) in enumerate(
        zip(np.transpose([found.spread.separate_sigma[-2:, 0, UP], apart, found.spread.separate_bias[-2:, 0, UP]]),
            expected["constellation_modes"], published["constellation_modes"], strict=True)
    ):  # fmt: skip
        names = ("sigma_u", "sigma_ss_u", "bias_u")
        np.testing.assert_allclose(
            ours, [wanted[n] for n in names], rtol=0, atol=within["computed_values"], err_msg=str(i)
        )
        np.testing.assert_allclose(ours, [printed[n] for n in names], rtol=0, atol=within["printed_sigma"])
    ours = [found.vertical[0], found.horizontal[0], *found.level[0, :2], found.emt[0], found.accuracy[0, UP]]
    wanted = [expected[n] for n in ("vpl", "hpl", "pl_e", "pl_n", "emt", "sigma_v_acc")]
    np.testing.assert_allclose(ours, wanted, rtol=0, atol=within["computed_values"])
    assert [found.vertical[0], found.emt[0]] == pytest.approx(
        [published["vpl"], published["emt"]], abs=within["printed_level"]
    )


def separated(cases: dict[str, Any], satellites: int, pseudolites: int, ground: float | None) -> Levels:
    """The levels of the first satellites and pseudolites of the case."""
    given = cases["mhss_6_satellites_2_pseudolites"]["inputs"]
    kept = [*range(satellites), *range(6, 6 + pseudolites)]
    rows = rows_towards([given["azimuth_elevation_deg"][i] for i in kept])
    noise, accuracy = (Independent(np.array(given[f"sigma_{n}_m"])[kept][None]) for n in ("int", "acc"))
    faults = [Fault((i,), given["p_satellite"]) for i in range(satellites)]
    faults += [Fault((satellites + i,), given["p_pseudolite"]) for i in range(pseudolites)]
    if ground is not None:
        faults.append(Fault(tuple(range(satellites, len(kept))), ground))
    nominal = np.array(given["b_nom_m"])[kept][None]
    return levels(rows, np.ones((1, len(kept)), bool), noise, accuracy, nominal, faults, lpv(), unlisted=0.0)


@pytest.mark.validates("ARAIM levels with pseudolites that may fail together", "independent script, dense matrices",
                       levels="1e-6 m")  # fmt: skip
def test_pseudolites_in_separation(cases: dict[str, Any], within: Within) -> None:
    entry = cases["mhss_6_satellites_2_pseudolites"]
    ground = entry["inputs"]["p_ground_group"]
    for name, made in (
        ("single_faults_only", (6, 2, None)),
        ("with_ground_group", (6, 2, ground)),
        ("satellites_only", (6, 0, None)),
    ):
        found, wanted = separated(cases, *made), entry["expected"][name]
        assert found.monitored.sum() == wanted["n_modes"]
        ours = [found.horizontal[0], found.vertical[0], *found.level[0, :2], found.emt[0], found.accuracy[0, UP]]
        expected = [wanted[n] for n in ("hpl", "vpl", "pl_e", "pl_n", "emt", "sigma_v_acc")]
        np.testing.assert_allclose(ours, expected, rtol=0, atol=within["levels"], err_msg=name)


@pytest.mark.validates("ARAIM levels if few satellites remain", "independent script, dense matrices", levels="1e-5 m")
def test_few_satellites(cases: dict[str, Any], within: Within) -> None:
    for name, wanted in cases["mhss_few_satellites"]["expected"].items():
        satellites, ground = int(name.split()[0]), float(name.split()[-1])
        found = separated(cases, satellites, 2, ground)
        assert found.monitored.sum() == wanted["n_modes"], name
        assert found.available[0] == wanted["available"], name
        assert found.unmonitored[0] == pytest.approx(wanted["p_unmonitored"], rel=1e-12), name
        if wanted["available"]:
            ours = [found.horizontal[0], found.vertical[0]]
            assert ours == pytest.approx([wanted["hpl"], wanted["vpl"]], abs=within["levels"]), name
        else:
            assert np.isnan([found.horizontal[0], found.vertical[0]]).all()


@pytest.mark.validates("Risk of a biased range under the chi-square test", "closed form, quadrature", "(relative)",
                       risk="1e-6")  # fmt: skip
def test_exact_risk(cases: dict[str, Any], within: Within) -> None:
    monitor, entry = raim(cases, 1e-5), cases["integrity_risk_exact"]
    source, expected = entry["inputs"]["fault_index"], entry["expected"]

    def risk(bias: float, limit: float) -> float:
        return silent(monitor, 0, source, bias, limit)

    for (limit, bias), name in (
        ((20, 20), "at_20_m_bias_20"),
        ((35, 30), "at_35_m_bias_30"),
        ((45, 30), "at_45_m_bias_30"),
    ):
        assert risk(bias, limit) == pytest.approx(expected[name], rel=within["risk"]), name
    worst = expected["at_vpl_we"]
    at = risk(worst["worst_bias_m"], worst["vpl"])
    assert at == pytest.approx(worst["p_hmi"], rel=within["risk"])
    assert max(risk(worst["worst_bias_m"] + d, worst["vpl"]) for d in (-0.5, 0.5)) < at
    limit = expected["vpl_for_worst_p_hmi_1e_7"]
    assert max(risk(bias, limit) for bias in np.linspace(20, 60, 4001)) == pytest.approx(1e-7, rel=1e-4)


@pytest.mark.validates("Risk of a biased range under one ARAIM test", "closed form, counted at 25 m", "(relative)",
                       risk="1e-5")  # fmt: skip
def test_risk_under_a_separation_test(cases: dict[str, Any], within: Within) -> None:
    entry, solution = cases["integrity_risk_separation_one_mode"], raim(cases).solution
    source = entry["inputs"]["fault_index"]
    left = solution.used.copy()
    left[:, source] = False
    given = cases[CASE]["inputs"]
    without = solve(rows_towards(given["azimuth_elevation_deg"]), left, solution.noise)
    apart = without.estimator - solution.estimator
    assert np.sqrt(solution.noise.variance(apart))[0, UP] == pytest.approx(entry["sigma_ss"], rel=1e-9)
    for row in entry["expected"]:
        for bias, name in ((row["worst_bias_m"], "p_hmi"), (40.0, "at_bias_40")):
            ours = undetected_by_separation(solution, apart[0], 0, source, bias, (row["level_m"], entry["threshold_m"]))
            assert ours == pytest.approx(row[name], rel=within["risk"]), name


@pytest.mark.validates("Residuals of spoofed satellites", "closed form", "(relative)", every_number="1e-6")
def test_spoofed_satellites(cases: dict[str, Any], within: Within) -> None:
    entry, monitor = cases["spoofing_snapshot"], raim(cases)
    rows = rows_towards(cases[CASE]["inputs"]["azimuth_elevation_deg"])[0]
    threshold = monitor.test.threshold(monitor.solution.degrees)[0]
    for case in entry["cases"]:
        what, size, _ = case["satellites_spoofed_by"].split()
        by = float(size) * np.array([what == "east", what == "north", what == "up", what == "clock"])
        fault = np.where(np.arange(8) < 6, rows @ by, 0.0)[None, :, None]
        seen = monitor.statistic(left_of(monitor, fault))[0, 0]
        assert seen == pytest.approx(case["lam"], rel=within["every_number"])
        told = 1.0 - chi_square.probability_below(threshold, 4, seen)
        assert told == pytest.approx(case["p_detect"], rel=within["every_number"])
        moved = (monitor.solution.estimator @ fault)[0, :, 0]
        np.testing.assert_allclose(moved, case["position_error_enu"], rtol=within["every_number"])
    everything = (rows @ np.array([30.0, -10.0, 20.0, 5.0]))[None, :, None]
    assert monitor.statistic(left_of(monitor, everything))[0, 0] == pytest.approx(0.0, abs=1e-18)


@pytest.mark.validates("SBAS protection levels", "RTKLIB on EGNOS data (DO-229 J)", levels="2e-4 m")
def test_sbas(cases: dict[str, Any], within: Within) -> None:
    for case in cases["sbas_do229_appendix_j"]["cases"]:
        elevation, azimuth, sigma = np.transpose(case["elevation_azimuth_sigma"])
        solution = solved(rows_towards(np.transpose([azimuth, elevation]).tolist()), sigma.tolist())
        assert sbas_gbas.sbas(solution)[0] == pytest.approx([case["hpl"], case["vpl"]], abs=within["levels"])
        npa = [case["hpl"] * math.sqrt(-2.0 * math.log(5e-9)) / 6.0, case["vpl"]]
        assert sbas_gbas.sbas(solution, "NPA")[0] == pytest.approx(npa, rel=1e-3)


@pytest.mark.validates("Factors K of GBAS protection levels", "ICAO Annex 10", printed_values="6e-4")
def test_gbas_factors(cases: dict[str, Any], within: Within) -> None:
    for case in cases["gbas_k_factors"]["cases"]:
        printed = (case["k_ffmd_published"], case["k_md_published"])
        assert sbas_gbas.gbas_factors(case["m"]) == pytest.approx(printed, abs=within["printed_values"])
        assert sbas_gbas.gbas_factors(case["m"]) == pytest.approx((case["k_ffmd"], case["k_md"]), abs=1e-9)


@pytest.mark.validates("Growth of GBAS alert limits", "ICAO Annex 10, tables B-68 and B-69", limits="0.01 m")
def test_growth_of_limits(within: Within) -> None:
    """Lateral limits of 40, 40, 51 and 69.15 m where FASLAL is 40, vertical ones of 10, 10, 30.2 and 43.35 m."""
    distance, feet = np.array([0.0, 873.0, 3375.0, 9000.0]), np.array([150.0, 200.0, 890.6, 2000.0])
    found = np.array([40.0, 10.0]) + sbas_gbas.growth_of_limits(distance, 0.3048 * feet)
    np.testing.assert_allclose(found[:, 0], [40.0, 40.0, 51.0, 69.15], atol=within["limits"])
    np.testing.assert_allclose(found[:, 1], [10.0, 10.0, 30.2, 43.35], atol=within["limits"])


@pytest.mark.validates("GBAS protection levels", "ICAO Annex 10, independent script", levels="1e-6 m")
def test_gbas(cases: dict[str, Any], within: Within) -> None:
    entry = cases["gbas_protection_level"]
    given, expected = entry["inputs"], entry["expected"]
    elevation, azimuth, sigma = np.transpose(given["elevation_azimuth_sigma"])
    solution = solved(rows_towards(np.transpose([azimuth, elevation]).tolist()), sigma.tolist())
    projection = sbas_gbas.gbas_projection(
        solution.estimator, math.radians(given["course_deg"]), math.radians(given["glide_path_deg"])
    )
    b = np.array(given["b_values_one_receiver_m"])[None]
    row = next(row for row in cases["gbas_k_factors"]["cases"] if row["m"] == given["m"])
    printed = (row["k_ffmd_published"], row["k_md_published"])
    found = sbas_gbas.gbas(
        projection, sigma[None], np.full((1, sigma.size), given["sigma_pr_gnd_m"]),
        sbas_gbas.effect_of_b(projection, b), given["m"], printed,
    )[0]  # fmt: skip
    assert found[0] == pytest.approx([expected["lpl_h0"], expected["lpl_h1"]], abs=within["levels"])
    assert found[1] == pytest.approx([expected["vpl_h0"], expected["vpl_h1"]], abs=within["levels"])


@pytest.mark.validates("Number of sources that detection and exclusion need", "ranks of matrices (numpy)",
                       each_cell="0")  # fmt: skip
def test_table_of_sources(cases: dict[str, Any], within: Within) -> None:
    wrong = 0
    for system, cells in cases["sources_table"]["rows"].items():
        for name, wanted in cells.items():
            satellites, pseudolites = map(int, name.split("+"))
            clocks = tuple(i % 2 if system == "two_systems" else 0 for i in range(satellites))
            ground = (7 if system == "pseudolites_own_shared_clock" else 0,) * pseudolites
            wrong += str(possible(clocks, ground)) != wanted.ljust(4, "-")
    assert wrong <= within["each_cell"]


def test_covariance_is_that_of_the_geometry() -> None:
    """The normal matrix of `gnss.dop` and this one are of the same equations."""
    rng = np.random.default_rng(5)
    for _ in range(30):
        count = int(rng.integers(4, 14))
        los = unit_vector(rng.uniform(0, 2 * np.pi, (4, count)), rng.uniform(-0.1, 1.5, (4, count)))
        clock, sigma, used = (
            rng.integers(0, 3, count),
            rng.uniform(0.3, 5.0, (4, count)),
            rng.uniform(size=(4, count)) < 0.8,
        )
        ours = solve(rows_of(los, clock), used, Independent(sigma)).covariance
        theirs, unknowns = geometry_covariance(np.where(used[..., None], los, np.nan), clock, sigma**-2)
        np.testing.assert_array_equal(np.isnan(ours[:, 0, 0]), unknowns == 0)
        np.testing.assert_allclose(ours, theirs[:, :3, :3], rtol=1e-8)


def test_correlated_ranges_are_whitened() -> None:
    """A diagonal covariance is that of independent ranges; a full one, that of the whitened problem."""
    rng = np.random.default_rng(6)
    los = unit_vector(rng.uniform(0, 2 * np.pi, (3, 9)), rng.uniform(0.1, 1.4, (3, 9)))
    rows, used = rows_of(los, np.zeros(9, int)), np.ones((3, 9), bool)
    used[1, 4] = False
    sigma = rng.uniform(0.5, 3.0, (3, 9))
    plain, same = (
        solve(rows, used, Independent(sigma)),
        solve(rows, used, Correlated(sigma[:, :, None] ** 2 * np.eye(9))),
    )
    for name in ("covariance", "estimator", "visibility", "redundancy"):
        np.testing.assert_allclose(getattr(plain, name), getattr(same, name), rtol=1e-9, atol=1e-12, err_msg=name)
    factor = rng.standard_normal((3, 9, 9))
    full = factor @ factor.swapaxes(1, 2) + np.eye(9)
    found = solve(rows, used, Correlated(full))
    for e in range(3):
        there = used[e]
        r, h = full[e][np.ix_(there, there)], rows[e][there]
        p = np.linalg.inv(h.T @ np.linalg.solve(r, h))
        np.testing.assert_allclose(found.covariance[e], p[:3, :3], rtol=1e-8)
        np.testing.assert_allclose(found.estimator[e][:, there], (p @ h.T @ np.linalg.inv(r))[:3], rtol=1e-7, atol=1e-9)
        m = np.linalg.inv(r) - np.linalg.inv(r) @ h @ p @ h.T @ np.linalg.inv(r)
        np.testing.assert_allclose(found.visibility[e][there], np.diag(m), rtol=1e-6, atol=1e-10)


@pytest.mark.validates("Regions of the Stanford diagram", "Stanford-ESA diagram")
def test_regions(cases: dict[str, Any]) -> None:
    for point in cases["stanford"]["points"]:
        limit, level, error = (float(point[name]) for name in ("al", "pl", "error"))
        every = np.ones(1, bool)
        asked = ApproachLimits(np.full(2, limit), 1.0, np.zeros(1), every, every)
        found = stanford_regions(asked, np.full((1, 1, 2), level), np.array([[QUIET]]), np.full((1, 1, 2), error))
        assert REGIONS[found[0, 0, 0]].replace("_", "-") == point["region"]


@pytest.mark.validates("Alert limits of operations", "ICAO Annex 10; doi:10.1186/s43020-020-00010-2; DO-245A")
def test_alert_limits(cases: dict[str, Any]) -> None:
    """Of CAT I the smaller end; times to alert were not read in the documents, and are the user's to give."""
    rows = {row["name"].removeprefix("GBAS-GSL-"): row for row in cases["alert_limits"]["rows"]}
    for name, (horizontal, vertical) in OPERATIONS.items():
        row = rows[name.removeprefix("GBAS-")]
        given = min(row["val"]) if isinstance(row["val"], list) else row["val"]
        assert (horizontal, vertical) == (row["hal"], given), name
    assert LimitsSection.model_fields["tta_s"].is_required()


@pytest.mark.validates("Innovations of a filter that follows a slow ramp, and the chance to detect it", "closed form",
                       every_number="1e-8")  # fmt: skip
def test_ramp_behind_a_filter(cases: dict[str, Any], within: Within) -> None:
    given, expected = (cases["innovation_ramp"][part] for part in ("inputs", "expected"))
    walk = SteadyWalk.of(given["q"], given["r"])
    slope = given["ramp_per_epoch"]
    found = (walk.p, walk.gain, walk.s, slope / walk.gain, walk.noncentrality(slope))
    names = ("p_minus", "gain", "innovation_variance", "steady_innovation", "lambda_per_epoch")
    np.testing.assert_allclose(found, [expected[name] for name in names], rtol=0, atol=within["every_number"])
    window = given["window"]
    chance = detection(window, window * walk.noncentrality(slope), given["p_fa"])
    assert chance == pytest.approx(expected["detection_probability"], abs=within["every_number"])


def test_sums_of_innovations_detect_a_ramp_as_often_as_expected(cases: dict[str, Any]) -> None:
    """Simulated filters long after the ramp began: alarms of the window within the 99 % binomial interval."""
    given, expected = (cases["innovation_ramp"][part] for part in ("inputs", "expected"))
    walk, runs, epochs = SteadyWalk.of(given["q"], given["r"]), 40_000, 90
    random = np.random.default_rng(8)
    truth, estimate, squared = np.zeros(runs), np.zeros(runs), np.zeros((runs, epochs))
    for k in range(epochs):
        truth += np.sqrt(given["q"]) * random.standard_normal(runs)
        measured = truth + np.sqrt(given["r"]) * random.standard_normal(runs) + given["ramp_per_epoch"] * k
        innovation = measured - estimate
        squared[:, k] = innovation**2 / walk.s
        estimate += walk.gain * innovation
    test = InnovationTest(given["window"] - 0.5, given["p_fa"])
    ratio = test.ratio(np.arange(float(epochs)), squared, np.ones((runs, epochs), int))
    chance = expected["detection_probability"]
    reach = 2.576 * np.sqrt(runs * chance * (1.0 - chance))
    assert abs((ratio[:, -1] > 1.0).sum() - runs * chance) < reach


def test_windows_of_innovations() -> None:
    """Sums by hand: of what is in the window, whatever is missing; nan where nothing is."""
    time = np.array([1.0, 2.0, 3.0, 4.0, 9.0])
    squared = np.array([[1.0, np.nan, 4.0, 2.0, np.nan]])
    degrees = np.array([[1, 0, 2, 1, 0]])
    ratio = InnovationTest(2.0, 1e-3).ratio(time, squared, degrees)
    limit = {n: chi_square.exceeded(1e-3, n) for n in (1, 2, 3)}
    np.testing.assert_allclose(ratio[0, :4], [1 / limit[1], 1 / limit[1], 4 / limit[2], 6 / limit[3]], rtol=1e-12)
    assert np.isnan(ratio[0, 4])
    each = InnovationTest(0.0, 1e-3).ratio(time, squared, degrees)
    np.testing.assert_allclose(each[0, [0, 2, 3]], [1 / limit[1], 4 / limit[2], 2 / limit[1]], rtol=1e-12)
