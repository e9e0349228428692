"""Names of pseudolites, beacons and jammers, which are no other source's: every place where names meet relies on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from tests.helpers import SCENARIOS

STATION = "dme={noise_m: 20}"
SITES = "sites: [{s_m: 90, l1_m: 900}, {name: NAME, s_m: 300, l1_m: 900}]"
BEACONS = f"beacons={{{SITES}, rate_hz: 1, sigma_m: 1, range_limit_m: 9000}}"
PSEUDOLITES = f"pseudolites={{count: 0, s_m: 0, l1_m: 0, {SITES}}}"
JAMMER = (
    "interference={jammers: [{name: NAME, place: {lat_deg: 56, lon_deg: 37}, eirp_dbw: 5, waveform: tone, "
    "centre_mhz: 1602}]}"
)
OF = {PSEUDOLITES: "pseudolites.sites.1.name", BEACONS: "beacons.sites.1.name", JAMMER: "interference.jammers.0.name"}
GLONASS = "sky={source: nominal-glonass}"


@pytest.mark.parametrize("source", list(OF), ids=OF.get)
@pytest.mark.parametrize(
    ("name", "settings", "whose"),
    [
        ("dme", (STATION,), "the ground station"),
        ("azimuth_station", ("azimuth_station={noise_m: 1}",), "the ground station"),
        ("altimeter", ("altimeter={}",), "the sensor"),
        ("R07", (GLONASS,), "a satellite"),
        ("X01", ("sky={source: directions, directions: [{azimuth_deg: 0, elevation_deg: 5}]}",), "a satellite"),
        ("gps", (), "all satellites of GPS"),
        ("all", (), "all sources of that kind"),
        ("beacons", (), "all sources of that kind"),
        ("pseudolites", (), "all sources of that kind"),
    ],
)
def test_no_source_has_the_name_of_another(source: str, name: str, settings: tuple[str, ...], whose: str) -> None:
    """The key of the name is refused, whatever is simulated; other systems' satellites are not there."""
    with pytest.raises(InputError) as caught:
        read(SCENARIOS / "landing.yaml", (*settings, source.replace("NAME", name)))
    assert f"{OF[source]}: '{name}' is also the name of {whose}: give one" in str(caught.value)
    read(SCENARIOS / "landing.yaml", (GLONASS, source.replace("NAME", "G07")))


@pytest.mark.parametrize(
    ("sources", "key", "whose"),
    [
        ((PSEUDOLITES.replace("NAME", "one"), BEACONS.replace("NAME", "one")), OF[BEACONS], "a pseudolite"),
        ((PSEUDOLITES.replace("NAME", "B1"), BEACONS.replace("NAME", "one")), "beacons.sites.0", "a pseudolite"),
        (("pseudolites.count=1", BEACONS.replace("NAME", "PL1")), OF[BEACONS], "a pseudolite"),
        ((BEACONS.replace("NAME", "one"), JAMMER.replace("NAME", "one")), OF[JAMMER], "a beacon"),
        (("pseudolites.count=1", JAMMER.replace("NAME", "PL1")), OF[JAMMER], "a pseudolite"),
    ],
)
def test_pseudolites_beacons_and_jammers_have_names_of_their_own(
    sources: tuple[str, ...], key: str, whose: str
) -> None:
    """Given names and those that navsim gives."""
    with pytest.raises(InputError) as caught:
        read(SCENARIOS / "landing.yaml", sources)
    assert f"{key}: '" in str(caught.value)
    assert f"' is also the name of {whose}: give one" in str(caught.value)


def test_the_line_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    text = (SCENARIOS / "landing_ils.yaml").read_text(encoding="utf-8")
    sites = "sites:\n    - {s_m: 90, l1_m: 900}\n    - name: dme\n      s_m: -90\n      l1_m: 900"
    file.write_text(text.replace("pseudolites: {count: 0}", f"pseudolites:\n  {sites}"), encoding="utf-8")
    line = file.read_text(encoding="utf-8").splitlines().index("    - name: dme") + 1
    with pytest.raises(InputError) as caught:
        read(file)
    assert f"{file}:{line}" in str(caught.value)
    assert "pseudolites.sites.1.name: 'dme' is also the name of the ground station" in str(caught.value)
