"""Pseudolites in a landing: how strong they are heard, what their noise is, what is said of them."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

from navsim.gnss import dll
from navsim.landing.case import Case
from navsim.landing.study import covariance_analysis, covariance_result
from navsim.report import summary_tables
from navsim.report.table import ABSENT
from navsim.results.result import Result
from navsim.scenario.load import resolved_yaml
from navsim.scenario_files.source import InputError
from navsim.simulation.measurements import measured
from tests.conftest import ROOT
from tests.helpers import case, in_brief, scenario

BRIEF = ("duration_s=30", "receiver.rate_hz=2", "pseudolites.frame=runway", "sky.source=nominal-gps")
LIGHT = 299792458.0


def test_noise_by_the_link() -> None:
    """The loop's noise at the C/N0 that follows from power, distance, pattern, antenna and noise figure."""
    s = case(
        *BRIEF, "pseudolites.eirp_dbm=-25", "pseudolites.range_law=cn0", "receiver.noise_figure_db=3",
        "pseudolites.pattern={elevation_deg: [-90, 90], gain_db: [[-4, -4]]}",
    ).shared.signals  # fmt: skip
    distance = np.linalg.norm(s.position[:, -2:] - s.antenna[:, None], axis=2)
    gain = -10.0 * (1.0 - np.sin(s.elevation[:, -2:]))
    noise = 10.0 * np.log10(1.380649e-23 * 290.0)
    cn0 = -25.0 - 30.0 - 4.0 - 20.0 * np.log10(4.0 * np.pi * distance * 1575.42e6 / LIGHT) + gain - noise - 3.0
    np.testing.assert_allclose(s.cn0[:, -2:], cn0, atol=1e-9)
    ratio = 10.0 ** (cn0 / 10.0)
    sigma = LIGHT / 1.023e6 * np.sqrt(0.5 / (2.0 * ratio) * (1.0 + 2.0 / (0.02 * 1.5 * ratio)))
    np.testing.assert_allclose(s.sigma[:, -2:], sigma, rtol=1e-9)
    np.testing.assert_array_equal(s.cn0[:, :-2][s.used[:, :-2]], 45.0)


def test_shadowed_pseudolites_are_counted_by_name() -> None:
    settings = (*BRIEF, "pseudolites.s_m=3000", "pseudolites.l1_m=1000", "wind.speed_m_s=0")
    plain, flown = case(*settings), case(*settings, "receiver.antenna={mask_deg: 5}")
    hidden = (~flown.shared.signals.used[:, -2:]).sum(axis=0)
    assert plain.shared.signals.used[:, -2:].all()
    assert (hidden > 0).all()
    for name, times in zip(("PL1", "PL2"), hidden, strict=True):
        text = f"receiver.antenna: the aircraft shadows {name} at {times} of 60 fixes"
        assert [said for said in flown.warnings if said == text]
    assert not [said for said in case(*settings, "receiver.antenna={}").warnings if "shadows" in said]


def lost_by_name(flown: Case, title: str) -> dict[str, str]:
    """The rows of a section of the table of a covariance analysis: source, and at how many fixes it is lost."""
    rows = summary_tables.summary_table([("x", covariance_result(flown, covariance_analysis(flown), 1))]).rows
    rest = rows[[row.cells[0] for row in rows].index(title) + 1 :]
    own = itertools.takewhile(lambda row: not row.heading, rest)
    return {name.strip(): said for name, said in (row.texts() for row in own)}


