"""White noise of recorded sensors as a standstill shows it, which no disagreement of the fixes inflates."""

from __future__ import annotations

import numpy as np

from navsim.formats.recorded_data import Fixes, Samples
from navsim.replays.alignment import Search, Standstill, find_standstill
from navsim.statistics.allan import fit, spectra


def standstills(samples: Samples, fixes: Fixes, wanted: Search) -> list[Standstill]:
    """All standstills of a recording. Fixes' times are those of validity, all fixes with velocities."""
    out: list[Standstill] = []
    begin, last = float(samples.time[0]), float(samples.time[-1])
    while (rest := find_standstill(samples, fixes, begin, last, wanted)) is not None:
        out.append(rest)
        begin = rest.end
    return out


def white_noise(samples: Samples, rests: list[Standstill], of: str) -> tuple[float, str] | None:
    """Density of the white noise in the quietest standstill, rad/sqrt(s) or m/s/sqrt(s), mean of three axes, and where
    it is from. None where no standstill shows it. An engine that idles adds to it. of: rate or force."""
    found = []
    for rest in rests:
        piece = samples.between(rest.begin, rest.end)
        values = getattr(piece, of)
        if np.all(np.ptp(values, axis=0) > 0.0):  # else one digit of the log is more than the noise
            step = float(piece.time[-1] - piece.time[0]) / (piece.time.size - 1)
            term = fit(spectra(values, step)[-1]).white
            found += [(term.value, f"at rest from {rest.begin:.1f} to {rest.end:.1f} s")] if term.held else []
    return min(found, default=None)
