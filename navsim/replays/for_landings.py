"""Values of a landing that come from the result of a replay: sensors, signals, and duration and runway of its flight.

They are written into the scenario before it is validated, so that the stored one has the numbers and no file. The white
noise of the sensors is that of a standstill or of their class: the tuned noise also covers what else makes the fixes
disagree with the samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navsim.scenario.imu import filled
from navsim.scenario_files.base import DEG, DEG_H, DEG_SQRT_H, MG
from navsim.scenario_files.presets import SENSOR_CLASSES
from navsim.scenario_files.source import Document, InputError, KeyPath, Problem, dotted, parse

if TYPE_CHECKING:
    import numpy as np

    from navsim.results.result import Result

_SENSORS = {
    "gyro": ("arw_deg_sqrt_h", DEG_SQRT_H, "drift_deg_h", DEG_H, ("drift_fixed_deg_h",)),
    "accelerometer": ("vrw_m_s_sqrt_h", 1.0 / 60.0, "bias_mg", MG, ("bias_fixed_mg",)),
}
"""Keys and SI units of the white noise and the constant error of each sensor, and keys that the latter replaces."""
_COURSE = 2.0
"""Least speed over ground that shows the direction of a runway, m/s."""
_AGAIN = "write `navsim replay LOG.yaml -o FILE` to make it anew by this version"


@dataclass(frozen=True)
class _ReplayFile:
    """The result of a replay, as a key names it."""

    document: Document
    path: KeyPath
    name: str
    result: Result

    @classmethod
    def at(cls, document: Document, path: KeyPath, name: str) -> _ReplayFile:
        """Raises InputError for anything but a result of a replay."""
        from navsim.results.result import ResultError, read

        file: Path = document.resolve(path, name)
        try:
            out = cls(document, path, name, read(file))
        except ResultError as error:
            raise _problem(document, path, f"{name}: {error}") from None
        except OSError as error:
            raise _problem(document, path, f"{name}: cannot be read: {error.strerror or error}") from None
        if (kind := str(out.result.attributes.get("kind"))) != "replay":
            raise out.wrong(f"is a result of kind {kind}; `navsim replay LOG.yaml` writes one of a recorded flight")
        return out

    def wrong(self, message: str, *path: str) -> InputError:
        """An error about the file, at the key at `path`, or that of the file."""
        return _problem(self.document, path or self.path, f"{self.name}: {message}")

    def read(self, variable: str) -> np.ndarray:
        """A variable. Raises InputError where it is missing or damaged."""
        from navsim.results.result import ResultError

        if variable not in self.result:
            raise self.wrong(f"has no {variable}; {_AGAIN}")
        try:
            return self.result[variable]
        except ResultError as error:
            raise self.wrong(str(error)) from None

    def array(self, variable: str) -> np.ndarray:
        """A variable of finite numbers. Raises InputError where it is none."""
        import numpy as np

        out = np.asarray(self.read(variable), dtype=float)
        if not out.size or not np.isfinite(out).all():
            raise self.wrong(f"{variable} is damaged; {_AGAIN}")
        return out

    def usable(self) -> np.ndarray:
        """Which outputs of the filter are usable, bool (t,)."""
        import numpy as np

        time = self.array("/filter/time")
        out = np.ones(time.size, bool)
        if self.read("/lost/start").size:
            for begin, end in zip(self.array("/lost/start"), self.array("/lost/end"), strict=True):
                out &= (time < begin) | (time > end)
        if not out.any():
            raise self.wrong("none of its output is usable")
        return out

    def log(self) -> dict[str, Any]:
        """The scenario of the replay."""
        found: dict[str, Any] = parse(str(self.result.attributes["scenario"]), self.name, Path()).data
        return found

    def noise(self, variable: str, key: str, given: str) -> float:
        """A noise that was tuned, or given in section `gnss` of the log by a key. Raises InputError where it follows
        from a rule, about `key`."""
        value = float(self.array(variable))
        origin = str(self.result.variables[variable].attributes.get("origin", ""))
        if not (origin.startswith("tuned") or given in self.log()["gnss"]) or not value > 0.0:
            of = "a range" if key == "range_sigma_m" else "a range rate"
            cure = f"give signals.{key}, 1 sigma of {of}"
            if "/summary/bet_until" in self.result:
                cure = f"name a result of `navsim replay` without --bet, or {cure}"
            raise self.wrong(f"{variable} was not measured: it is {origin}; {cure}", "signals", key)
        return value


def _problem(document: Document, path: KeyPath, message: str) -> InputError:
    return InputError([Problem(document.place(path), dotted(path), message)])


def completed(document: Document) -> Any:
    """The data of a landing with all that it takes from replays. Raises InputError where a result lacks something."""
    data = document.data
    if not isinstance(data, dict):
        return data
    out = dict(data)
    for key, taken in (("imu", _sensors), ("signals", _signals)):
        section = data.get(key)
        if isinstance(section, dict) and isinstance(section.get("from"), str):
            out[key] = taken(_ReplayFile.at(document, (key, "from"), section["from"]), section)
    approach, runway = data.get("approach"), data.get("runway", {})
    if isinstance(approach, dict) and approach.get("profile") == "recorded" and isinstance(approach.get("file"), str):
        placed = not isinstance(runway, dict) or "threshold" in runway
        if not ("duration_s" in data and placed):
            _flight(_ReplayFile.at(document, ("approach", "file"), approach["file"]), out, placed)
    return out


def _sensors(source: _ReplayFile, section: dict[str, Any]) -> dict[str, Any]:
    """Section `imu` with white noise, constant errors and in-run wander; given keys stay.

    The 1 sigma of the constant error is the root mean square over the axes of the last estimate and its 1 sigma.
    """
    import numpy as np

    if "preset" in section:
        raise _problem(source.document, ("imu", "preset"), "imu.from has the sensors: leave one of them out")
    log = source.log()["imu"]
    last = np.flatnonzero(source.usable())[-1]
    names = [str(name) for name in source.read("/filter/state")]
    sigma = source.array("/filter/sigma")[last]
    out = {key: value for key, value in section.items() if key != "from"} | {"preset": "none"}
    for sensor, (noise, noise_unit, constant, unit, others) in _SENSORS.items():
        values = filled(SENSOR_CLASSES[log["sensor_class"]][sensor], log.get(sensor, {}))
        values = {key: value for key, value in values.items() if key not in others}
        bias = source.array(f"/filter/{sensor}_bias")[last]
        of = [i for i, name in enumerate(names) if name.startswith(f"{sensor}_bias")]
        values[constant] = float(np.sqrt(np.mean(bias**2 + sigma[of] ** 2))) / unit
        values[noise] = float(source.array(f"/tuning/{sensor}_white_noise")) / noise_unit
        given = section.get(sensor, {})
        out[sensor] = filled(values, given) if isinstance(given, dict) else given
    return out


def _signals(source: _ReplayFile, section: dict[str, Any]) -> dict[str, Any]:
    """Section `signals` with white noise and, of a loose filter with accuracies, the lasting error; given keys stay."""
    out = {key: value for key, value in section.items() if key not in ("from", "hdop")}
    told = "errors" in section or "preset" in section
    if "/tuning/range_sigma" in source.result:
        noise = {"range_sigma_m": ("range_sigma", "range_sigma_m"),
                 "range_rate_sigma_m_s": ("range_rate_sigma", "range_rate_sigma_m_s")}  # fmt: skip
        lasting, factor, law = None, 1.0, "inverse-sine"
        if "hdop" in section:
            raise source.wrong("has the noise of ranges: leave signals.hdop out", "signals", "hdop")
    else:
        noise = {"range_sigma_m": ("position_sigma_horizontal", "position_sigma_m"),
                 "range_rate_sigma_m_s": ("velocity_sigma_horizontal", "velocity_sigma_m_s")}  # fmt: skip
        lasting, law = "/tuning/position_error_horizontal", "constant"
        hdop = section.get("hdop")
        if hdop is None:
            text = "has noise of positions, not of ranges; give signals.hdop, the receiver's HDOP during the recording"
            raise source.wrong(text, "signals", "hdop")
        if isinstance(hdop, bool) or not isinstance(hdop, int | float) or not 0.1 <= hdop <= 100.0:
            raise _problem(source.document, ("signals", "hdop"), "must be a number from 0.1 to 100")
        factor = math.sqrt(2.0) / hdop
    missing: list[Problem] = []
    for key, (name, given) in noise.items():
        if key not in section:
            try:
                out[key] = factor * source.noise(f"/tuning/{name}", key, given)
            except InputError as error:
                missing += error.problems
    if not told and (lasting is None or lasting not in source.result):
        text = "shows no time-correlated error of the fixes; give signals.errors or signals.preset"
        missing += source.wrong(text, "signals", "from").problems
    if missing:
        raise InputError(missing)
    out.setdefault("range_law", law)
    if told or lasting is None:  # the latter was refused above unless errors are given
        return out
    out["errors"] = {
        "orbit_clock": {
            "sigma_m": factor * float(source.array(lasting)),
            "correlation_time_s": float(source.array("/tuning/position_error_time")),
            "mapping": "none",
        }
    }
    return out


def _flight(source: _ReplayFile, data: dict[str, Any], placed: bool) -> None:
    """Write the length of a recorded flight, and the runway where it touches down or ends, where none is given."""
    import numpy as np

    from navsim.geodesy.earth import llh_from_ecef
    from navsim.trajectory.kinematics import tangent_frame

    time, llh = source.array("/filter/time"), source.array("/filter/position_llh")
    velocity, rpy = source.array("/filter/velocity_ned"), source.array("/filter/attitude_rpy")
    approach, runway = data["approach"], dict(data.get("runway", {})) if not placed else {}
    start, down = approach.get("start_s", time[0]), approach.get("touchdown_s")
    if any(isinstance(each, bool) or not isinstance(each, int | float | None) for each in (start, down)):
        return  # the section refuses them
    if not time[0] - 1e-9 <= start < time[-1]:
        text = f"the recording lasts from {time[0]:g} to {time[-1]:g} s"
        raise source.wrong(text, "approach", "start_s")
    data.setdefault("duration_s", math.floor(10.0 * (float(time[-1]) - start) + 1e-9) / 10.0)
    numbers = [runway.get(key, 0.0) for key in ("heading_deg", "aim_point_m", "slope_percent")]
    if placed or "end" in runway or any(not isinstance(each, int | float) for each in numbers):
        return
    if runway.get("height_above") == "geoid" and "height_m" not in runway:
        text = "its heights are above the ellipsoid: give runway.height_m, or leave runway.height_above out"
        raise source.wrong(text, "runway", "height_above")
    last = start + data["duration_s"] if down is None else down
    at = int(np.argmin(np.abs(time - last)))
    moving = np.flatnonzero(np.hypot(*velocity[: at + 1, :2].T) >= _COURSE)
    course = np.arctan2(*velocity[moving[-1], 1::-1]) if moving.size else rpy[at, 2]
    if not {"heading_deg", "bearing_deg"} & runway.keys():
        runway["heading_deg"] = round(float(np.degrees(course)) % 360.0, 3) % 360.0
        numbers[0] = runway["heading_deg"]
    heading = numbers[0] * DEG if "heading_deg" in runway else float(course)
    frame = tangent_frame(llh[at], heading)
    back = llh_from_ecef(frame.origin - numbers[1] * frame.axes[:, 0])
    runway["threshold"] = {"lat_deg": float(np.degrees(back[0])), "lon_deg": float(np.degrees(back[1]))}
    runway.setdefault("height_m", round(float(llh[at, 2]) - 0.01 * numbers[2] * numbers[1], 3))
    data["runway"] = runway
