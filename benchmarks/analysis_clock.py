"""A covariance analysis each time a line comes in, by whatever navsim is found; the answer is how long it took, s.

Arguments: a scenario, then settings. Said first: which navsim it is. It names only what the version before has too.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import navsim
from navsim.landing.study import covariance_analysis, prepare
from navsim.scenario.load import read

case = prepare(*read(Path(sys.argv[1]), sys.argv[2:]))
covariance_analysis(case)
print(navsim.__file__, flush=True)
for _ in sys.stdin:
    start = time.perf_counter()
    covariance_analysis(case)
    print(time.perf_counter() - start, flush=True)
