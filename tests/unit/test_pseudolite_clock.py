"""The time scale that pseudolites keep where the scenario does not say, and one that nobody else keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.gnss.constellations.systems import CLOCKS
from navsim.optimization.problem import problem
from navsim.optimization.scenario import Optimize
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.runner.executor import threads
from navsim.runner.opening import checked
from navsim.scenario.load import read_study, resolved_yaml
from navsim.sweeps import study as sweep
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import Sweep
from tests.conftest import SCENARIOS
from tests.helpers import case

BRIEF = ("duration_s=62", "receiver.rate_hz=0.2", "imu.rate_hz=20")
ONE = "pseudolites={count: 1, frame: runway, s_m: 200, l1_m: 3000"
SKIES = [
    ("sky.source=nominal-glonass", "glonass"),
    ("sky.source=nominal-gps", "gps"),
    ("sky={source: nominal, systems: [galileo]}", "galileo"),
    ("sky={source: nominal, systems: [beidou, gps]}", "gps"),
    ("sky={source: nominal, systems: [qzss, beidou]}", "beidou"),
    ("sky.source=nominal", "glonass"),
    (f"sky={{source: nominal, exclude: [{', '.join(f'R{i:02d}' for i in range(1, 25))}]}}", "gps"),
    ("sky={source: directions, directions: [" + ", ".join(
        f"{{azimuth_deg: {90 * i}, elevation_deg: {20 + 15 * i}, clock: galileo}}" for i in range(4)) + "]}",
     "galileo"),
]  # fmt: skip


@pytest.mark.parametrize(("sky", "clock"), SKIES, ids=[sky for sky, _ in SKIES])
def test_the_default_is_a_scale_of_satellites_in_use(sky: str, clock: str) -> None:
    """The first in the order of the table, and the fixes gain by it."""
    with_one, without = (case(*BRIEF, sky, given) for given in (f"{ONE}}}", "pseudolites.count=0"))
    assert CLOCKS[with_one.pseudolites.time_scale] == clock
    assert f"clock: {clock}\n" in resolved_yaml(with_one.scenario)
    assert (with_one.shared.dop[:, 1] < without.shared.dop[:, 1]).all() or np.isnan(without.shared.dop[:, 1]).all()
    assert not [text for text in with_one.warnings if "pseudolites.clock" in text]


def test_the_default_follows_the_file(tmp_path: Path) -> None:
    """Where none is named both usual systems are looked for; the file has one of them."""
    sky = f"sky={{source: almanac, almanac: {tmp_path / 'gps.alm'}}}"
    settings = (*BRIEF, sky, f"{ONE}}}", "epoch=2018-09-13T12:00:00Z")
    (tmp_path / "gps.alm").write_text(YUMA)
    assert CLOCKS[case(*settings).pseudolites.time_scale] == "gps"


YUMA = "\n".join(
    f"""******** Week 990 almanac for PRN-{number:02d} ********