def test_satellites_in_the_shadow_are_counted_by_name() -> None:
    """Those that the mask lets pass and that are not excluded: a belly antenna loses what is above it."""
    settings = (*BRIEF, "method=covariance", "sky.exclude=[G14]")
    plain, flown = case(*settings), case(*settings, "receiver.antenna={mount: belly, mask_deg: -20}")
    seen, left = (c.shared.signals.used.sum(axis=0) for c in (plain, flown))
    lost = {n: int(k) for n, k in zip(plain.shared.signals.names, seen - left, strict=True) if k}
    assert len(lost) > 2
    told = ", ".join(f"{name} at {times}" for name, times in lost.items())
    assert f"receiver.antenna: the aircraft shadows {told} of 60 fixes" in flown.warnings
    found = lost_by_name(flown, "In the aircraft's shadow")
    assert found == {name: f"{times} of 60" for name, times in lost.items()}


def test_satellites_that_pseudolites_jam_are_counted_by_name() -> None:
    silent = "events=[{what: silence, sources: [G07], at_s: 0}]"
    settings = (*BRIEF, "method=covariance", "pseudolites.eirp_dbm=-7", "pseudolites.l1_m=500", silent)
    plain, flown = case(*settings), case(*settings, "interference={pseudolites: {isolation_db: 21.1}}")
    seen, left = (c.shared.signals.used.sum(axis=0) for c in (plain, flown))
    lost = {n: int(k) for n, k in zip(plain.shared.signals.names, seen - left, strict=True) if k}
    assert lost
    assert "G07" not in lost
    told = ", ".join(f"{name} at {times}" for name, times in lost.items())
    warning = f"interference.pseudolites: jammed by pseudolites: {told} of 60 fixes"
    assert warning in flown.warnings
    # searches omit satellites that are never heard
    heard = flown.shared.signals.select(seen > 0)
    assert heard.names != flown.shared.signals.names
    assert warning in replace(flown.preflight, signals=heard).warnings
    found = lost_by_name(flown, "Too weak or jammed")
    assert found == {name: f"{times} of 60" for name, times in lost.items()}


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("pseudolites.pattern={elevation_deg: [0, 90], gain_db: [[0, 0]]}", "relative to eirp_dbm"),
        ("pseudolites={count: 0, eirp_dbm: 0, cn0_reference_m: 100}", "is for cn0_dbhz"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {elevation_deg: [9, 0], gain_db: [[0, 0]]}}", "have to rise"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {elevation_deg: [0, 9], gain_db: [[0]]}}", "has 1 values"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {azimuth_deg: [0, 9], elevation_deg: [0, 9], gain_db: "
         "[[0, 0]]}}", "has 1 lists"),
        ("pseudolites={count: 0, eirp_dbm: 0, pattern: {azimuth_deg: [0, 360], elevation_deg: [0, 9], gain_db: "
         "[[0, 0], [0, 0]]}}", "360 is 0 again"),
        ("receiver.antenna={elevation_deg: [0, 45, 90]}", "gain_dbi: has 2 values, elevation_deg has 3"),
        ("pseudolites.clock_noise={h0: 0, h_minus2: 0}", "clocks without noise do not wander"),
        ("pseudolites.clock_age_s=5", "is for clock_noise or clock_drift_sigma_ppb; give one, or leave it out"),
        ("pseudolites.clock_age_s=0", "is for clock_noise or clock_drift_sigma_ppb; give one, or leave it out"),
        ("interference={pseudolites: {}}", "give pseudolites.eirp_dbm, or pseudolites.cn0_reference_m"),
        ("interference={pseudolites: {lines: false, isolation_db: 21.1}}", "isolation_db: is of lines"),
    ],
)  # fmt: skip
def test_what_cannot_go_together(setting: str, said: str) -> None:
    with pytest.raises(InputError, match=said.replace(".", r"\.")):
        scenario(setting)


def test_an_age_is_stored_of_clocks_that_wander_alone() -> None:
    stored = resolved_yaml(scenario())
    assert "pseudolites" in stored
    assert "clock_age_s" not in stored


def test_strength_by_two_ways_is_told() -> None:
    (said,) = [w for w in case(*BRIEF, "pseudolites.eirp_dbm=0", "pseudolites.cn0_dbhz=50").warnings if "cn0_dbhz" in w]
    assert said == "pseudolites.cn0_dbhz: not used, the strength follows from eirp_dbm"


