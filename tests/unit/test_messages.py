"""What is said of input that is wrong, and of what changes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import typer

from navsim.cli.options import number_option
from navsim.cli.results import shown_as_stored
from navsim.filter.states import display_name
from navsim.landing.requirements import unevaluated_by_importance_sampling
from navsim.landing.study import prepare
from navsim.report import budget_rows
from navsim.report.consistency_rows import state_verdict
from navsim.results.findings import several
from navsim.results.result import Result, Variable
from navsim.results.schema import SCHEMA_VERSION
from navsim.scenario.integrity import TIMES_TO_ALERT, IntegritySection
from navsim.scenario.load import read, resolved_yaml, section
from navsim.scenario_files.base import _models_in
from navsim.scenario_files.source import InputError
from navsim.simulation.aiding import followed_errors
from tests.conftest import SCENARIOS

LANDING = SCENARIOS / "landing.yaml"


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("filter.gate=null",
         "filter.gate: expected a section, a mapping of keys to values, not null; without the key it has its defaults"),
        ("filter.gate=0.001", "filter.gate: expected a section, a mapping of keys to values, not 0.001; did you mean "
         "{probability: 0.001}? allowed: probability, max_rejected"),
        ("imu=hg1700", "imu: expected a section, a mapping of keys to values, not 'hg1700'; did you mean "
         "{preset: hg1700}? allowed: preset, gyro, accelerometer, from, rate_hz, vibration, temperature"),
        ("runway.threshold=[{lat_deg: 56}]",
         "runway.threshold: expected a section, a mapping of keys to values, not a list: without the dash before its "
         "keys"),
        ("runway.threshold=true",
         "runway.threshold: expected a section, a mapping of keys to values, not true; allowed: lat_deg, lon_deg"),
        ("approach=null",
         "approach: expected a section, a mapping of keys to values, not null; the key is required"),
        ("wind.gusts=4", "wind.gusts: expected a list, not 4; begin each entry with a dash"),
        ("signals.ionosphere.alpha=1", "signals.ionosphere.alpha: expected 4 numbers in brackets, [a, b, c, d], not 1"),
        ("wind.gusts=null", "wind.gusts: expected a list, not null; [] is an empty one"),
        ("sky.systems=gps", "sky.systems: expected a list, not 'gps'; one value in brackets is one: [gps]"),
        ("title=null", "title: expected a text, not null"),
        ("title=3", 'title: expected a text, not 3; in quotation marks it is one: "3"'),
        ("epoch=3", "epoch: expected a UTC time such as 2018-09-13T12:00:00Z, not 3"),
        ("pseudolites={sites: [{name: A&B, s_m: 1, l1_m: 2}]}",
         "pseudolites.sites.0.name: expected 1 to 16 of the letters A to Z and a to z, digits, - and _, not 'A&B'"),
        ("integrity={p_pseudolite: monitord}",
         "integrity.p_pseudolite: 'monitord' is not allowed; did you mean 'monitored'? "
         "allowed: monitored, unmonitored"),
        ("integrity.limits={operation: CAT1, tta_s: 6}",
         "integrity.limits.operation: 'CAT1' is not allowed; did you mean 'CAT-I'? "
         "allowed: NPA, APV-I, APV-II, LPV-200, CAT-I, GBAS-D"),
        ("integrity.limits={operation: apv 2, tta_s: 6}",
         "integrity.limits.operation: 'apv 2' is not allowed; did you mean 'APV-II'? "
         "allowed: NPA, APV-I, APV-II, LPV-200, CAT-I, GBAS-D"),
        ("integrity.limits={operation: CAT-II, tta_s: 6}",
         "integrity.limits.operation: 'CAT-II' is not allowed; allowed: NPA, APV-I, APV-II, LPV-200, CAT-I, GBAS-D"),
        ("beacons={preset: longrange, sites: [{s_m: 0, l1_m: 0}], rate_hz: 4, range_limit_m: 900}",
         "beacons.preset: 'longrange' is not allowed; did you mean 'long-range'? allowed: none, uwb, sx1280, "
         "radio-868, radio-915, long-range"),
        ("sky.source=galileo", "sky.source: 'galileo' is not allowed; did you mean 'nominal-galileo'? allowed: "
         "nominal-glonass, nominal-gps, nominal-galileo, nominal-beidou, nominal-qzss, nominal, almanac, navigation, "
         "orbits, directions"),
        ("integrity={p_pseudolite: 2}",
         "integrity.p_pseudolite: must be at most 0.1, not 2"),
        ("approach.glide_slope_deg=5 deg",
         "approach.glide_slope_deg: a plain number is needed, in ° by the key's name, and nothing behind it, not "
         "'5 deg'"),
        ("approach.speed_start_kmh=80 km/h", "approach.speed_start_kmh: a plain number is needed, in km/h by the key's "
         "name, and nothing behind it, not '80 km/h'"),
        ("sky.mask_deg=3,5", "sky.mask_deg: a number is needed, with a point for the decimals: 3.5, not '3,5'"),
        ("sky.mask_deg=1,000",
         "sky.mask_deg: a number is needed, with a point for the decimals, 1.000, or nothing between thousands, 1000, "
         "not '1,000'"),
        ("sky.mask_deg=0,500", "sky.mask_deg: a number is needed, with a point for the decimals: 0.500, not '0,500'"),
        ("sky.mask_deg='5'", "sky.mask_deg: a number is needed, not a text: without quotation marks, 5"),
        ("pseudolites.count=-2", "pseudolites.count: -2 is not allowed; allowed: 0, 1, 2"),
        ("wind.speed_kt=10",
         "wind.speed_kt: unknown key; did you mean 'speed_m_s', in m/s? allowed: speed_m_s, from_deg, profile, "
         "roughness_m, exponent, levels, turbulence, gusts, response"),
        ("barometric_altimeter={sigma_m: 1, drift_time_s: 60}",
         "barometric_altimeter.drift_time_s: there is no drift: give drift_m"),
        ("barometric_altimeter={sigma_m: 1, drift_time_s: 600}",
         "barometric_altimeter.drift_time_s: there is no drift: give drift_m"),
        ("integrity={p_constellations: {navic: 1e-4}}",
         "integrity.p_constellations.navic: unknown key; allowed: glonass, gps, galileo, beidou, qzss"),
        ("integrity={p_constellations: {glonas: 1e-4}}",
         "integrity.p_constellations.glonas: unknown key; did you mean 'glonass'? "
         "allowed: glonass, gps, galileo, beidou, qzss"),
        ("sky.systems=[GPS]",
         "sky.systems.0: 'GPS' is not allowed; did you mean 'gps'? allowed: glonass, gps, galileo, beidou, qzss"),
        ("runway.height_above=msl",
         "runway.height_above: 'msl' is not allowed; did you mean 'geoid'? allowed: ellipsoid, geoid"),
        ("filter.velocity=maybe", "filter.velocity: expected true or false, not 'maybe'"),
        ("filter.velocity=null", "filter.velocity: expected true or false, not null"),
        ("sky.mask_deg=null", "sky.mask_deg: expected a number, not null"),
        ("pseudolites.count=null", "pseudolites.count: null is not allowed; allowed: 0, 1, 2"),
    ],
)  # fmt: skip
def test_what_is_wrong(setting: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(LANDING, [setting])
    assert [f"{problem.key}: {problem.message}" for problem in caught.value.problems] == [said]


@pytest.mark.parametrize("given", [1, "x", [1]])
def test_no_value_takes_the_place_of_a_section(given: object) -> None:
    """Of each of a landing the error lists the keys, or asks for a list of them."""
    for name, field in section("landing").model_fields.items():
        if not _models_in(field.annotation):
            continue
        with pytest.raises(InputError) as caught:
            read(LANDING, [f"{name}={given!r}"])
        (problem,) = caught.value.problems
        assert re.search(
            r"^expected a (section, .*; .*allowed: |list, .*; begin each entry with a dash)", problem.message
        )
    with pytest.raises(InputError, match=re.escape("did you mean {count: 1}?")):
        read(LANDING, ["pseudolites=1"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("scenarios/landing.yaml", "no folder {}scenarios; 'navsim init landing -o landing.yaml' writes this scenario"),
        ("nothing.yaml", "no such file; 'navsim init' writes a scenario to start from"),
        ("units", "no such file; did you mean {}unit.yaml?"),
    ],
)
def test_a_missing_file_names_its_cure(given: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "unit.yaml").touch()
    with pytest.raises(InputError, match=re.escape(said.format(f"{tmp_path}/"))):
        read(tmp_path / given, [])


@pytest.mark.parametrize(
    ("given", "instead"), [("1e4", ": write 10000"), ("2.0", ": write 2"), ("1e-4", ""), ("1.5", ""), ("1e400", "")]
)
def test_a_whole_number_with_an_exponent(given: str, instead: str) -> None:
    with pytest.raises(typer.BadParameter) as caught:
        number_option(int, 1, "runs").parser(given)
    assert str(caught.value).endswith(f"not '{given}'{instead}")


def test_one_is_singular() -> None:
    assert [several(n, noun) for noun in ("sample", "fix") for n in (0, 1, 2)] == [
        "0 samples", "1 sample", "2 samples", "0 fixes", "1 fix", "2 fixes"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("method: chi2, p_hmi_v: 1e-6", ["p_hmi_v is not used: integrity.method is chi2"]),
        ("method: chi2, p_fa: 1e-4, p_md: 0.01", []),
        ("method: mhss, p_fa: 1e-4", ["p_fa is not used: integrity.method is mhss"]),
        ("method: filter, p_md: 1e-2", ["p_md is not used: integrity.method is filter"]),
        ("method: mhss, p_constellations: {gps: 1e-5, glonass: 1e-5}",
         ["p_constellations.gps is not used: the sky has none of them"]),
        ("method: mhss", []),
    ],
)  # fmt: skip
def test_what_changes_nothing(section: str, said: list[str]) -> None:
    case = prepare(*read(LANDING, ["duration_s=2", f"integrity={{{section}}}"]))
    assert [text for text in case.warnings if "not used" in text] == [f"integrity.{text}" for text in said]


@pytest.mark.parametrize(("operation", "longest"), TIMES_TO_ALERT.items())
def test_a_time_to_alert_that_the_operation_does_not_allow(operation: str, longest: float) -> None:
    for seconds, told in ((longest, 0), (longest + 1.0, 1)):
        limits = {"limits": {"operation": operation, "tta_s": seconds}, "method": "chi2"}
        warnings = IntegritySection.model_validate(limits).unused()
        assert sum(f"the time to alert of {operation}, {longest:g} s" in text for text in warnings) == told


@pytest.mark.parametrize("wind", ["speed_m_s: 8", "{profile}, levels: [{at}, {above}]"])
def test_no_wind_turns_an_aircraft_onto_a_pad(wind: str) -> None:
    level = "height_m: {}, speed_m_s: 8, from_deg: 90"
    above = [f"{{{level.format(height)}}}" for height in (0, 100)]
    wind = wind.format(profile="profile: table", at=above[0], above=above[1])
    key = f"wind.{'levels' if 'levels' in wind else 'speed_m_s'} is not used: "
    for name, told in (("beacons_pad", 1), ("landing_smooth", 0)):
        scenario, _ = read(LANDING.with_name(f"{name}.yaml"), [f"wind={{{wind}}}"])
        assert sum(text.startswith(key) for text in scenario.unused_of_flight()) == told


def test_pushed_runs_tell_of_the_box_alone() -> None:
    box = "box={lateral_m: 1, vertical_m: 1}"
    asked = (
        "requirements=[{of: lateral, what: error, at: touchdown, below_m: 8, share: 0.95}, {what: box, at_most: 0.1}]"
    )
    scenario, _ = read(LANDING, [box, asked])
    (said,) = unevaluated_by_importance_sampling(scenario)
    assert said.endswith("use `--method monte-carlo`: lateral error at touchdown below 8 m in 95 % of runs")
    assert unevaluated_by_importance_sampling(read(LANDING, [box, "requirements=[{what: box, at_most: 0.1}]"])[0]) == []


@pytest.mark.parametrize(("s_m", "seen"), [(200, True), (50_000, True), (60_000, False)])
def test_a_pseudolite_behind_the_horizon(s_m: float, seen: bool) -> None:
    """At 153 m over the runway an antenna at one metre is seen over 4.12 (sqrt(153) + sqrt(1)) = 55 km."""
    case = prepare(*read(LANDING, ["duration_s=5", f"pseudolites.s_m={s_m}"]))
    assert any("beyond the radio horizon" in text for text in case.warnings) != seen


def test_what_of_an_earlier_layout_is_not_shown(capsys: pytest.CaptureFixture[str]) -> None:
    box = {"/summary/box/limit": Variable(("axis",), np.ones(3), "m", "limits")}
    for version in (SCHEMA_VERSION - 1, SCHEMA_VERSION):
        with shown_as_stored([Result({"schema_version": version}, box)], [Path("old.h5")]):
            pass
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"warning: old.h5: has version {SCHEMA_VERSION - 1} of the layout")
    assert "as its box, is not shown" in said


@pytest.mark.parametrize(
    ("attributes", "warned", "left"),
    [
        ({"schema_version": SCHEMA_VERSION + 1, "navsim_version": "9.9"},
         f"this navsim version {SCHEMA_VERSION}: parts that are stored elsewhere there are not shown; a "
         "newer navsim shows them",
         "written by navsim 9.9; read it with a newer navsim"),
        ({}, "has no layout version", "does not name the program that wrote it; compute it again"),
    ],
)  # fmt: skip
def test_what_another_layout_wrote(
    attributes: dict[str, object], warned: str, left: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A newer one, which computing it again does not help, and one that is not told."""
    with pytest.raises(typer.Exit), shown_as_stored([Result(attributes, {})], [Path("other.h5")]):
        raise KeyError
    said = capsys.readouterr().err
    assert warned in said
    assert left in said


