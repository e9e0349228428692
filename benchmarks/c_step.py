"""The covariance step alone, by navsim's kernels and by `filter_step.c` wherever there is a compiler of C."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measure import STEPS, Job, Line, Plan, alternate, ratios, seconds, timed

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import WIDTH, alloc, as_simd, in_lanes
from navsim.filter import strapdown
from navsim.filter.covariance import NOISE_ACCEL, NOISE_GYRO, gain, joseph, propagate_covariance
from navsim.filter.estimate import in_all_lanes
from navsim.filter.interval import add_step, add_white, allocate_sums, reset_sums, transition
from navsim.filter.states import MAX_MEASUREMENT_SIZE, N_BASE, SENSORS, VEL
from navsim.simulation.flight import exact_start

SOURCE = Path(__file__).resolve().parent / "filter_step.c"
OPTIONS = ("-O3", "-march=native")
EVERY = 100
"""Steps between two updates: 1 Hz."""
VARIANCES = (16.0, 0.04)
"""Of position and velocity fixes, m2, m2/s2."""
TOLERANCE = 1e-9
"""Largest difference between the covariances of C and of navsim, in products of their sigmas."""

Run = Callable[[np.ndarray, int], None]
"""A covariance, in lanes or not, over so many steps, in place."""


@kernel
def one_transition(nav, declared, dtheta, dv, dt, phi):
    """Phi - I over an interval of one step, phi (9, n)."""
    increments, c_nb, mid, inverse = np.zeros(6), np.empty((3, 3)), np.empty(strapdown.MID_N), np.empty((6, 3))
    sums = allocate_sums(nav, declared)
    reset_sums(sums)
    sums.length[0], sums.length[1] = dt, 1.0
    tx, ty, tz, ux, uy, uz = strapdown.compensated(
        nav, False, inverse, dtheta[0], dtheta[1], dtheta[2], dv[0], dv[1], dv[2], dt
    )
    strapdown.step(nav, tx, ty, tz, ux, uy, uz, increments, dt, c_nb, mid)
    add_step(sums.total, sums.decay, sums.row, mid, dt, increments, declared)
    transition(sums, mid, phi)


@kernel
def covariance_steps(p_, phi_, h_, r_, noise, dt, steps, declared, every):
    """P (n, n) over so many steps of one Phi, in place, with an update of six numbers each `every` steps."""
    p, phi, h, r = as_simd(p_), as_simd(phi_), as_simd(h_), as_simd(r_)
    n = p.shape[0]
    a, pht, k, work = (
        alloc(p, (n, SENSORS)),
        alloc(p, (n, MAX_MEASUREMENT_SIZE)),
        alloc(p, (n, MAX_MEASUREMENT_SIZE)),
        alloc(p, (n, MAX_MEASUREMENT_SIZE)),
    )
    s, sums = alloc(p, (MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)), allocate_sums(p, declared)
    reset_sums(sums)
    sums.length[0], sums.length[1] = dt, 1.0
    for step in range(1, steps + 1):
        propagate_covariance(p, phi, n, a)
        add_white(sums, noise[NOISE_GYRO], noise[NOISE_ACCEL], p)
        if step % every == 0:
            gain(p, h, r, MAX_MEASUREMENT_SIZE, pht, s, k)
            joseph(p, h, r, MAX_MEASUREMENT_SIZE, pht, k, work)


def compiled(width: int, folder: Path) -> ctypes.CDLL | None:
    """`filter_step.c` for so many runs side by side; None where no compiler is found."""
    compiler = os.environ.get("CC") or shutil.which("cc")
    if compiler is None:
        return None
    library = folder / f"filter_step_{width}.so"
    flags = [*OPTIONS, "-shared", "-fPIC", f"-DWIDTH={width}"]
    subprocess.run([*compiler.split(), *flags, "-o", str(library), str(SOURCE), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def _pointer(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def lines_of_c(plan: Plan, flight: Any) -> list[Line]:
    """navsim's covariance step against C's. flight: of a landing (`simulation.flight`)."""
    world, declared, noise = flight.shared, flight.model.declared, flight.model.noise[0]
    dt = float(world.imu_time[1])
    phi = np.zeros((SENSORS, N_BASE))
    one_transition(exact_start(world.at_filter).copy(), declared, world.dtheta[0], world.dv[0], dt, phi)
    h = np.eye(MAX_MEASUREMENT_SIZE, N_BASE)
    r = np.diag(np.repeat(VARIANCES, VEL))
    setting = np.array([noise[NOISE_GYRO], noise[NOISE_ACCEL], dt, *VARIANCES])

    def ours(p: np.ndarray, steps: int) -> None:
        lanes = p.ndim == 3
        arrays = (p, *(in_all_lanes(m) if lanes else m for m in (phi, h, r)))
        covariance_steps(*(in_lanes(m) if lanes else m for m in arrays), noise, dt, steps, declared, EVERY)

    def theirs(function: Any) -> Run:
        def run(p: np.ndarray, steps: int) -> None:
            given = in_all_lanes(phi) if p.ndim == 3 else phi
            function(_pointer(p), _pointer(given), _pointer(setting), ctypes.c_long(steps), ctypes.c_long(EVERY))

        return run

    begin = flight.covariance
    with tempfile.TemporaryDirectory() as folder:
        alone, side_by_side = (compiled(width, Path(folder)) for width in (1, WIDTH))
        if alone is None or side_by_side is None:
            return [Line("covariance step against C", (), "no compiler of C (`cc`) is found")]
        runs: dict[str, tuple[Run, bool]] = {
            "navsim": (ours, True),
            "navsim's kernel on one run": (ours, False),
            "C, dense 15×15": (theirs(alone.dense_steps), False),
            "C, by blocks": (theirs(alone.block_steps), False),
            f"C, by blocks, {WIDTH} runs in vectors": (theirs(side_by_side.block_steps), True),
        }
        expected = begin.copy()
        ours(expected, STEPS)
        for name, (run, in_vectors) in runs.items():
            check(name, run, in_all_lanes(begin) if in_vectors else begin.copy(), expected)

        def job(run: Run, in_vectors: bool) -> Job:
            p = in_all_lanes(begin) if in_vectors else begin.copy()
            return timed(lambda: run(p, STEPS))

        jobs = [job(*each) for each in runs.values()]
        took = alternate(plan.rounds(9), *jobs)
    each = {
        name: [s / (WIDTH if in_vectors else 1) for s in taken]
        for (name, (_, in_vectors)), taken in zip(runs.items(), took, strict=True)
    }
    first, *others = each
    return [
        Line(
            f"covariance step alone, {WIDTH} runs at once, against {name}",
            ratios(each[name], each[first]),
            f"{seconds('navsim', each[first], STEPS)}, {seconds('it', each[name], STEPS, ' a step')}",
        )
        for name in others
    ]


def check(name: str, run: Run, p: np.ndarray, expected: np.ndarray) -> None:
    """Raises RuntimeError where another covariance comes out."""
    run(p, STEPS)
    sigma = np.sqrt(np.diagonal(expected))
    off = np.abs((p if p.ndim == 3 else p[..., None]) - expected[..., None]) / np.outer(sigma, sigma)[..., None]
    if not off.max() <= TOLERANCE:
        raise RuntimeError(f"{name}: the covariance differs by {off.max():.1e} sigma2")
