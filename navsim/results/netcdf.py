"""netCDF-4 written with h5py: dimensions as scales, and the two attributes that netCDF adds.

h5netcdf writes the same at five times the cost, since it looks every object up by its path for each attribute. Sources:
[1] NetCDF Users' Guide, appendix "NetCDF-4 file format": dimension scales, `_Netcdf4Dimid` (the order of the
dimensions), `_NCProperties` (the writer of the file).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

_ORDERED = {"track_order": True}
"""netCDF-4 requires objects and attributes in the order of their creation [1]."""


@dataclass(frozen=True)
class _Scale:
    """A dimension: the dataset of its coordinate, and its length."""

    made: Any
    length: int


class Writer:
    """Makes variables in an empty HDF5 file, coordinates before the variables that lie along them."""

    def __init__(self, file: Any) -> None:
        """file: a path, or an open file for h5py."""
        self._file = h5py.File(file, "w", **_ORDERED)
        self._groups: dict[str, Any] = {"": self._file}
        self._scales: dict[str, _Scale] = {}

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def root(self) -> Any:
        """Root group, which has the attributes of the file."""
        return self._file

    def finish(self) -> None:
        """Write the name of the software, as netCDF-4 libraries do."""
        made = f"version=2,h5py={h5py.__version__},hdf5={h5py.version.hdf5_version}".encode()
        self._file.attrs["_NCProperties"] = np.bytes_(made)

    def coordinate(self, path: str, shape: tuple[int, ...], dtype: Any, **how: Any) -> Any:
        """The dataset of a dimension's coordinate, of the dimension's name; `how` goes to h5py's `create_dataset`."""
        made = self._dataset(path, shape, dtype, how)
        made.make_scale(path.rpartition("/")[2])
        made.attrs["_Netcdf4Dimid"] = np.int32(len(self._scales))
        self._scales[path] = _Scale(made, shape[0])
        return made

    def variable(self, path: str, dims: tuple[str, ...], shape: tuple[int, ...], dtype: Any, **how: Any) -> Any:
        """The dataset of a variable along dimensions of its group or of those above; see `coordinate`."""
        scales = [self._scale(path, dim) for dim in dims]
        if shape != tuple(scale.length for scale in scales):
            raise ValueError(f"{path}: its shape is not that of its dimensions")
        made = self._dataset(path, shape, dtype, how)
        for axis, scale in enumerate(scales):
            made.dims[axis].attach_scale(scale.made)
        return made

    def _scale(self, path: str, dim: str) -> _Scale:
        """The nearest dimension of this name."""
        group = path.rpartition("/")[0]
        while group and f"{group}/{dim}" not in self._scales:
            group = group.rpartition("/")[0]
        return self._scales[f"{group}/{dim}"]

    def _dataset(self, path: str, shape: tuple[int, ...], dtype: Any, how: dict[str, Any]) -> Any:
        if 0 in shape:  # to netCDF a dimension without length is one that may grow
            how["maxshape"] = tuple(length or None for length in shape)
        if np.dtype(dtype).kind in "UO":
            dtype = h5py.string_dtype()
        group, _, name = path.rpartition("/")
        return self._group(group).create_dataset(name, shape, dtype, **how, **_ORDERED)

    def _group(self, path: str) -> Any:
        if path not in self._groups:
            above, _, name = path.rpartition("/")
            self._groups[path] = self._group(above).create_group(name, **_ORDERED)
        return self._groups[path]


def set_attribute(node: Any, name: str, value: Any) -> None:
    """Write a text, or numbers; netCDF-4 keeps one number as an array of one [1]. Raises errors of h5py."""
    node.attrs[name] = np.atleast_1d(value) if np.isscalar(value) and not isinstance(value, str) else value
