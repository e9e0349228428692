"""Check a recording before the filter uses it: units, axes, signs, columns, times.

A filter follows its fixes, so innovations look healthy even with a negated axis: biases and tuned noise absorb the
mistake. Therefore each stage compares two quantities that must agree, and finds the simplest correction that makes them
agree:

- sample intervals and spans of both files: units of time;
- mean specific force against gravity: unit of the accelerometers, gyros and accelerometers exchanged;
- changes of position against velocity [1]: angles, heights, speeds, axes of the velocity. The slope of one over the
  other, with its noise, decides between units that differ by a factor, and on the sign of the vertical velocity;
- specific force rotated by the gyros against changes of velocity, in pieces and windows: signs and columns of either
  triad, unit of the gyros, time offset. One rotation is free [2]; the biases are profiled out;
- gravity and velocity in the axes found so: body axes.

Wild fixes are removed first (`wild_fixes`): a mistake of units or axes is in all fixes.

Quantities that the motion does not show are not checked. A correction is reported only if the recording as written fits
clearly worse than the best one; equally good corrections are reported together. Each stage uses the corrections of the
stage before, so several mistakes are found.

Sources: [1] Groves (2013), section 17.4 (consistency tests). [2] Wu & Pan (2013), as `replays.alignment`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from navsim.recording_checks.fix_checks import interpretations
from navsim.recording_checks.mirrors import without_mirrors
from navsim.recording_checks.mistakes import OF_SENSORS, Log, Mistake
from navsim.recording_checks.sensor_checks import motion
from navsim.recording_checks.unit_checks import overlap, scales, times
from navsim.recording_checks.wild_fixes import plausible


@dataclass(frozen=True)
class Diagnosis:
    """Mistakes in the order of their correction, and quantities that the motion does not show, in which a mistake would
    remain."""

    mistakes: list[Mistake]
    not_judged: list[str]


def diagnose(log: Log) -> list[Mistake]:
    """All detectable mistakes of a recording, in the order of their correction."""
    return examine(log).mistakes


def examine(log: Log) -> Diagnosis:
    """Mistakes of a recording, and quantities that cannot be checked."""
    unseen: list[str] = [NEVER_JUDGED]
    found, log = times(replace(log, fixes=log.fixes.take(plausible(log.fixes))))
    more, log = scales(log)
    found += more
    more, log = interpretations(log, unseen)
    found += more
    apart = overlap(log)
    if apart and not found:
        apart = [_by_motion(apart[0], log)]
    if apart or any(not mistake.remedies for mistake in found):
        return Diagnosis(found + apart, [*unseen, f"{OF_SENSORS}: correct the other mistakes first"])
    more, log = motion(log, unseen)
    return Diagnosis(found + without_mirrors(more, log), unseen)


def _by_motion(apart: Mistake, log: Log) -> Mistake:
    """The mistake of files with no common time, with the offset that the motion shows, nearest to that of files which
    begin together; as it is where the motion shows none, or another mistake."""
    shift = apart.remedies[0]["gnss.time_offset_s"]
    fixes = replace(log.fixes, time=log.fixes.time + shift - log.gnss.time_offset)
    latency = ORDINARY_LATENCY if log.latency is None else log.latency  # else it would explain a second
    meeting = replace(log, fixes=fixes, gnss=replace(log.gnss, time_offset=shift), latency=latency)
    more, _ = motion(meeting, [])
    by_clock = [each for mistake in more for each in mistake.remedies if set(each) == {"gnss.time_offset_s"}]
    if len(more) != 1 or not by_clock:
        return apart
    nearest = min(by_clock, key=lambda each: abs(each["gnss.time_offset_s"] - shift))  # a way may repeat itself
    seems = "their clocks differ; if both files begin at about the same moment, the motion shows by how much"
    return replace(apart, seems=seems, remedies=(nearest,))


ORDINARY_LATENCY = 0.1
"""Latency of an ordinary receiver, s."""
NEVER_JUDGED = (
    "scale factors of the sensors, datum of the heights (ellipsoid or mean sea level): no check exists; lever arm: "
    "only the tuning checks it, and it never tells errors below 0.5 m"
)
