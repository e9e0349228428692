"""Prediction of the rest of a recording from its first part, and its score against what followed.

The noise is tuned on the first part alone. There the filter states a sigma for each innovation in motion, and for the
drift at the end of each simulated outage. The prediction for a quantity is the mixture of these normal distributions:
half of the later values, and 95 % of them, should be within its quantiles. It is written before the rest is read.

Successive values are correlated, so the interval of a share counts effectively independent values only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import navsim
from navsim.filter.estimate import FILTER_KINDS
from navsim.formats.recorded_data import Fixes
from navsim.replays import flight as replay
from navsim.replays.findings import HELD, NOT_GAUSSIAN, TOO_LARGE, TOO_SMALL
from navsim.replays.motion import in_motion
from navsim.replays.reading import ReplayError
from navsim.replays.recorded_flight import RecordedFlight
from navsim.replays.result_groups import drift_in_outage, of_outages
from navsim.replays.scenario import Replay
from navsim.replays.study import Recording
from navsim.replays.tuning import POSITION_RATIO, SETTINGS, Tuning, tune
from navsim.results import files
from navsim.results.atomic_write import write_atomically
from navsim.results.builder import ResultBuilder
from navsim.runner.job import OptionError
from navsim.runner.statistics import share_interval
from navsim.statistics import normal
from navsim.statistics.consistency import effective_count

SHARES = (50, 95)
"""Shares of the predicted bands, %."""
LENGTHS = (5.0, 10.0, 30.0)
"""Lengths of the simulated outages, s, if the log has none."""
MOST_OUTAGES = 20
"""Outages of each length, in the first part and in the rest."""
LEAST = 2
"""Least number of values in the first part for a prediction."""
DOUBT = 0.0005
"""Probability beyond each end of the interval of a share, outside which a prediction has failed: two-sided 99.9 %."""
SETTLED = 20.0
"""Time after the alignment from which on innovations and outages count, s."""
_LARGEST_FILE = 1 << 20

Values = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""By quantity: values (n, k) and their sigmas (n, k), in order of time."""


@dataclass(frozen=True)
class Prediction:
    """A prediction as the file has it. The digest is the SHA-256 of its content."""

    content: Mapping[str, Any]

    @property
    def digest(self) -> str:
        return hashlib.sha256(_canonical(self.content)).hexdigest()

    def write(self, path: Path) -> None:
        """Write the prediction with its digest. Raises OSError."""
        text = json.dumps({"sha256": self.digest, "prediction": self.content}, indent=1)
        write_atomically(path, text.encode())

    @classmethod
    def read(cls, path: Path) -> Prediction:
        """Raises OptionError for a file that is no prediction, or was changed."""
        try:
            given = json.loads(files.content(path, _LARGEST_FILE))
            found, digest = cls(given["prediction"]), given["sha256"]
        except FileNotFoundError:
            raise OptionError(f"--bet {path}: no such file, and no time in s") from None
        except OSError as error:
            raise OptionError(f"--bet {path}: cannot be read: {error.strerror or error}") from None
        except (ValueError, KeyError, TypeError):
            raise OptionError(f"--bet {path}: expected a time in s, or a prediction that --bet has written") from None
        if digest != found.digest:
            raise OptionError(
                f"--bet {path}: it was changed: its content has the checksum {found.digest}, not {digest}"
            )
        return found

    def begin(self, fixes: Fixes) -> float:
        """Time, s, after which a recording with these fixes is new: the end of the first part, or any time of another
        recording."""
        return float(self.content["until_s"]) if _first_fix(fixes) == self.content["first_fix"] else -np.inf

    def tuning(self, recording: Recording) -> Tuning:
        """The settings of the first part for a recording, instead of those that its own innovations would give.

        Raises ReplayError for a prediction of a filter with the other coupling.
        """
        if missing := set(recording.tuned) - set(self.content["settings"]):
            raise ReplayError(f"--bet: the prediction is of a filter with another coupling, without {min(missing)}")
        settings = np.array([self.content["settings"][name] for name in recording.tuned])
        then, now = np.array(self.content["usual_accuracy"], dtype=float), recording.fixes.usual_accuracy
        # noise counts in that of a usual fix, whose accuracy the receiver may claim otherwise now
        position, _, velocity = np.where(np.isfinite(now / then), now / then, 1.0)
        settings[:2] *= velocity
        settings[POSITION_RATIO] *= position / velocity
        return Tuning(settings, np.zeros(SETTINGS, bool), origin="as predicted")


def predict(
    recording: Recording, scenario: Replay, until: float, done: Callable[[int], None] = lambda _: None
) -> Prediction:
    """Prediction from a first part of a recording up to `until`, s.

    scenario: has the lengths of the outages. Raises ReplayError if there is no motion in that part.
    """
    settings = tune(recording, done).settings
    lengths = sorted({length for outage in scenario.outages for length in outage.duration_s}) or LENGTHS
    seen = _values(recording, settings, -np.inf, lengths, recording.moving_speed)
    bands = {
        name: [_quantile(sigma, share / 100.0) for share in SHARES]
        for name, (_, sigma) in seen.items()
        if len(sigma) >= LEAST
    }
    if not bands:
        raise ReplayError(f"--bet: no fixes in motion up to {until:.12g} s predict what follows; give a later time")
    usual = [float(value) if np.isfinite(value) else None for value in recording.fixes.usual_accuracy]
    return Prediction({
        "navsim": navsim.__version__, "until_s": until, "first_fix": _first_fix(recording.fixes),
        "moving_m_s": recording.moving_speed, "lengths_s": list(lengths),
        "settings": dict(zip(recording.tuned, settings.tolist(), strict=True)), "usual_accuracy": usual,
        "shares_percent": list(SHARES), "bands": bands,
    })  # fmt: skip


