"""Satellite systems: their properties, declared once for simulation, files and positioning.

A new system needs an entry here, its design constellation in `gnss/constellations/nominal.py`, and room for its clock
(`gnss.dop.MAX_CLOCKS`). Its messages in files need a reader in `formats/rinex_nav.py` and a writer in
`formats/rinex_write.py`.

Sources:

- [1] IS-GPS-200, sections 3.3.1 (carrier, chips), 20.3.3.4.3 (constants of the orbit).
- [2] GLONASS ICD, navigational radiosignal in bands L1, L2, edition 5.1 (2008), sections 3.3.1 (channels), 3.3.2.1
  (chips), appendix 3 (constants of the orbit).
- [3] RINEX 4.02 (2024), tables of letters, time systems, observation codes and messages; RINEX 2.11 (2007).
- [4] NMEA 0183 version 4.11 (talkers).
- [5] CelesTrak's files of navigation satellites (gps-ops, glo-ops, galileo, beidou, sbas, gnss): titles of each system.
- [6] Galileo OS SIS ICD (carrier, chips, constants of the orbit).
- [7] BeiDou SIS ICD, open service signal B1I (the same, and the axes of geostationary satellites).
- [8] IS-QZSS-PNT.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True)
class System:
    """A satellite system, for receivers of its civil L1 signal."""

    name: str
    """Name in scenarios and results, and of its receiver clock."""
    title: str
    """Name in headers of files and in messages."""
    letter: str
    """Letter of its satellites in files."""
    slots: int
    """Number of slots if satellites are numbered by slots, else 0."""
    highest: int
    """Largest satellite number in files."""
    carrier: float
    """Carrier frequency of channel 0, Hz."""
    channel_step: float
    """Hz from channel to channel, 0 if satellites share the carrier."""
    chip_rate: float
    """Chip rate of the ranging code, 1/s."""
    signals: tuple[str, ...]
    """RINEX 3 observation codes, the best first; the simulation uses the first."""
    old_codes: tuple[str, ...]
    """RINEX 2 observation codes, the best first."""
    message: str
    """Navigation message for its orbits, RINEX 4 name."""
    old_file: str
    """Type of RINEX 2 files with its messages."""
    time_system: str
    """RINEX name of the time system in its files."""
    talker: str
    """Talker ID of NMEA sentences."""
    gm: float
    """Gravitational constant for its messages, m3/s2; of GLONASS for almanacs (that for state vectors is in
    `gnss.constellations.glonass_integration`)."""
    earth_rate: float
    """Rate of the Earth likewise, rad/s."""
    called: str
    """Pattern of the titles of its satellites in two-line elements."""
    numbered: str
    """Pattern of titles with a satellite number."""
    other_messages: tuple[str, ...] = ()
    """Its other messages, which are stored separately."""
    tilted: tuple[int, ...] = ()
    """Numbers of satellites whose elements refer to axes tilted by 5 degrees [7]."""

    def satellite(self, number: int) -> str:
        """A satellite's name, such as G07."""
        return f"{self.letter}{number:02d}"

    def has(self, name: str) -> bool:
        """Whether a satellite may have this name: by its number in files.

        If that is its slot, also by its own three-digit number, as in two-line elements.
        """
        number = name[1:]
        if name[:1] != self.letter or not number.isdecimal():
            return False
        if not self.slots:
            return len(number) == 2
        return len(number) == 3 or (len(number) == 2 and 1 <= int(number) <= self.slots)

    def name_in(self, title: str, alone: bool = False) -> str:
        """Name of a satellite in files, such as G07, if a title contains it, else "".

        alone: only at the beginning, as for a satellite whose system is unknown otherwise.
        """
        begins = r"^(?:PRN\s*)?" if alone else r"\b"
        for number in re.findall(rf"{begins}{self.letter}\s?(\d{{1,2}})(?![\w.])", title.upper()):
            if 1 <= int(number) <= self.highest:
                return self.satellite(int(number))
        return ""

    @property
    def numbers(self) -> str:
        """In words, how satellites are named."""
        if not self.slots:
            return f"{self.title} {self.satellite(1)} on"
        return f"{self.title} slots are {self.satellite(1)} to {self.satellite(self.slots)}"

    @property
    def by_channel(self) -> bool:
        """Whether the carrier frequency of a satellite depends on its frequency channel."""
        return self.channel_step != 0.0

    def frequency(self, channel: int) -> float:
        """Carrier frequency of a channel, Hz."""
        return self.carrier + self.channel_step * channel

    @property
    def codes(self) -> tuple[str, ...]:
        """RINEX codes of pseudoranges in L1, the best first."""
        return (*("C" + signal for signal in self.signals), *self.old_codes)

    @property
    def dopplers(self) -> tuple[str, ...]:
        """RINEX codes of Dopplers in L1, the best first."""
        return (*("D" + signal for signal in self.signals), "D1")


