"""The data beside the shipped scenarios, all of it navsim's own: almanacs and messages of the nominal constellations,
a recorded flight, and the places of another; an invented horizon.

    python scripts/make_shipped_data.py [FOLDER]          # default: scenarios/data

nominal.agl, nominal.alm  GLONASS (the IAC's format) and GPS (YUMA) almanacs of 2018-09-13
nominal.rnx               broadcast messages of both (RINEX 3.04), usable from 11:00 to 13:00 UTC of that day
flight_imu.csv.gz         inertial samples of two minutes of S-turns, sensors of the consumer class
flight_gnss.csv           the fixes of the same flight, two a second, 0.1 s late, antenna off the IMU
circuit_track.csv         places, one a second, of base and landing of `scenarios/circuit.yaml`, off by 0.3 m an axis
beacon_ranges.csv         two-way ranges of four beacons to a vehicle that circles among them, some of them reflections
beacon_track.csv          the true positions of that vehicle
odense_horizon.csv        what stands around the aerodrome of `scenarios/odense.yaml`: invented, not surveyed

The scenario of the flight is `scenarios/s_turn.yaml` with the settings below; the script draws from navsim's own random
streams, so it writes the same files again.
"""

from __future__ import annotations

import datetime
import gzip
import io
import sys
from pathlib import Path

import numpy as np

import navsim
from navsim.formats.rinex_write import navigation_lines
from navsim.geodesy import earth
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, glonass_broadcast, gps
from navsim.gnss.constellations.systems import GLONASS, GPS
from navsim.landing import study as landing
from navsim.ranging.scenario import RecordedRanges
from navsim.scenario.load import read, read_any
from navsim.scenario_files.presets import SENSOR_CLASSES
from navsim.sensors import imu
from navsim.simulation.measurements import measured, receiver_fixes
from navsim.statistics.random_streams import generator

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
DAY = datetime.date(2018, 9, 13)
NOON = timescales.posix(2018, 9, 13) + 43200.0
INCLINATION = np.radians(64.8)
"""Of the design constellation of GLONASS (ICD 5.1, section 3.3.2)."""
SEED = 1

SENSORS = SENSOR_CLASSES["consumer"]
SETTINGS = (
    "duration_s=120",
    f"imu={{rate_hz: 50, gyro: {SENSORS['gyro']}, accelerometer: {SENSORS['accelerometer']}}}",
    "receiver={rate_hz: 2, lever_arm_m: [0.4, 0, -0.3]}",
    "signals.range_sigma_m=0.2",
    "signals.range_rate_sigma_m_s=0.05",
)
TRACK_SIGMA = 0.3
"""Of the places of the circuit, 1 sigma an axis, m."""
LATENCY = 0.1
"""From the time a fix is valid to its time in the file, s."""


WOOD, BUILDINGS, GROUND = 14.0, 8.0, 3.0
"""Their elevations on the invented horizon, deg."""


def agl() -> str:
    """The nominal GLONASS constellation as an almanac: of each satellite the first ascending node of the day."""
    nominal = glonass.Glonass24Slots()
    # from the state at the start of the day: circles, so the argument of latitude grows evenly
    start = timescales.posix(DAY.year, DAY.month, DAY.day) - glonass.MOSCOW_MINUS_UTC
    time = start + np.arange(0.0, 45000.0, 1.0)
    position, velocity = nominal.state(timescales.gps_from_utc(time))
    rising = (position[:-1, :, 2] < 0.0) & (position[1:, :, 2] >= 0.0)
    lines = []
    for s, slot in enumerate(nominal.slot):
        k = int(np.flatnonzero(rising[:, s])[0])
        node = time[k] - position[k, s, 2] / velocity[k, s, 2]
        at = nominal.state(timescales.gps_from_utc(np.array([node])))[0][0, s]
        radius = float(np.linalg.norm(at))
        period = 2.0 * np.pi * np.sqrt(radius**3 / GLONASS.gm)
        inclination = INCLINATION - glonass.FDMA_MEAN_INCLINATION
        moscow = node + glonass.MOSCOW_MINUS_UTC - timescales.posix(DAY.year, DAY.month, DAY.day)
        first = [moscow, 0.0, 0.0, 0.0]
        longitude, excess = np.arctan2(at[1], at[0]), period - glonass.FDMA_MEAN_PERIOD
        second = [longitude / np.pi, inclination / np.pi, 0.0, 0.0, excess, 0.0]
        lines += [
            f"{DAY:%d %m %Y}       0",
            f"{slot:2d} {nominal.channel[s]:3d}   1  {DAY:%d %m %Y}" + "".join(f" {x:16.9E}" for x in first),
            " ".join(f"{x:16.9E}" for x in second),
        ]
    return "\n".join(lines) + "\n"


