"""The paper's Tables 1 and 2: the published figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """One case: number of pseudolites, S and L1 of Table 1 (m), and what Table 2 prints, None where it is silent.

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
    Row(0, None, None, (3.67, 1.33, 3.42), (5.74, 14.72), 1.004),
    Row(1, 50.0, 4000.0, (2.98, 1.08, 2.77), (4.63, 11.88), None),
    Row(1, 200.0, 5000.0, (2.86, 1.03, 2.66), (4.52, 11.61), 0.9798),
    Row(1, 500.0, 5000.0, None, None, None),
    Row(1, 1000.0, 5000.0, (2.84, 1.03, 2.64), (4.5, 11.54), None),
    Row(2, 50.0, 4000.0, (2.52, 0.91, 2.35), (3.92, 10.06), None),
    Row(2, 200.0, 5000.0, (2.38, 0.86, 2.22), (3.78, 9.69), None),
    Row(2, 1000.0, 5000.0, (2.2, 0.8, 2.05), (3.61, 9.27), 0.8573),
)
"""Tables 1 and 2 of the paper, as `landing.md` gives them."""
PUBLISHED = tuple(i for i, row in enumerate(ROWS) if row.dops is not None)
PUBLISHED_DOPS = np.array([ROWS[i].dops for i in PUBLISHED])
PUBLISHED_SKO = np.array([ROWS[i].sko for i in PUBLISHED])
