"""Warnings and findings of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_kinds import BEACON
from navsim.filter.records import NOT_USED, REJECTED
from navsim.formats.recorded_data import Fixes, Headings
from navsim.geodesy.attitude import dcm_from_quaternion
from navsim.replays import alignment as aligning
from navsim.replays import flight as replay
from navsim.replays.motion import FASTEST_NEEDED
from navsim.replays.one_way import alike_states, find_far_clocks
from navsim.replays.reading import ReadLog
from navsim.replays.recorded_flight import RecordedFlight
from navsim.replays.scenario import Outage, Replay
from navsim.results.findings import Finding
from navsim.results.notes import CONSISTENT
from navsim.results.result import Result
from navsim.runner.findings import DOUBTED, limit, notes, of_flight, rejected_of
from navsim.scenario_files.base import DEG
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.replays.study import Recording

HELD, TOO_SMALL, TOO_LARGE, NOT_GAUSSIAN = "held", "sigma too small", "sigma too large", "not Gaussian"
"""Verdicts on the prediction of a quantity."""
LARGEST_NIS = 2.0
"""Mean normalised innovation squared of a recorded flight, whose noise is tuned to 1, that is no accident."""
VELOCITY_SIGMA = "times the velocity sigma"
"""End of the origin of a position sigma that is not tuned by itself."""
LARGEST_POSITION_NIS = 1.5
"""The same of positions whose sigma follows from that of velocities."""
MANY_REJECTED = 0.05
"""Fraction of rejected fixes, or ranges, beyond which a finding is reported."""
PAUSE = 3.0
"""Shortest reported time without fixes, s, if it is longer than `USUAL` intervals."""
USUAL, TOLD = 5.0, 5
"""Length of a pause in usual intervals; number of pauses of one kind that are reported individually."""
UNFLOWN = 10.0
"""Shortest part of a recording that is missed when it is not flown, s."""
SIDEWAYS, OFF_COURSE = 60.0 * DEG, 10.0
"""Angle between nose and course that wind and sideslip explain, rad, and for how long more is no accident, s."""


def findings(
    recording: Recording, result: Result, withheld: np.ndarray, flight: RecordedFlight, flown: replay.Replayed
) -> list[Finding]:
    """Findings for the user; withheld: (e,) bool, fixes withheld by outages."""
    out = notes(recording.warnings)
    broken = {begin for begin, _ in flight.breaks}
    for first, length in flight.gaps:
        begin = float(flight.imu_time[first])
        if begin not in broken:
            text = f"no samples for {digits(length)} s from {begin:.3f} s on; the covariance was widened"
            out.append(Finding("gap", text, (), 1, 1, 1, begin))
    out += _pauses(flight) + [_of_lost(one) for one in flown.lost] + find_outliers(flight, flown)
    if recording.scenario.checks != "off":
        out += find_off_course(flight, flown)
    out += of_flight(result, None, withheld | ~flown.flown)
    for aid, own in zip(flight.aids, flown.aids, strict=True):
        if aid.kind == BEACON:
            rejected, weighed = int(np.sum(own.status == REJECTED)), int(np.sum(own.status != NOT_USED))
            out += rejected_of(aid.name, rejected, weighed, recording.scenario.filter.gate.probability)
    if recording.scenario.clocks is not None and recording.beacons is not None:
        out += find_far_clocks(flight, flown, recording.beacons.sources.names, recording.scenario.clocks)
        out += alike_states(flown, list(result["/filter/state"]))
    tied = _tied(result)
    untuned = recording.scenario.tuning == "none" and "/summary/bet_verdict" not in result
    calm = _too_calm(result) if untuned else []
    return out + _inconsistent(result, of_positions=not tied) + tied + calm + failed_prediction(result)


def _tied(result: Result) -> list[Finding]:
    """Finding of positions that scatter more than the sigma that follows from that of velocities.

    Their sigma may be too large: receivers' positions wander, which innovations do not show.
    """
    if "/tuning/position_sigma_horizontal" not in result:
        return []
    origin = str(result.variables["/tuning/position_sigma_horizontal"].attributes["origin"])
    group = list(result["/summary/motion"]).index("moving")
    nis = [float(result[f"/summary/nis_{name}"][group]) for name in ("position", "velocity")]
    if not origin.endswith(VELOCITY_SIGMA) or not nis[0] > LARGEST_POSITION_NIS:
        return []
    names = ("/tuning/position_sigma_horizontal", "/tuning/position_sigma_vertical")
    sigma = ", ".join(f"{float(result[name]) * nis[0] ** 0.5:.2g}" for name in names)
    give = f"gnss.position_sigma_m: [{sigma}]"
    if "/summary/bet_until" in result:  # values of the whole recording would predict nothing
        until = float(result["/summary/bet_until"])
        give = f"gnss.position_sigma_m as a replay of the predicting part says (--set end_s={until:.12g})"
    text = (
        f"positions have a NIS of {nis[0]:.2f} in motion, velocities of {nis[1]:.2f}, where 1 is due: the position "
        f"sigma is {origin}, and positions scatter more. Give columns with the receiver's accuracies, or "
        f"{give}"
    )
    degrees = result["/innovations/degrees"]
    by_chance = limit(3.0 * float(result["/summary/motion_fixes"][group])) / DOUBTED
    against = (CONSISTENT,) if nis[0] > by_chance else ()
    return [Finding("position_noise", text, against, int(degrees.astype(bool).sum()), degrees.size)]


def failed_prediction(result: Result) -> list[Finding]:
    """Finding of quantities that contradict the prediction of the first part; larger ones violate `CONSISTENT`."""
    if "/summary/bet_verdict" not in result:
        return []
    verdicts = [str(each) for each in result["/summary/bet_verdict"]]
    names = [str(name).rpartition(", ")[0] for name in result["/summary/quantity"]]  # without the unit
    wrong = {
        verdict: [name for name, each in zip(names, verdicts, strict=True) if each == verdict]
        for verdict in (TOO_SMALL, NOT_GAUSSIAN, TOO_LARGE)
    }
    said = [f"{verdict} for {' and '.join(of)}" for verdict, of in wrong.items() if of]
    if not said:
        return []
    text = f'the prediction failed: {"; ".join(said)} (99.9 %, table "Predicted from the part up to ...")'
    against = (CONSISTENT,) if wrong[TOO_SMALL] or wrong[NOT_GAUSSIAN] else ()
    return [Finding("prediction", text, against, sum(map(len, wrong.values())), len(verdicts))]


def _inconsistent(result: Result, of_positions: bool = True) -> list[Finding]:
    """Finding of innovations whose squares exceed `LARGEST_NIS` by more than their number explains.

    It names the group of fixes where they exceed it most. Positions and velocities are also judged alone, since small
    innovations of one would hide large ones of the other.

    `of_flight` reports larger ones for their size alone. of_positions: whether positions are judged by themselves.
    """
    degrees = result["/innovations/degrees"]
    if result["/summary/nis"][0] > limit(float(degrees.sum())):
        return []
    both = result["/summary/degrees_of_freedom"]
    positions = np.minimum(3 * result["/summary/motion_fixes"], both)
    judged = {"": both, "_velocity": both - positions, "_position": positions * of_positions}
    found = [
        (float(nis) / (LARGEST_NIS * limit(float(own)) / DOUBTED), float(nis), name, str(group))
        for name, freedom in judged.items()
        for group, own, nis in zip(result["/summary/motion"], freedom, result[f"/summary/nis{name}"], strict=True)
        if own and np.isfinite(nis)
    ]
    excess, nis, name, group = max(found, default=(0.0, 0.0, "", ""))
    if not excess > 1.0:
        return []
    key = "position_sigma_m" if name == "_position" else "velocity_sigma_m_s, or leave it out so that it is tuned"
    text = (
        f"the {name[1:]}{name and ' '}innovations of {group} fixes have a NIS of {nis:.2f} per degree of freedom where "
        "1 is due. The filter trusts its fixes and sensors too much, and its sigmas are too small. Give gnss." + key
    )
    return [Finding("innovations", text, (CONSISTENT,), int(degrees.astype(bool).sum()), degrees.size)]


def _too_calm(result: Result) -> list[Finding]:
    """Finding of untuned noise with which the innovations in motion are far smaller than predicted."""
    moving = list(result["/summary/motion"]).index("moving")
    nis, freedom = (float(result[f"/summary/{name}"][moving]) for name in ("nis", "degrees_of_freedom"))
    if not freedom or not nis * LARGEST_NIS * limit(freedom) < DOUBTED:
        return []
    text = (
        f"the innovations in motion have a NIS of {nis:.2f} per degree of freedom where 1 is due: the noise is too "
        "large, and so are the sigmas. Let navsim tune it (`tuning: likelihood`), or give less"
    )
    degrees = result["/innovations/degrees"]
    return [Finding("innovations", text, (), int(degrees.astype(bool).sum()), degrees.size)]


def _pauses(flight: RecordedFlight) -> list[Finding]:
    """The finding of times without fixes."""
    solved = Fixes(flight.arrival, flight.llh, flight.velocity).take(np.isfinite(flight.llh[:, 0]))
    if solved.time.size < 2:
        return []
    pauses = _unusual_pauses(solved)
    if not pauses.size:
        return []
    each = [f"{end - begin:.1f} s from {begin:.1f} s on" for begin, end in pauses]
    text = f"no fixes for {_few(each)}: the filter goes by its inertial sensors alone"
    return [Finding("pauses", text, (), len(each), len(each), 1, float(pauses[0, 0]))]


def _unusual_pauses(fixes: Fixes) -> np.ndarray:
    """Begin and end, s, of the pauses of fixes (k, 2) that a user is told of."""
    return fixes.pauses(max(PAUSE, USUAL * float(np.median(np.diff(fixes.time)))))


def _few(each: list[str]) -> str:
    """Some texts as one, and how many more there are."""
    more = f", and {len(each) - TOLD} more" if len(each) > TOLD else ""
    return ", ".join(each[:TOLD]) + more


def _of_lost(lost: replay.LostSpan) -> Finding:
    """The finding of a time at which the output is unusable."""
    if lost.why == replay.GAP:
        text = f"no samples for {lost.end - lost.begin:.1f} s, longer than the attitude survives: there is no output"
    else:
        jump = float(np.linalg.norm(lost.jump))
        apart = f", {digits(jump)} m apart at the end" if np.isfinite(jump) else " twice, and the fixes came back"
        text = f"the filter contradicted its fixes{apart}: its output is unusable"
    after = "nothing after it is replayed, since no alignment was found" if lost.ended else "then the filter restarts"
    text += f" from {lost.begin:.1f} to {lost.end:.1f} s; {after}"
    return Finding("lost", text, (CONSISTENT,), 1, 1, 1, lost.begin)


def find_outliers(flight: RecordedFlight, flown: replay.Replayed) -> list[Finding]:
    """The finding of fixes, or ranges, that the gate rejected, but those of times at which the filter was lost."""
    when = flight.arrival[: flown.rejected.size]
    away = np.zeros(when.size, bool)
    for one in flown.lost:
        away |= (when >= one.begin) & (when <= one.end)
    rejected = np.where(away, 0, flown.rejected)
    count = int(rejected.sum())
    if not count:
        return []
    tight = flown.range_status.size > 0
    of = int((flown.range_status != NOT_USED).sum() if tight else (flown.status != NOT_USED).sum())
    rows = np.flatnonzero(rejected)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    spans = [f"{when[r[0]]:.1f} s" if r.size == 1 else f"{when[r[0]]:.1f} to {when[r[-1]]:.1f} s" for r in runs]
    lost = int(flown.rejected.sum()) - count
    text = f"{count} of {of} {'ranges' if tight else 'fixes'} were rejected by the innovation gate, at {_few(spans)}"
    if lost:
        text += f"; {lost} more were rejected while the filter was lost"
    against = (CONSISTENT,) if count > MANY_REJECTED * of else ()
    name = "rejected_ranges" if tight else "rejected_fixes"
    return [Finding(name, text, against, count, of, 1, float(when[rows[0]]))]


def warn_of_unflown(scenario: Replay, log: ReadLog, first: float, aligned: aligning.Alignment) -> list[str]:
    """Warnings about parts of a recording, longer than `UNFLOWN`, that the filter does not process without being asked
    to.

    They are before the first fix or sample, before the alignment, and after the last sample.
    """
    samples, fixes = log.samples.time, log.fixes.time
    parts = [(first, aligned.since, _why_unaligned(scenario, log, first, aligned.since))]
    if scenario.begin is None:
        parts.insert(0, (float(samples[0]), first, "there are samples and no fixes"))
        parts.insert(0, (float(fixes[0]), first, "there are fixes and no samples"))
    if scenario.end_s is None:
        parts.append((float(samples[-1]), float(fixes[-1]), "there are fixes and no samples"))
    return [
        f"{begin:.1f} to {end:.1f} s of the recording ({end - begin:.0f} s) are not replayed: {why}"
        for begin, end, why in parts
        if end - begin > UNFLOWN
    ]


def _why_unaligned(scenario: Replay, log: ReadLog, first: float, since: float) -> str:
    """Why the time from `first` to `since`, s, does not align the filter."""
    wanted = scenario.alignment
    if wanted.heading_deg is not None:
        return "alignment.heading_deg needs a standstill, and the first one begins then"
    heading = f"give the heading to {wanted.heading_sigma_deg:g} degrees"
    absent = [("samples", log.samples.missing(aligning.BRIDGED)), ("fixes", _unusual_pauses(log.fixes))]
    holes = [
        f"no {name} from {begin:.1f} to {end:.1f} s"
        for name, spans in absent
        for begin, end in spans
        if begin < since and end > first
    ]
    if holes:
        return f"there are {_few(holes)}, and the motion beside does not {heading}"
    return f"motion that begins then does not {heading} within {wanted.longest_s:g} s"


def find_off_course(flight: RecordedFlight, flown: replay.Replayed) -> list[Finding]:
    """The findings of the times at which the nose points far from the course: `SIDEWAYS` and three sigma, for
    `OFF_COURSE` seconds of motion on end."""
    at = np.minimum(np.searchsorted(flown.time, flight.arrival), flown.time.size - 1)
    nose = dcm_from_quaternion(flown.navigation[at, states.NAV_QUAT : states.NAV_BIAS_FRAME])[:, :2, 0]
    angle = np.angle(np.exp(1j * (np.arctan2(nose[:, 1], nose[:, 0]) - flight.course)))
    moving = np.flatnonzero((flight.speed > FASTEST_NEEDED) & flown.flown & (flown.status != REJECTED))
    off = np.abs(angle[moving]) > SIDEWAYS + 3.0 * flown.sigma[at[moving], states.PHI_D]
    edges = np.flatnonzero(np.diff(off, prepend=False, append=False)).reshape(-1, 2)
    out = []
    for begin, end in edges:
        rows = moving[begin:end]
        first, last = (float(t) for t in flight.arrival[rows[[0, -1]]])
        if last - first < OFF_COURSE:
            continue
        text = (
            f"heading {np.degrees(np.median(np.abs(angle[rows]))):.0f} degrees off the course from {first:.1f} to "
            f"{last:.1f} s (median of {rows.size} fixes faster than {FASTEST_NEEDED:g} m/s, 1 sigma of the heading "
            f"{np.degrees(np.median(flown.sigma[at[rows], states.PHI_D])):.1f} degrees). The attitude is wrong, unless "
            "the aircraft flies sideways. Align elsewhere with start_s, or silence this with `checks: off`"
        )
        out.append(Finding("off_course", text, (CONSISTENT,), rows.size, moving.size, 1, first))
    return out


def warn_of_outages(scenario: Replay, first: float, last: float) -> list[str]:
    """Warning about outages outside the flight, from first to last, s: they have no effect."""
    spans = [span for outage in scenario.outages for span in outage_spans(outage)]
    away = [f"{begin:.12g} to {end:.12g} s" for begin, end in spans if begin <= first or end > last]
    if not away:
        return []
    part = f"the replayed part, {first:.1f} to {last:.1f} s"
    return [f"outages: {len(away)} of {len(spans)} reach beyond {part}, and have no drift: {_few(away)}"]


def warn_of_headings(headings: Headings | None, first: float, last: float) -> list[str]:
    """Warning about headings of which none is in the flight, from first to last, s."""
    if headings is None or np.any((headings.time > first) & (headings.time < last)):
        return []
    return [
        f"heading.file: its headings are of {headings.time[0]:.1f} to {headings.time[-1]:.1f} s, and the flight is of "
        f"{first:.1f} to {last:.1f} s, so that none is used. They need the clock of the samples"
    ]


def outage_spans(outage: Outage) -> list[tuple[float, float]]:
    return [(start, start + length) for length in outage.duration_s for start in outage.start_s]
