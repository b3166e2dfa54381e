"""Every stream in one HDF5 file: for MATLAB, Julia and whoever keeps HDF5.

    /<stream>                  a group, its attributes the stream's own facts (anchor, height_datum, ...)
    /<stream>/<column>         (n,) with the attributes unit, frame and quantity
    attributes of the file     name, recon (its version), manifest (JSON, without its block `environment`)

    doubles                    as they are, NaN where a value is missing
    integers, true and false   as they are; as doubles with NaN where some are missing
    times                      int64, ns since 1970-01-01, UTC unless the stream's fact time_scale says otherwise
    texts                      UTF-8 of variable length, empty where missing
    lists, as in knots         single precision, of variable length

Columns are compressed with the filters shuffle and gzip, which every HDF5 library brings.

References
    The HDF Group, HDF5 File Format Specification, version 3.0.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon import __version__
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import NoParams
from recon.schema import Column
from recon.stages import Exporter
from recon.storage.json_text import readable, to_json
from recon.tables import meta, schema_of, time_ns, vector

_GZIP: Final = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "chunks": True}


def hdf5(*, streams: Mapping[str, pa.Table], folder: Path, about: RunInfo, params: NoParams) -> list[Path]:
    """Write `folder/recording.h5`; its path. Raises PluginError where h5py is not installed."""
    with needs("exporter.hdf5", "h5py", extra="hdf5"):
        import h5py
    path = folder / "recording.h5"
    manifest = {key: value for key, value in about.manifest.items() if key != "environment"}
    with h5py.File(path, "w") as file:
        file.attrs.update({"name": about.name, "recon": __version__, "manifest": to_json(manifest)})
        for name, table in streams.items():
            group = file.create_group(name)
            group.attrs.update({key: _attribute(value) for key, value in meta(table).items()})
            for column in schema_of(table).columns:
                _write(group, column, table)
    return [path]


def _attribute(value: Any) -> Any:
    """A fact as HDF5 holds it: texts and numbers as they are, all else as JSON."""
    return value if isinstance(value, str | int | float) else json.dumps(value)


def _write(group: Any, column: Column, table: pa.Table) -> None:
    values, facts = _values(column, table), {}
    if values.dtype == object:
        from h5py import string_dtype, vlen_dtype

        kind = vlen_dtype(np.float32) if pa.types.is_list(column.type) else string_dtype()
        facts = {"dtype": kind}
    compressed = _GZIP if len(values) else {}
    dataset = group.create_dataset(column.name, data=values, **facts, **compressed)
    told = {"unit": column.unit, "frame": column.frame, "quantity": column.quantity}
    if pa.types.is_timestamp(column.type):
        told["unit"] = "ns since 1970-01-01T00:00:00Z"
    dataset.attrs.update({key: value for key, value in told.items() if value})


def _values(column: Column, table: pa.Table) -> np.ndarray[Any, Any]:
    """A column as an array; of dtype object where its values differ in length."""
    kind, values = column.type, table[column.name]
    if pa.types.is_timestamp(kind):
        return time_ns(table, column.name)
    if pa.types.is_string(kind):
        return np.array([readable(text) for text in values.fill_null("").to_pylist()], dtype=object)
    if pa.types.is_list(kind):
        lists = np.empty(table.num_rows, dtype=object)
        lists[:] = [np.array(items or [], dtype=np.float32) for items in values.to_pylist()]
        return lists
    if pa.types.is_floating(kind) or values.null_count:
        return vector(table, column.name, gaps=True)
    return np.asarray(values.combine_chunks().to_numpy(zero_copy_only=False))


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of HDF5 files."""
    yield Exporter(
        name="hdf5",
        summary="Every stream as HDF5, for MATLAB, Julia and whoever keeps it.",
        run=hdf5,
        every_stream=True,
        made_with=("h5py",),
        references=("HDF5 File Format Specification 3.0",),
    )
