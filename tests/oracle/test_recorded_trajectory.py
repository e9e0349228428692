"""A recorded flight flown again: the curves against the recording, the sensors against the mechanisation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.filter import states
from navsim.filter.strapdown import navigate
from navsim.geodesy.earth import ecef_from_llh
from navsim.landing import study as landing
from navsim.replays import study as replay
from navsim.results.result import write
from navsim.runner.executor import threads
from navsim.scenario.load import read, read_replay
from navsim.scenario_files.source import InputError
from navsim.trajectory.kinematics import tangent_frame
from navsim.trajectory.recorded import recorded_trajectory
from tests.consistency.test_replay import GIVEN, without
from tests.consistency.test_unusable_output import shifted
from tests.helpers import case
from tests.recordings import write_flight

REPLAYED = """kind: landing
version: 1
epoch: 2018-09-13T12:00:00Z
duration_s: 60
runway: {{threshold: {{lat_deg: 56.0, lon_deg: 37.0}}, height_m: 0}}
approach: {{profile: recorded, file: {file}, start_s: 20}}
sky: {{source: nominal}}
pseudolites: {{count: 2, s_m: 300, l1_m: 500}}
receiver: {{rate_hz: 2}}
"""


def test_error_free_sensors_return_the_recording() -> None:
    """What the sensors feel, mechanised, is the motion; and the motion is near the recording."""
    flight = case(name="landing_smooth").trajectory
    time = np.arange(0.0, 60.0, 0.1)
    motion = flight.motion(time)
    again = recorded_trajectory(time, motion.llh, motion.c_nb, tangent_frame(motion.llh[0], 0.0), {})
    assert again.path.rms_residual < 1e-3
    t = np.arange(5.0, 45.0, 0.01)
    dtheta, dv = again.increments(t)
    exact = again.motion(t)
    nav = np.zeros(states.NAV_N)
    nav[:10] = np.concatenate([exact.llh[0], exact.velocity_ned[0], exact.quaternion[0]])
    history = np.empty((2, states.NAV_N))
    navigate(nav, states.declared(states.biases()), dtheta, dv, 0.01, t.size - 1, history)
    assert np.linalg.norm(ecef_from_llh(nav[:3]) - exact.position_ecef[-1]) < 1e-2
    assert np.abs(nav[3:6] - exact.velocity_ned[-1]).max() < 1e-3
    assert 2.0 * np.arccos(min(1.0, abs(nav[6:10] @ exact.quaternion[-1]))) < 1e-4
    there = flight.motion(t)
    assert np.abs(exact.velocity_ned - there.velocity_ned).max() < 0.05


def test_a_replay_feeds_the_simulator(tmp_path: Path) -> None:
    """Replay, then a landing on its trajectory with simulated satellites and pseudolites."""
    write_flight(tmp_path)
    result = replay.compute(replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", "filter.kind=rts"))))
    write(tmp_path / "flight.h5", result)
    (tmp_path / "again.yaml").write_text(REPLAYED.format(file=tmp_path / "flight.h5"))
    flown = landing.prepare(*read(tmp_path / "again.yaml"))
    truth = flown.shared.truth
    recorded = np.stack(
        [np.interp(truth.time + 20.0, result["/filter/time"], result["/filter/position_llh"][:, i]) for i in range(3)],
        axis=1,
    )
    assert np.linalg.norm(truth.position_ecef - ecef_from_llh(recorded), axis=1).max() < 1.0
    assert "PL2" in flown.shared.signals.names
    run = flown.fly(1, 0)
    assert np.sqrt(np.mean(run.error[-40:, :2] ** 2)) < 5.0
    out = landing.result(flown, landing.fly_all(flown, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    assert "file_sha256: " in out.attributes["scenario"]
    assert out["/truth/time"][-1] == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ("start_s: 20", "lasts from"),
        ("duration_s: 60", "recording ends"),
        ("flight.h5", "missing.h5: "),
        ("start_s: 20}", "has the checksum"),
    ],
)
def test_recordings_that_cannot_be_flown(change: str, fragment: str, tmp_path: Path) -> None:
    write_flight(tmp_path, duration=40.0)
    write(tmp_path / "flight.h5", replay.compute(replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",)))))
    other = {
        "start_s: 20": "start_s: 500", "duration_s: 60": "duration_s: 60", "flight.h5": "missing.h5",
        "start_s: 20}": f"start_s: 20, file_sha256: '{'0' * 64}'}}",
    }[change]  # fmt: skip
    text = REPLAYED.format(file=tmp_path / "flight.h5").replace(change, other)
    (tmp_path / "again.yaml").write_text(text)
    with pytest.raises(InputError, match=fragment):
        landing.prepare(*read(tmp_path / "again.yaml"))


@pytest.mark.parametrize("fault", ["a hole", "fixes that are off"])
def test_unusable_output_is_not_flown(fault: str, tmp_path: Path) -> None:
    """A replay whose samples have a hole, or whose filter contradicted its fixes: the times are named, and beside them
    the flight can be had."""
    write_flight(tmp_path)
    if fault == "a hole":
        without(tmp_path / "imu.csv", 40.0, 52.0)
    else:
        shifted(tmp_path / "gnss.csv", 40.0, 52.0, 40.0)
    write(tmp_path / "flight.h5", replay.compute(replay.prepare(*read_replay(tmp_path / "log.yaml", GIVEN))))
    (tmp_path / "landing.yaml").write_text(REPLAYED.format(file="flight.h5"))
    cause = r"no samples" if fault == "a hole" else r"the filter contradicted its fixes"
    with pytest.raises(InputError, match=rf"unusable at 40.* \({cause}\), within the 19.0 to 81.0 s .*start_s and"):
        landing.prepare(*read(tmp_path / "landing.yaml"))
    landing.prepare(*read(tmp_path / "landing.yaml", ("approach.start_s=66", "duration_s=25")))