GLONASS = System(
    name="glonass", title="GLONASS", letter="R", slots=24, highest=32,
    carrier=1602.0e6, channel_step=0.5625e6, chip_rate=0.511e6, signals=("1C", "1P"), old_codes=("C1", "P1"),
    message="FDMA", old_file="G", time_system="GLO", talker="GL", gm=398600.4418e9, earth_rate=7.292115e-5,
    called=r"\bGLONASS\b", numbered=r"\bCOSMOS\s+\d+\s+\((\d{3})K?\)",
)  # fmt: skip
GPS = System(
    name="gps", title="GPS", letter="G", slots=0, highest=63,
    carrier=1575.42e6, channel_step=0.0, chip_rate=1.023e6, signals=("1C", "1P", "1W"), old_codes=("C1", "P1"),
    message="LNAV", old_file="N", time_system="GPS", talker="GP", gm=3.986005e14, earth_rate=7.2921151467e-5,
    called=r"\bGPS\b|\bNAVSTAR\b", numbered=r"\(PRN\s+0*(\d{1,2})\)",
)  # fmt: skip

GALILEO = System(
    name="galileo", title="Galileo", letter="E", slots=0, highest=36,
    carrier=1575.42e6, channel_step=0.0, chip_rate=1.023e6, signals=("1C", "1X", "1B"), old_codes=("C1",),
    message="INAV", old_file="", time_system="GAL", talker="GA", gm=3.986004418e14, earth_rate=7.2921151467e-5,
    called=r"\bGSAT0\d{3}\b|\bGALILEO\b|\bGIOVE\b", numbered=r"\(PRN\s+E(\d{2})\)", other_messages=("FNAV",),
)  # fmt: skip
BEIDOU = System(
    name="beidou", title="BeiDou", letter="C", slots=0, highest=63,
    carrier=1561.098e6, channel_step=0.0, chip_rate=2.046e6, signals=("2I", "2X", "1I"), old_codes=(),
    message="D1", old_file="", time_system="BDT", talker="GB", gm=3.986004418e14, earth_rate=7.292115e-5,
    called=r"\bBEIDOU\b", numbered=r"\(C(\d{2})\)", tilted=(1, 2, 3, 4, 5, 59, 60, 61, 62, 63),
)  # fmt: skip
QZSS = System(
    name="qzss", title="QZSS", letter="J", slots=0, highest=10,
    carrier=1575.42e6, channel_step=0.0, chip_rate=1.023e6, signals=("1C",), old_codes=(),
    message="LNAV", old_file="", time_system="QZS", talker="GQ", gm=3.986005e14, earth_rate=7.2921151467e-5,
    called=r"\bQZS", numbered=r"(?!)",
)  # fmt: skip

SYSTEMS = (GLONASS, GPS, GALILEO, BEIDOU, QZSS)
"""The systems that navsim models."""
USUAL = (GLONASS, GPS)
"""Default systems."""
NAMES = tuple(system.name for system in SYSTEMS)
OWN = "own"
CLOCKS = (*(system.name for system in USUAL), OWN, *(system.name for system in SYSTEMS if system not in USUAL))
"""Time scales of sources, one for each system and one other, in the order of their numbers. Each one in use costs a fix
one unknown."""
BY_LETTER = {system.letter: system for system in sorted(SYSTEMS, key=lambda system: system.letter)}
"""The systems in the order of their letters, which is that of files."""


def first_time_scale(scales: Collection[str]) -> str:
    """First of the sources' time scales in the order of `SYSTEMS`; their own if there is none."""
    return next((name for name in NAMES if name in scales), OWN)


LETTERS = "GRECJIS"
"""Letters of satellites in files, those of systems that navsim does not model too [3]."""
_STRANGERS = {
    "SBAS": r"/PRN\s*\d{3}\)|\b(WAAS|EGNOS|MSAS|GAGAN|SDCM|KASS|SBAS)\b|^S\d{2}$",
    "NavIC": r"\bIRNSS\b|\bNVS-\d|^I\d{2}$",
}
TITLES = (
    "GPS BIIR-2 (PRN 13)", "COSMOS 2456 (730)", "GSAT0210 (PRN E01)", "BEIDOU-3 M1 (C19)", "QZS-2",
    "G13, R07, E01, C19, J02",
)  # fmt: skip
"""Examples of titles of two-line elements that identify the system: those of CelesTrak [5], then names as in files."""
UNTITLED, UNKNOWN = "", "unknown"


def system_of(title: str) -> str:
    """System of a satellite from its title in two-line elements [5].

    A name of `SYSTEMS`, that of another system, `UNKNOWN`, or `UNTITLED` without a title.
    """
    if not title:
        return UNTITLED
    called = {system.name: f"{system.called}|{system.numbered}" for system in SYSTEMS} | _STRANGERS
    told = next((name for name, pattern in called.items() if re.search(pattern, title.upper())), UNKNOWN)
    return next((s.name for s in SYSTEMS if told == UNKNOWN and s.name_in(title, alone=True)), told)