def yuma() -> str:
    """The baseline GPS constellation as a YUMA almanac of noon."""
    e = gps.nominal(NOON).records
    lines = []
    for k, prn in enumerate(e.prn):
        week, second = divmod(float(e.toe[k]), timescales.WEEK)
        lines += [
            f"******** Week {week:.0f} almanac for PRN-{prn:02d} ********",
            f"ID:                         {prn:02d}",
            "Health:                     000",
            f"Eccentricity:               {e.e[k]:.9E}",
            f"Time of Applicability(s):  {second:.4f}",
            f"Orbital Inclination(rad):   {e.i0[k]:.9f}",
            f"Rate of Right Ascen(r/s):  {e.omega_dot[k]:.9E}",
            f"SQRT(A)  (m 1/2):           {e.sqrt_a[k]:.6f}",
            f"Right Ascen at Week(rad):  {e.omega0[k]:.9E}",
            f"Argument of Perigee(rad):   {e.omega[k]:.9f}",
            f"Mean Anom(rad):            {e.m0[k]:.9E}",
            f"Af0(s):                     {e.af0[k]:.9E}",
            f"Af1(s/s):                   {e.af1[k]:.9E}",
            f"week:                        {week:.0f}",
            "",
        ]
    return "\n".join(lines)


def rinex() -> str:
    """The messages both nominal constellations would have sent, an hour to each side of noon."""
    vectors = glonass_broadcast.sent_by(glonass.Glonass24Slots(), NOON - 3600.0, NOON + 3600.0).records
    made = f"{'navsim ' + navsim.__version__:20s}{'':20s}{DAY:%Y%m%d} 120000 UTC "
    comments = ("nominal constellations, scripts/make_shipped_data.py",)
    elements, at = gps.nominal(NOON).records, float(timescales.gps_from_utc(NOON))
    return "\n".join(navigation_lines({GPS: elements}, vectors, comments, made, at=at)) + "\n"


def flight() -> tuple[bytes, str]:
    """Samples (gzip) and fixes of the flight."""
    case = landing.prepare(*read(SCENARIOS / "s_turn.yaml", SETTINGS))
    world = case.shared
    step = 1.0 / case.scenario.imu.rate_hz
    dtheta, dv, _ = imu.simulate(
        generator(SEED, 0, "imu"), world.dtheta, world.dv, step, case.flight.gyro, case.flight.accel
    )
    samples = io.StringIO()
    head = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    table = np.column_stack([world.imu_time[1:], dtheta / step, dv / step])
    np.savetxt(samples, table, ["%.2f", *3 * ["%.5f"], *3 * ["%.4f"]], ",", header=head, comments="")
    llh, velocity, _, _ = receiver_fixes(world, *measured(world, SEED, 0))
    fixes = io.StringIO()
    head = "t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s"
    table = np.column_stack([world.signals.time + LATENCY, np.degrees(llh[:, :2]), llh[:, 2], velocity])
    np.savetxt(fixes, table, ["%.1f", "%.8f", "%.8f", *4 * ["%.3f"]], ",", header=head, comments="")
    return gzip.compress(samples.getvalue().encode(), mtime=0), fixes.getvalue()