def write_score(draft: ResultBuilder, prediction: Prediction, recording: Recording) -> None:
    """Shares of the values of a recording after the first part that lie within the predicted bands."""
    content, settings = prediction.content, prediction.tuning(recording).settings
    seen = _values(recording, settings, prediction.begin(recording.fixes), content["lengths_s"], content["moving_m_s"])
    rows = []
    for name, bands in content["bands"].items():
        values = np.abs(seen[name][0])
        count = effective_count(values)
        score, verdict = np.full((len(SHARES), 3), np.nan), "no values"
        if values.size:
            inside = [float(np.mean(values <= band)) for band in bands]
            score = np.array([share_interval(share * count, count) for share in inside])
            verdict = verdict_of(inside, count)
        rows.append((values.size, count, np.column_stack([bands, score]), verdict))
    draft.put("/summary/quantity", np.array(list(content["bands"]), dtype=object))
    draft.put("/summary/bet_until", np.float64(content["until_s"]), {"sha256": prediction.digest})
    draft["/summary/bet_values"] = np.array([size for size, *_ in rows])
    draft["/summary/bet_independent"] = np.array([count for _, count, *_ in rows])
    draft["/summary/bet_verdict"] = np.array([verdict for *_, verdict in rows], dtype=object)
    for i, share in enumerate(SHARES):
        for j, name in enumerate(("band", "share", "low", "high")):
            draft[f"/summary/bet_{name}_{share}"] = np.array([each[i, j] for _, _, each, _ in rows])


def verdict_of(inside: Sequence[float], count: float) -> str:
    """Whether shares of so many independent values within the bands of `SHARES` contradict the prediction."""
    ends = [share_interval(share * count, count, DOUBT)[1:] for share in inside]
    fewer = any(high < due / 100.0 for (_, high), due in zip(ends, SHARES, strict=True))
    more = any(low > due / 100.0 for (low, _), due in zip(ends, SHARES, strict=True))
    return NOT_GAUSSIAN if fewer and more else TOO_SMALL if fewer else TOO_LARGE if more else HELD


def _values(
    recording: Recording, settings: np.ndarray, begin: float, lengths: Sequence[float], moving: float
) -> Values:
    """Innovations in motion after `begin`, s, and drifts in outages of these lengths, s, with values of `tuned`.

    moving: speed, m/s, from which on a fix is in motion.
    """
    kind = FILTER_KINDS[recording.scenario.filter.kind]
    flight, design = recording.flight(settings), of_outages(recording.design(settings, kind))
    noise = recording.fix_sigma(settings), recording.range_sigma(settings)
    flown = replay.fly(flight, design, noise[0], np.empty(0), range_sigma=noise[1])
    first = max(begin, float(flight.imu_time[0]) + SETTLED)
    moves = in_motion(flight, moving) & (flight.arrival > first)
    out = {}
    for name, columns in (
        ("position north, east, m", [0, 1]), ("position down, m", [2]), ("velocity north, east, m/s", [3, 4]),
        ("velocity down, m/s", [5]),
    ):  # fmt: skip
        pair = flown.innovation[:, columns], flown.innovation_sigma[:, columns]
        there = moves & np.isfinite(pair[0]).all(axis=1) & np.isfinite(pair[1]).all(axis=1)
        out[name] = pair[0][there], pair[1][there]
    for length in lengths:
        starts = np.arange(first, flight.arrival[-1] - length, length)
        spans = [(start, start + length) for start in starts if _all_move(flight, moves, start, start + length)]
        spans = spans[:: -(-len(spans) // MOST_OUTAGES) or 1]
        drifts = [drift_in_outage(flight, design, *noise, span) for span in spans]
        known = np.array([np.stack(each)[:, :2] for each in drifts if each is not None]).reshape(-1, 2, 2)
        out[f"drift north, east after {length:g} s, m"] = known[:, 0], known[:, 1]
    return out


def _all_move(flight: RecordedFlight, moves: np.ndarray, start: float, end: float) -> bool:
    """Whether there are fixes between two times, s, all of them in motion."""
    there = (flight.arrival >= start) & (flight.arrival <= end)
    return bool(there.any() and moves[there].all())


def _quantile(sigma: np.ndarray, share: float) -> float:
    """Size below which this share of a mixture of normal distributions lies, all of mean zero and equally likely."""
    from scipy.optimize import brentq

    widest = float(sigma.max()) * normal.quantile(0.5 + 0.5 * share)
    return float(brentq(lambda x: 1.0 - share - normal.exceedance(x, 0.0, sigma).mean(), 0.0, 1.001 * widest))


def _first_fix(fixes: Fixes) -> list[float]:
    """Time, s, latitude and longitude, rad, of the first fix, by which a recording is known."""
    return [float(fixes.time[0]), *fixes.llh[0, :2].tolist()]


def _canonical(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
