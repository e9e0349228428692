"""Units that the names of keys end with: of scenario files, and of the axes of their results."""

from __future__ import annotations

import re

_UNITS = {
    "deg_h_sqrt_h": "°/h/√h", "mg_sqrt_h": "mg/√h", "deg_h_h": "°/h/h", "mg_h": "mg/h", "deg_h_k": "°/h/K",
    "mg_k": "mg/K", "deg_h_g2": "°/h/g²", "ug_g2": "µg/g²", "deg_h_g": "°/h/g", "ppm_deg_s": "ppm/(°/s)",
    "mrad": "mrad", "ut": "µT", "urad": "µrad", "mm_s": "mm/s", "k_min": "K/min",
    "m_s_sqrt_h": "m/s/√h", "deg_sqrt_h": "°/√h", "conductivity_s_m": "S/m", "deg2_s2": "°²/s²", "deg2": "°²",
    "m_s2": "m/s²", "rad_s": "rad/s", "m_s": "m/s", "1_s": "1/s", "deg_s": "°/s", "deg_h": "°/h", "deg": "°",
    "mg": "mg", "g": "g", "kmh": "km/h", "mhz": "MHz", "db_hz": "dB-Hz", "dbhz": "dB-Hz", "hz": "Hz", "dbw": "dBW",
    "dbm": "dBm", "dbi": "dBi", "db": "dB",
    "ppm": "ppm", "ppb": "ppb", "ns": "ns", "us": "µs", "s": "s", "m": "m", "days": "d", "hours": "h",
    "n_m2": "N/m²", "percent": "%", "chips": "chips", "hpa": "hPa", "k": "K",
}  # fmt: skip
"""Suffix of a key's name and its unit, longer suffixes first."""


def unit_of(key: str) -> str:
    """Unit suffix of the last name in a dotted key, "" for none.

    Item numbers have none, nor their placeholders in lists of keys, nor names that the user gives.
    """
    names = [part for part in key.split(".") if not (part.isdigit() or part in ("N", "NAME"))]
    for end, unit in _UNITS.items():
        if names and re.search(rf"(^|_){end}$", names[-1]):
            return unit
    return ""


def without_unit(name: str) -> str:
    """The name of a key without the unit that it ends with."""
    end = next((end for end in _UNITS if name.endswith(f"_{end}")), "")
    return name.removesuffix(f"_{end}") if end else name