def test_a_drift_of_none_may_have_a_time(tmp_path: Path) -> None:
    """As in a sweep of its size, in a stored scenario, and before a filter that believes in its time."""
    sensor = "barometric_altimeter={sigma_m: 1, qnh_sigma_hpa: 1, drift_m: 0, drift_time_s: 300}"
    believed = "filter.barometric_altimeter={errors: states, drift_time_s: 300}"
    scenario, _ = read(LANDING, [sensor, "runway.geoid_undulation_m=17", believed])
    assert [block.name for block, _ in followed_errors(scenario.aiding(), 0.01)] == ["barometric_setting"]
    stored = tmp_path / "stored.yaml"
    stored.write_text(resolved_yaml(scenario))
    assert read(stored)[0] == scenario


def test_sigma_that_no_run_could_judge_is_not_called_old() -> None:
    """Pushed runs of method rare are off on purpose; results of earlier versions judged groups of states alone."""
    pushed = Result({}, {"/rare/error": Variable(("run", "axis"), np.zeros((2, 3)), "m", "errors")})
    assert state_verdict(pushed).startswith("not evaluated by method rare")
    assert state_verdict(Result({}, {})).startswith("none: the file is of an earlier version")


@pytest.mark.parametrize(
    ("state", "name"),
    [("fix_error_slow_north", "slow satellite errors, north"), ("fix_error_fast", "fast satellite errors"),
     ("fix_error_slow_more_1", "further slow satellite errors, 1"), ("range_error_slow_R01", "slow ranging error, R01"),
     ("attitude_down", "heading"), ("gyro_bias_x", "gyro bias x")],
)  # fmt: skip
def test_names_of_states(state: str, name: str) -> None:
    assert display_name(state) == name


def test_the_budget_begins_with_its_largest_source() -> None:
    shares = {"horizontal": np.array([0.002, 0.2, 0.795, 0.003]), "vertical": np.array([0.001, 0.9, 0.095, 0.004])}
    found = {"/summary/budget/source": Variable(("source",), np.array(["a", "b", "c", "d"]), "1", "")}
    for axis, share in shares.items():
        found[f"/summary/budget/{axis}"] = Variable(("source",), 2.0 * np.sqrt(share), "m", "")
        found[f"/summary/budget/{axis}_share"] = Variable(("source",), share, "1", "")
    result = Result({}, found)
    rows = budget_rows.budget_rows([result])
    assert rows == {"b": ["b"], "c": ["c"], "2 others, below 0.5 % each": ["d", "a"]}
    cells = [str(budget_rows.budget_cell(result, names)) for names in rows.values()]
    assert cells[0] == "0.894 (20.0 %), 1.897 (90.0 %)"
    assert cells[2] == "0.141 (0.5 %), 0.141 (0.5 %)"
