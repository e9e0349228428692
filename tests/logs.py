"""Small logs of other programs for tests, written by the libraries that read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pymavlink.DFReader import DFFormat, DFReader_binary
from pyubx2 import GET, UBXMessage
from pyulog import ULog

from navsim.formats.recorded_data import Fixes, Samples
from navsim.geodesy.attitude import quaternion_from_dcm
from navsim.gnss.timescales import WEEK

GPS_START = 2300 * WEEK + 86400.0
"""GPS s of time 0."""

DATAFLASH = {
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": ("QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "GPA": ("QBCCCCfBIHf", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,Und"),
    "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "BARO": ("QBfff", "TimeUS,I,Alt,Press,Temp"),
    "MAG": ("QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    "XKF0": ("QBBccCCccc", "TimeUS,C,ID,rng,innov,SIV,TR,BPN,BPE,BPD"),
    "PARM": ("QNf", "TimeUS,Name,Value"),
}
"""Formats and columns of messages, as ArduPilot logs them; PARM comes first and last there too."""


def write_dataflash(path: Path, messages: Mapping[str, Sequence[Sequence[Any]]]) -> None:
    """A DataFlash log with rows of messages by name; numbers are in the units of the columns."""
    here = SimpleNamespace(formats={0x80: DFFormat(0x80, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")})
    head, body = [], []
    for kind, name in enumerate(messages, 0x81):
        codes, columns = DATAFLASH[name]
        form = DFFormat(kind, name, 0, codes, columns)
        head.append(DFReader_binary.make_format_msgbuf(here, form))
        for row in messages[name]:
            values = [
                value if scale is None else round(value / scale)
                for value, scale in zip(row, form.msg_mults, strict=True)
            ]
            body.append((row[0], DFReader_binary.make_msgbuf(here, form, values)))
    body.sort(key=lambda each: each[0])
    path.write_bytes(b"".join([*head, *(each for _, each in body)]))


def dataflash_of(
    samples: Samples, fixes: Fixes, parameters: Mapping[str, float], imus: int = 1, receivers: int = 1
) -> dict[str, list[list[Any]]]:
    """Messages of a flight, with heights above mean sea level 20 m below the ellipsoid's."""
    micro = np.round(1e6 * samples.time).astype(int)
    at = np.round(1e6 * fixes.time).astype(int)
    speed, course = np.hypot(*fixes.velocity[:, :2].T), np.degrees(np.arctan2(*fixes.velocity[:, 1::-1].T))
    out: dict[str, list[list[Any]]] = {"PARM": [[0, name.encode(), value] for name, value in parameters.items()]}
    out["IMU"] = [
        [t, i, *(w + 1e-4 * i), *f]
        for i in range(imus)
        for t, w, f in zip(micro, samples.rate, samples.force, strict=True)
    ]
    out["GPS"], out["GPA"] = [], []
    for i in range(receivers):
        for k, t in enumerate(at):
            lat, lon = np.degrees(fixes.llh[k, :2])
            gps = GPS_START + fixes.time[k]
            week, milli = divmod(round(1000 * gps), round(1000 * WEEK))
            out["GPS"].append([
                t, i, 3, milli, week, 11, 0.8, lat, lon, fixes.llh[k, 2] + 20.0, speed[k], course[k],
                fixes.velocity[k, 2], 0.0, 1,
            ])  # fmt: skip
            out["GPA"].append([t, i, 1.2, 0.9, 1.4, 0.3, 0.0, 1, t // 1000, 200, 20.0])
    return out


TYPES = {"f": "float", "d": "double", "Q": "uint64_t", "i": "int32_t", "I": "uint32_t", "B": "uint8_t", "?": "bool"}


def write_ulog(
    path: Path, topics: Mapping[str, Mapping[str, tuple[str, np.ndarray]]], parameters: Mapping[str, float]
) -> None:
    """A PX4 log: topics (name or name:instance) with (type, values (n,) or (n, k)) by field; first `timestamp`, us."""
    log = ULog(None)
    log._initial_parameters = dict(parameters)
    for number, (topic, fields) in enumerate(topics.items()):
        name, _, instance = topic.partition(":")
        layout, flat, data = [], [], {}
        for field, (code, values) in fields.items():
            width = 0 if values.ndim == 1 else values.shape[1]
            layout.append((TYPES[code], width, field))
            for i in range(max(width, 1)):
                label = field if not width else f"{field}[{i}]"
                flat.append(SimpleNamespace(field_name=label, type_str=TYPES[code]))
                column = values if not width else values[:, i]
                data[label] = column.astype(ULog._UNPACK_TYPES[TYPES[code]][2])
        log._message_formats[name] = SimpleNamespace(name=name, fields=layout)
        log._data_list.append(
            SimpleNamespace(name=name, multi_id=int(instance or 0), msg_id=number, field_data=flat, data=data)
        )
    log.write_ulog(str(path))


def ulog_of(samples: Samples, fixes: Fixes, c_nb: np.ndarray) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
    """Topics of a flight. c_nb (n, 3, 3): attitudes at the samples."""
    micro, at = np.round(1e6 * samples.time), np.round(1e6 * fixes.time)
    ones = np.ones(fixes.time.size)
    return {
        "sensor_combined": {
            "timestamp": ("Q", micro), "gyro_rad": ("f", samples.rate), "accelerometer_m_s2": ("f", samples.force),
            "accelerometer_timestamp_relative": ("i", 0 * micro),
        },
        "sensor_gps": {
            "timestamp": ("Q", at), "latitude_deg": ("d", np.degrees(fixes.llh[:, 0])),
            "longitude_deg": ("d", np.degrees(fixes.llh[:, 1])), "altitude_ellipsoid_m": ("d", fixes.llh[:, 2]),
            "altitude_msl_m": ("d", fixes.llh[:, 2] - 20.0), "fix_type": ("B", 3 * ones), "eph": ("f", 0.9 * ones),
            "epv": ("f", 1.4 * ones), "s_variance_m_s": ("f", 0.3 * ones), "satellites_used": ("B", 11 * ones),
            "vel_n_m_s": ("f", fixes.velocity[:, 0]), "vel_e_m_s": ("f", fixes.velocity[:, 1]),
            "vel_d_m_s": ("f", fixes.velocity[:, 2]), "vel_ned_valid": ("?", ones),
            "time_utc_usec": ("Q", 0 * at),
        },
        "vehicle_attitude": {"timestamp": ("Q", micro), "q": ("f", np.array([quaternion_from_dcm(c) for c in c_nb]))},
    }  # fmt: skip


def ubx_of(fixes: Fixes) -> bytes:
    """Messages NAV-PVT of fixes."""
    out = []
    for t, (lat, lon, h), v in zip(fixes.time, fixes.llh, fixes.velocity, strict=True):
        milli = round(1000 * (GPS_START % WEEK + t))
        utc = 2300 * 7 * 86400 + milli / 1000 - 18 + 315964800
        when = np.datetime64(round(1000 * utc), "ms").astype(object)
        out.append(
            UBXMessage(
                "NAV", "NAV-PVT", GET, iTOW=milli % round(1000 * WEEK), year=when.year, month=when.month, day=when.day,
                hour=when.hour, min=when.minute, second=when.second, nano=1000 * when.microsecond, validDate=1,
                validTime=1, fixType=3, gnssFixOk=1, numSV=11, lat=round(np.degrees(lat), 7),
                lon=round(np.degrees(lon), 7), height=round(1000 * h), hMSL=round(1000 * h) - 20000,
                hAcc=900, vAcc=1400, sAcc=300,
                velN=round(1000 * v[0]), velE=round(1000 * v[1]), velD=round(1000 * v[2]),
            ).serialize()
        )  # fmt: skip
    return b"".join(out)