def test_no_mast_over_ground_that_reflects_is_told() -> None:
    settings = (*BRIEF, "pseudolites.multipath={}")
    (said,) = [w for w in scenario(*settings).unused() if "multipath" in w]
    assert said.startswith("pseudolites.multipath: PL1, PL2 at no height above the ground")
    assert not scenario(*settings, "pseudolites.height_m=3").unused()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ((), "white"),
        (("pseudolites.survey_error_m=[0, 0.5, 0]",), "some time-correlated"),
        (("pseudolites.clock_offset_ns=3",), "some time-correlated"),
        (("pseudolites.clock_offset_ns=3", "pseudolites.clock=own"), "white"),
        (("pseudolites.clock_offset_ns=3", "pseudolites.count=0"), "white"),
        (("signals.gps_offset_ns=20", "signals.system_offsets_ns={galileo: 5}"), "white"),
        (("signals.system_offsets_ns={galileo: 5}", "receiver.single_clock=true"), "some time-correlated"),
        (("signals.system_offset_sigma_ns=5", "receiver.single_clock=true"), "some time-correlated"),
        (("pseudolites.multipath={}",), "some time-correlated"),
        (("pseudolites.clock_noise={h0: 1e-22, h_minus2: 0}",), "some time-correlated"),
    ],
)  # fmt: skip
def test_whether_ranging_errors_are_white(settings: tuple[str, ...], said: str) -> None:
    """As tables say it: constant ones are not, where the receiver does not solve for them."""
    given = scenario(*settings)
    result = Result({"scenario": resolved_yaml(given)}, {})
    assert summary_tables.ranging_errors(result) == said


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ((), "white noise alone, so their gain is optimistic"),
        (("pseudolites.count=0",), ABSENT),
        (("pseudolites.survey_sigma_m=0.1", "pseudolites.range_bias_sigma_m=0.3"), "white noise, survey, range bias"),
    ],
)
def test_which_errors_pseudolites_have(settings: tuple[str, ...], said: str) -> None:
    result = Result({"scenario": resolved_yaml(scenario(*settings))}, {})
    assert summary_tables._errors_of_pseudolites(result) == said


def test_signals_fade_by_the_ground() -> None:
    """By the sum of both rays, at most twice the field, and the noise of ranges is by what is left."""
    settings = (*BRIEF, "pseudolites.height_m=4", "pseudolites.eirp_dbm=-25", "pseudolites.range_law=cn0")
    plain, flown = case(*settings).shared.signals, case(*settings, "pseudolites.multipath={polarisation: vertical}")
    faded, ground = flown.shared.signals, flown.environment.effects.reflection
    assert ground is not None
    assert ground.polarisation == "vertical"
    above = flown.trajectory.motion(faded.time).llh[:, 2] - ground.height
    distance = np.linalg.norm(faded.position[:, -2:] - faded.antenna[:, None], axis=2)
    across = np.sqrt(distance**2 - (above[:, None] - 4.0) ** 2)
    amplitude, _, phase = dll.reflection(ground, 1575.42e6, above[:, None], 4.0, across)
    change = faded.cn0[:, -2:] - plain.cn0[:, -2:]
    np.testing.assert_allclose(change, 20.0 * np.log10(np.abs(1.0 + amplitude * np.exp(1j * phase))), atol=1e-6)
    assert np.ptp(change) > 3.0
    loop = dll.CodeLoop(0.5, 1.0, 0.02)
    np.testing.assert_allclose(faded.sigma[:, -2:], loop.sigma(faded.cn0[:, -2:], LIGHT / 1.023e6), rtol=1e-12)


