"""The page of filter kinds: pieces are computed once, and its numbers are those of the runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.filter.states import N_BASE, PHI_D
from tests.helpers import load_script

consistency: Any = load_script("filter_consistency")
TIME = np.array([10.0, 20.0, 59.0])
CLOCK = np.linspace(0.0, 60.0, 7)
LABELS, KINDS = ["landing", "s_turn"], ["gaussian-sum", "eskf"]


def drawn(runs: int, seed: int, scale: float = 1.0) -> Any:
    """What runs with Gaussian errors come to, heading by `scale` larger than its sigma of 0.1 rad."""
    random = np.random.default_rng(seed)
    ratio = random.standard_normal((runs, TIME.size, N_BASE))
    ratio[..., PHI_D] *= scale
    heading = np.array([(ratio[..., PHI_D] ** 2).sum(axis=0), np.full(TIME.size, runs), np.full(TIME.size, runs)])
    return consistency.Found(
        TIME, (ratio**2).sum(axis=0), (ratio**4).sum(axis=0), 0.01 * heading, CLOCK, np.full(CLOCK.size, float(runs)),
        random.chisquare(N_BASE, runs) / N_BASE, np.zeros(runs), np.abs(ratio[..., PHI_D]).max(axis=1),
    )  # fmt: skip


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[Any, ...]]:
    """Pieces that were computed, none of them by flying."""
    pieces: list[tuple[Any, ...]] = []

    def fly(case: Any, seed: int, first: int, runs: int) -> Any:
        pieces.append((*case, seed, first, runs))
        if len(pieces) == 3:
            raise KeyboardInterrupt
        return drawn(runs, seed + first)

    monkeypatch.setattr(consistency, "STORE", tmp_path)
    monkeypatch.setattr(consistency, "ready", lambda label, kind: (label, kind))
    monkeypatch.setattr(consistency, "fly", fly)
    return pieces


def test_nothing_is_computed_twice(flown: list[tuple[Any, ...]]) -> None:
    """A stop in the third piece loses that piece alone; the row has all its runs afterwards, and no more."""
    wanted = list(consistency.pieces(LABELS, KINDS, (1, 2), 150))
    assert len(wanted) == len(set(wanted)) == 16
    assert {first for *_, first, _ in wanted[:8]} == {0}, "the first runs of every case come before further ones"
    with pytest.raises(KeyboardInterrupt):
        consistency.compute(wanted)
    consistency.compute(wanted)
    assert flown[2] == flown[3]
    assert len(flown) == 17
    consistency.compute(wanted)
    assert len(flown) == 17
    row = consistency.together([piece for piece in wanted if piece[:2] == ("landing", "eskf")])
    assert row.runs == 300
    assert consistency.finished("landing", "eskf") is None, "other seeds than those of the page"


def test_a_row_of_the_page_has_as_many_runs_of_each_seed(flown: list[tuple[Any, ...]]) -> None:
    flown += [(), (), ()]
    first, *others = consistency.SEEDS
    consistency.compute(list(consistency.pieces(LABELS, KINDS, consistency.SEEDS, 100)))
    consistency.compute(list(consistency.pieces(LABELS, KINDS, others, 200)))
    assert consistency.finished("landing", "eskf").runs == 300
    consistency.compute(list(consistency.pieces(LABELS, KINDS, [first], 200)))
    assert consistency.finished("landing", "eskf").runs == 600


def test_kinds_are_compared_by_as_many_runs(flown: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch) -> None:
    """The default has twice the runs of another kind: one row of all, one of the first; they differ."""
    flown += [(), (), ()]
    monkeypatch.setattr(consistency, "TABLE", consistency.STORE / "rows.csv")
    monkeypatch.setattr(consistency, "probe", dict)
    for kind, runs in zip(KINDS, (200, 100), strict=True):
        consistency.compute(list(consistency.pieces(LABELS[:1], [kind], consistency.SEEDS, runs)))
    rows = consistency.whole_rows("`abc` (today)")
    assert consistency.read_table() == rows
    assert [(row.kind, row.runs) for row in rows] == [("gaussian-sum", 600), ("gaussian-sum", 300), ("eskf", 300)]
    everything, alike = consistency.most_runs(rows), consistency.most_runs(rows, least=True)
    assert [row.runs for row in everything] == [600, 300]
    assert alike == rows[1:]
    assert rows[0].nees != rows[1].nees


def test_position_and_velocity_are_judged_alone() -> None:
    """Heading is 30 % too large: position and velocity are as asked for."""
    row = consistency.Row.of("landing", "eskf", drawn(6000, 1, 1.3))
    assert row.outside()
    assert not row.outside(motion=True)
    assert row.motion_z_at.startswith(("position", "velocity"))
    assert not row.outside(0.0, motion=True)


def test_numbers_of_a_row() -> None:
    """z, its sampling, and what is outside of the limits, of parts put together; heading is 30 % too large."""
    row = consistency.Row.of("landing", "eskf", drawn(3000, 1, 1.3).plus(drawn(3000, 2, 1.3)))
    assert row.heading_z == pytest.approx(1.3, abs=4 * row.heading_z_sampling)
    assert row.heading_z_sampling == pytest.approx(1.3 / np.sqrt(2 * 6000), rel=0.1)
    assert row.largest_z_at.startswith("heading")
    assert len(row.outside()) == 1
    assert not row.is_large_enough
    assert row.heading_rms_deg / row.heading_sigma_deg == pytest.approx(row.heading_z, rel=1e-3)
    true = consistency.Row.of("landing", "eskf", drawn(6000, 3))
    assert not true.outside()
    assert true.is_large_enough
    assert true.departure < row.departure
    assert consistency.Row.read(row.cells()) == row


def test_the_page_has_the_rows_of_its_table() -> None:
    """Each case with each kind that flies it, and the figures of the table."""
    rows = consistency.read_table()
    wanted = [(label, kind) for label, study in consistency.studies().items() for kind in study.kinds]
    assert list(dict.fromkeys((row.case, row.kind) for row in rows)) == wanted
    text = consistency.PAGE.path.read_text()
    assert text.startswith("\n".join(consistency.page(rows)))


def test_code_that_a_kind_does_not_run_leaves_its_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Comments change no name of code; the Gaussian sum is in that of the default alone."""
    both = [consistency.code.__wrapped__(kind) for kind in KINDS]
    told = consistency._statements
    monkeypatch.setattr(consistency, "_statements", lambda path: told(path) + str(path.name == "gaussian_sum.py"))
    again = [consistency.code.__wrapped__(kind) for kind in KINDS]
    assert again[0] != both[0]
    monkeypatch.setattr(consistency, "_statements", told)
    assert [consistency.code.__wrapped__(kind) for kind in KINDS] == both


def test_statements_are_without_comments(tmp_path: Path) -> None:
    first, second = tmp_path / "a.py", tmp_path / "b.py"
    first.write_text('"""One."""\nX = 1  # one\n"""The first."""\n')
    second.write_text("X = 1\n")
    assert consistency._statements(first) == consistency._statements(second)
    second.write_text("X = 2\n")
    consistency._statements.cache_clear()
    assert consistency._statements(first) != consistency._statements(second)


def test_every_landing_is_in_the_page_with_its_noise() -> None:
    from tests.conftest import LANDINGS

    studies = consistency.studies()
    assert set(LANDINGS) == {study.name for study in studies.values() if study.label == study.name}
    for name in LANDINGS:
        for factor in ("0.1", "3"):
            label = f"{name}, noise × {factor}"
            assert (label in studies) != (label in consistency.TOO_NOISY)
    assert studies["landing, noise × 3"].settings == ("imu.accelerometer.noise_mg=30",)