ID: {number:02d}
Health: 000
Eccentricity: 0.0
Time of Applicability(s): 405504.0000
Orbital Inclination(rad): 0.96
Rate of Right Ascen(r/s): -8.0E-009
SQRT(A)  (m 1/2): 5153.6
Right Ascen at Week(rad): {number % 6 * 1.047:.4f}
Argument of Perigee(rad): 0.0
Mean Anom(rad): {number * 0.7:.4f}
Af0(s): 0.0
Af1(s/s): 0.0
week: 990
"""
    for number in range(1, 29)
)


@pytest.mark.parametrize("clock", ["own", "glonass"])
def test_one_by_itself_on_a_scale_is_warned_of(clock: str) -> None:
    """DOPs are those without it; two of them help and are not warned of."""
    gps = "sky.source=nominal-gps"
    without, alone = case(*BRIEF, gps, "pseudolites.count=0"), case(*BRIEF, gps, f"{ONE}, clock: {clock}}}")
    two = case(*BRIEF, gps, f"pseudolites={{count: 2, frame: runway, s_m: 200, l1_m: 3000, clock: {clock}}}")
    np.testing.assert_allclose(alone.shared.dop[:, 1:4], without.shared.dop[:, 1:4], rtol=1e-9)
    said = [text for text in alone.warnings if "pseudolites.clock" in text]
    assert len(said) == 1
    assert "at 12 of 12 fixes" in said[0]
    assert "give `clock: gps`" in said[0]
    assert (two.shared.dop[:, 1] < without.shared.dop[:, 1]).all()
    assert not [text for text in two.warnings if "pseudolites.clock" in text]
    told = checked(SCENARIOS / "landing.yaml", [*BRIEF, gps, f"{ONE}, clock: {clock}}}"])[2]
    assert said[0] in told


def test_a_receiver_of_one_clock_does_not_mind() -> None:
    one = case(*BRIEF, "sky.source=nominal-gps", f"{ONE}, clock: glonass}}", "receiver.single_clock=true")
    assert not [text for text in one.warnings if "pseudolites.clock" in text]


def swept(tmp_path: Path, settings: str, vary: str, method: str = "dop") -> Result:
    file = tmp_path / "sweep.yaml"
    file.write_text(
        f"kind: sweep\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nmethod: {method}\n"
        f"set: {{duration_s: 62, receiver.rate_hz: 0.2, imu.rate_hz: 20, pseudolites.frame: runway, {settings}}}\n"
        f"vary: {vary}\n"
    )
    planned = plan(*read_study(file, Sweep), 1)
    return sweep.sweep_result(planned, sweep.compute(planned, threads(1)))


PLACES = "[{key: pseudolites.count, values: [1]}, {key: pseudolites.l1_m, values: [2000, 3000, 4000]}]"


def test_a_sweep_that_cannot_tell_places_apart_says_so(tmp_path: Path) -> None:
    alone = swept(tmp_path, "sky.source: nominal-gps, pseudolites.clock: glonass", PLACES)
    texts = [found.text for found in of(alone) if "pseudolites.clock" in found.text]
    assert len(texts) == 1
    assert texts[0].startswith("all combinations are equally good: pseudolites.clock: one pseudolite")
    assert "in 3 of 3 combinations" in texts[0]
    np.testing.assert_allclose(alone["/sweep/pdop"], alone["/sweep/pdop"][0, 0], rtol=1e-9)
    follows = swept(tmp_path, "sky.source: nominal-gps", PLACES)
    assert not [found for found in of(follows) if "pseudolites.clock" in found.text]
    assert np.ptp(follows["/sweep/pdop"]) > 0.01


@pytest.mark.parametrize("method", ["dop", "covariance"])
def test_some_combinations_are_named(method: str, tmp_path: Path) -> None:
    vary = "[{key: sky.source, values: [nominal-gps, nominal-glonass]}]"
    found = swept(tmp_path, "pseudolites.count: 1, pseudolites.clock: glonass", vary, method)
    texts = [one.text for one in of(found) if "pseudolites.clock" in one.text]
    assert len(texts) == 1
    assert "pseudolites.clock: one" in texts[0]
    assert "in 1 of 2 combinations" in texts[0]


def test_a_search_among_equal_places_says_so(tmp_path: Path) -> None:
    file = tmp_path / "search.yaml"
    file.write_text(
        f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nobjective: pdop\npseudolites: [1, 2]\n"
        "set: {sky.source: nominal-gps, pseudolites.clock: glonass, pseudolites.frame: runway, receiver.rate_hz: 0.2}\n"
        "area: {s_m: [100, 1000], l1_m: [0, 4000]}\n"
    )
    warnings = problem(*read_study(file, Optimize)).warnings
    assert [text for text in warnings if text.startswith("all positions of 1 pseudolite are equally good")]
    assert not [text for text in problem(*read_study(file, Optimize, ["pseudolites=[2]"])).warnings if "clock" in text]
