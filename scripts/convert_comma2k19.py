"""A segment of comma2k19 (arrays `.npy`) as a recorded flight for `navsim replay`.

    python scripts/convert_comma2k19.py FOLDER OUTPUT

FOLDER holds IMU_{accelerometer,gyro}_{t,value}.npy and GNSS_live_gnss_ublox_{t,value}.npy (latitude, longitude in deg,
speed m/s, UTC ms, altitude m, bearing deg). OUTPUT gets imu.csv, gnss.csv (no vertical velocity) and log.yaml. Axes are
forward-right-down already; times are seconds since boot of the recording device.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

LOG = """kind: replay
version: 1
title: comma2k19, a car on a motorway
imu: {file: imu.csv, sensor_class: consumer}
gnss: {file: gnss.csv}
"""


def convert(folder: Path, output: Path) -> None:
    """Write imu.csv, gnss.csv and log.yaml. Raises OSError and ValueError for arrays that are not there or not so."""

    def load(name: str) -> tuple[np.ndarray, np.ndarray]:
        return np.load(folder / f"{name}_t.npy"), np.load(folder / f"{name}_value.npy")

    output.mkdir(parents=True, exist_ok=True)
    (time, rate), (time_force, force) = load("IMU_gyro"), load("IMU_accelerometer")
    on_gyro = np.stack([np.interp(time, time_force, force[:, i]) for i in range(3)], axis=1)
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(output / "imu.csv", np.column_stack([time, rate, on_gyro]), "%.9f", ",", header=header, comments="")
    time, fix = load("GNSS_live_gnss_ublox")
    course = np.radians(fix[:, 5])
    with open(output / "gnss.csv", "w") as file:
        file.write("t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s\n")
        for t, row, angle in zip(time, fix, course, strict=True):
            north, east = row[2] * np.cos(angle), row[2] * np.sin(angle)
            file.write(f"{t:.6f},{row[0]:.9f},{row[1]:.9f},{row[4]:.4f},{north:.5f},{east:.5f},\n")
    (output / "log.yaml").write_text(LOG)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    convert(Path(sys.argv[1]), Path(sys.argv[2]))