def test_places_and_clocks_are_drawn_for_each_run() -> None:
    """Ranges of a pseudolite are off by the same over a run, over runs by 1 sigma of both, and by nothing of the
    other's: 4.5 sigma of 300 runs."""
    flown = case(
        *BRIEF, "duration_s=2", "pseudolites.survey_sigma_m=0.8", "pseudolites.clock_sigma_ns=4",
        "pseudolites.range_sigma_m=1e-6",
    ).shared  # fmt: skip
    clean = flown.signals.range + flown.signals.range_bias + flown.clock[:, :1]
    off = np.array([(measured(flown, 5, run)[0] - clean)[:, -2:] for run in range(300)])
    assert np.ptp(off, axis=1).max() < 0.05
    first = off[:, 0]
    assert first.std(axis=0) == pytest.approx([np.hypot(0.8, LIGHT * 4e-9)] * 2, rel=4.5 / np.sqrt(600.0))
    assert abs(np.corrcoef(first.T)[0, 1]) < 4.5 / np.sqrt(300.0)
    np.testing.assert_allclose(flown.signals.fix_sigma[:, -2:], np.hypot(0.8, LIGHT * 4e-9), rtol=1e-9)


def test_the_analysis_carries_places_and_clocks() -> None:
    """What one sigma of each does to positions is what as much of the same error does that is known, of one
    pseudolite; range rates have none of what is drawn."""
    settings = (
        *BRIEF, "pseudolites.count=1", "pseudolites.clock=gps", "pseudolites.survey_sigma_m=0.2",
        "pseudolites.clock_sigma_ns=3",
    )  # fmt: skip
    whole = covariance_analysis(case(*settings))
    still = whole.mean[-1, :3]
    moved = [
        covariance_analysis(case(*settings, setting)).mean[-1, :3] - still
        for setting in (
            *(f"pseudolites.survey_error_m={[0.2 * (k == axis) for k in range(3)]}" for axis in range(3)),
            "pseudolites.clock_offset_ns=3",
        )
    ]
    found = [whole.variance[whole.sources.index(name), -1, :3] for name in ("pseudolite_survey", "pseudolite_clock")]
    assert found[1].max() > 1e-4
    np.testing.assert_allclose(np.sqrt(found[0]), np.linalg.norm(moved[:3], axis=0), rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(found[1]), np.abs(moved[3]), rtol=2e-3, atol=1e-6)


def rows_of_nees() -> list[tuple[tuple[str, ...], list[float]]]:
    """Settings, smallest and largest NEES of docs/covariance-measured.md: all the time, and from 10 s on."""
    page = (ROOT / "docs" / "covariance-measured.md").read_text(encoding="utf-8")
    out: list[tuple[tuple[str, ...], list[float]]] = []
    first: tuple[str, ...] = ()
    for line in page.partition("| `--set` |")[2].splitlines()[2:]:
        if not line.startswith("|"):
            break
        settings, *found = line.strip("|").split("|")
        own = tuple(re.findall(r"`([^`]+)`", settings))
        first = first if "the same" in settings else own
        every = own if own == first else (*first, *own)
        out.append((every, [float(number) for part in found for number in part.split(" to ")]))
    return out


@pytest.mark.parametrize(("settings", "told"), in_brief(rows_of_nees(), 0, 3, 6))
def test_how_much_too_sure_the_filter_is(settings: tuple[str, ...], told: list[float]) -> None:
    flown = case(*settings, "method=covariance", "filter.fix_errors=none", name="landing_smooth")
    nees = covariance_analysis(flown).expected_square(slice(0, 6))
    late = nees[flown.shared.filter_time >= 10.0]
    assert [nees.min(), nees.max(), late.min(), late.max()] == pytest.approx(told, abs=0.006)
    own = tuple(words for words in settings if "fix_sigma_scale" not in words)
    states = covariance_analysis(case(*own, "method=covariance", name="landing_smooth"))
    np.testing.assert_allclose(states.expected_square(slice(0, 6)), 1.0, atol=0.005)