def track() -> str:
    """Places of a landing off a circuit, as a logger might have them."""
    moving = read(SCENARIOS / "circuit.yaml", ())[0].trajectory()
    time = np.arange(60.0, 211.0)
    ned = np.random.default_rng(SEED).normal(0.0, TRACK_SIGMA, (time.size, 3))
    motion = moving.motion(time)
    ecef = motion.position_ecef + np.einsum("nji,nj->ni", earth.ned_matrix(motion.llh), ned)
    llh = earth.llh_from_ecef(ecef)
    cells = zip(time, np.degrees(llh[:, 0]), np.degrees(llh[:, 1]), llh[:, 2], strict=True)
    rows = [f"{t:.0f},{lat:.7f},{lon:.7f},{h:.2f}" for t, lat, lon, h in cells]
    return "\n".join(["t_s,lat_deg,lon_deg,h_m", *rows]) + "\n"


def beacons() -> tuple[str, str]:
    """Two-way ranges of the beacons of `scenarios/recorded_ranges.yaml`, and the true positions."""
    section = read_any(SCENARIOS / "recorded_ranges.yaml", ())[0]
    assert isinstance(section, RecordedRanges)
    positions = np.array([one.position_m for one in section.sources.positions])
    names = [one.name for one in section.sources.positions]
    draw = np.random.default_rng(SEED)
    time = 0.1 * np.arange(900)
    turn = 0.07 * time
    true = np.column_stack([60.0 * np.cos(turn), 45.0 * np.sin(turn), 20.0 + 5.0 * np.sin(0.5 * turn)])
    asked = np.arange(time.size) % len(names)
    distance = np.linalg.norm(true - positions[asked], axis=1)
    bias = draw.normal(0.0, 0.1, len(names))
    error = draw.normal(0.0, 0.1, time.size) + bias[asked]
    reflected = draw.random(time.size) < 0.03
    error += np.where(reflected, draw.exponential(3.0, time.size), 0.0)
    heard = draw.random(time.size) < 0.95
    cells = zip(time[heard], asked[heard], (distance + error)[heard], strict=True)
    ranges = ["t_s,source,range_m", *(f"{t:.1f},{names[i]},{r:.3f}" for t, i, r in cells)]
    track = ["t_s,x_m,y_m,z_m", *(f"{t:.1f},{x:.3f},{y:.3f},{z:.3f}" for t, (x, y, z) in zip(time, true, strict=True))]
    return "\n".join(ranges) + "\n", "\n".join(track) + "\n"


def horizon() -> str:
    """A horizon for the planner's scenario, which nobody surveyed."""
    rows = [(0, WOOD), (30, WOOD - 2.0), (40, GROUND), (150, GROUND), (160, BUILDINGS), (200, BUILDINGS), (210, GROUND),
            (310, GROUND), (320, WOOD - 2.0)]  # fmt: skip
    said = "# Invented for the example, not surveyed: a wood from north-west to north-east, buildings in the south."
    return "\n".join([said, "azimuth_deg,elevation_deg", *(f"{az},{el:g}" for az, el in rows)]) + "\n"


def write(folder: Path) -> None:
    """Write all files. Raises OSError."""
    (folder / "nominal.agl").write_text(agl())
    (folder / "nominal.alm").write_text(yuma())
    (folder / "nominal.rnx").write_text(rinex())
    samples, fixes = flight()
    (folder / "flight_imu.csv.gz").write_bytes(samples)
    (folder / "flight_gnss.csv").write_text(fixes)
    (folder / "circuit_track.csv").write_text(track())
    ranges, positions = beacons()
    (folder / "beacon_ranges.csv").write_text(ranges)
    (folder / "beacon_track.csv").write_text(positions)
    (folder / "odense_horizon.csv").write_text(horizon())


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else SCENARIOS / "data")
