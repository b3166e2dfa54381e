"""Streams as JSON messages, a row each, with a JSON Schema that holds the units.

    {"time":{"sec":1714550400,"nsec":10000000},"accel_x":0.0981,...}

A number reads back to the same double; what is missing is left out; lists, as in knots, are left out altogether.

References
    RFC 8259; JSON Schema, json-schema.org/draft/2020-12; MCAP format registry, "json" and "jsonschema".
"""

from __future__ import annotations

import json
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.schema import Column
from recon.tables import meta, schema_of, time_ns
from recon_exporters._mcap_file import Channel

_NS: Final = 1_000_000_000
_TIME: Final = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}


def json_channel(stream: str, table: pa.Table, start_ns: int) -> Channel:
    """The channel of a stream; all its messages at `start_ns` where its rows have no time."""
    columns = [column for column in schema_of(table).columns if not pa.types.is_list(column.type)]
    whole = table.select([column.name for column in columns])
    timed = "time" in table.column_names
    schema = {
        "title": f"recon.{stream}",
        "type": "object",
        "properties": {column.name: _described(column) for column in columns},
    }
    return Channel(
        topic=f"/{stream}",
        encoding="json",
        schema_name=f"recon.{stream}",
        schema_encoding="jsonschema",
        schema=json.dumps(schema).encode(),
        t_ns=time_ns(table) if timed else np.full(table.num_rows, start_ns),
        encode=lambda rows: _objects(whole.slice(rows.start, rows.stop - rows.start)),
        about={key: json.dumps(value) for key, value in meta(table).items()},
    )


def _described(column: Column) -> dict[str, Any]:
    if pa.types.is_timestamp(column.type):
        return _TIME
    told = {"": column.quantity, "in ": column.unit, "frame ": column.frame}
    description = ", ".join(f"{before}{fact}" for before, fact in told.items() if fact)
    return {"type": _kind(column.type), "description": description}


def _kind(kind: pa.DataType) -> str:
    if pa.types.is_floating(kind):
        return "number"
    if pa.types.is_integer(kind):
        return "integer"
    return "boolean" if pa.types.is_boolean(kind) else "string"


def _objects(table: pa.Table) -> pa.Array:
    """The rows as JSON texts, (n,) bytes; what is missing in a row is left out there, but null in the first column."""
    import pyarrow.compute as pc  # slow import: only when used

    parts: list[Any] = []
    for number, name in enumerate(table.column_names):
        text, key = _texts(table[name].combine_chunks()), f"{',' if number else '{'}{json.dumps(name)}:"
        if not number:
            text = text.fill_null("null")
        parts += [pc.binary_join_element_wise(key, text, "")] if text.null_count else [key, text]
    whole = pc.binary_join_element_wise(*parts, "}", "", null_handling="replace", null_replacement="")
    return whole.cast(pa.binary())


def _texts(values: pa.Array) -> pa.Array:
    """Values as JSON texts, (n,); null for what JSON does not know."""
    import pyarrow.compute as pc  # slow import: only when used

    if pa.types.is_timestamp(values.type):
        return _times(np.asarray(values.cast(pa.int64())))
    if pa.types.is_floating(values.type):
        return pc.if_else(pc.is_finite(values), values, None).cast(pa.string())
    if pa.types.is_string(values.type):
        coded = values.dictionary_encode()
        return pa.array([json.dumps(text) for text in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    return values.cast(pa.string())


def _times(t_ns: NDArray[np.int64]) -> pa.Array:
    import pyarrow.compute as pc  # slow import: only when used

    sec, nsec = (pa.array(part).cast(pa.string()) for part in (t_ns // _NS, t_ns % _NS))
    return pc.binary_join_element_wise('{"sec":', sec, ',"nsec":', nsec, "}", "")
