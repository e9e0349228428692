"""Probabilities that a pseudolite is faulty, by type of monitoring.

A source fails at a rate and stays faulty until that is detected: prior = rate * (mean time a fault lives + exposure);
rate 1e-3 an hour, 150 s of an approach. Monitored: shut down within 6 s; unmonitored: found after an hour. No standard
has such figures; the rate is a choice.

Source of the form: WG-C ARAIM Algorithm Description Document, multiplier 1 + T_exp / MFD; `docs/theory/integrity.md`.
"""

from __future__ import annotations

_RATE, _EXPOSURE = 1e-3 / 3600.0, 150.0
PSEUDOLITES = {"monitored": _RATE * (6.0 + _EXPOSURE), "unmonitored": _RATE * (3600.0 + _EXPOSURE)}
