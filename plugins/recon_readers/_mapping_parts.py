"""Parts of a mapping: a column or three, their unit and axes; a clock; which rows are valid.

A column is named by its word in the header, or by its number, which counts from 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import (
    BeforeValidator,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from recon.numerics.axes import turn
from recon.parameters import Params, setting
from recon.problems import did_you_mean
from recon.utc import start_ns, zone_ns

_TEXTS: Final = ("iso", "day_first", "month_first")


def _reference(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | str) or (isinstance(value, int) and value < 1):
        raise ValueError("a column is given by its name in the header or by its number, which counts from 1")
    return value


def _axes(value: str) -> str:
    if value:
        turn(value)
    return value


Reference: TypeAlias = Annotated[int | str, BeforeValidator(_reference)]
Axes: TypeAlias = Annotated[str, BeforeValidator(lambda value: _axes(value) if isinstance(value, str) else value)]


class Part(Params):
    """A mapping inside the mapping; its mistakes are told at its place."""

    @model_validator(mode="before")
    @classmethod
    def _of_known_keys(cls, value: Any) -> Any:
        if isinstance(value, cls):
            return value
        known = ", ".join(cls.model_fields)
        if not isinstance(value, Mapping):
            raise ValueError(f"a mapping is expected; its keys are {known}")
        for key in value:
            if key not in cls.model_fields:
                raise ValueError(f"'{key}' is not known here; {did_you_mean(key, cls.model_fields) or f'use {known}'}")
        for name, info in cls.model_fields.items():
            if info.is_required() and name not in value:
                raise ValueError(f"'{name}' is missing: {info.description}")
        return value

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What was given; what was left at its default says nothing."""
        fields = type(self).model_fields
        return {name: value for name, value in handler(self).items() if getattr(self, name) != fields[name].default}


class Time(Part):
    """The clock of a stream."""

    column: Reference | None = setting(None, doc="Column of the time.")
    columns: tuple[Reference, Reference] | None = setting(
        None, doc="Two columns in place of one: week and seconds of gps_week; date and time of a text."
    )
    format: Literal["unix", "iso", "day_first", "month_first", "gps_week", "time_of_day", "relative"] = setting(
        doc="unix, iso, day_first, month_first, gps_week, time_of_day or relative"
    )
    unit: Literal["s", "ms", "us", "ns"] = setting("s", doc="Unit of a time that is a number.")
    scale: Literal["UTC", "GPS"] = setting("UTC", doc="GPS: the clock counts no leap seconds; gps_week never does.")
    zone: str = setting("+00:00", doc="Clock of texts that name no zone, such as +02:00.")
    start: str = setting("", doc="Zero of relative times, or date of time_of_day, as ISO 8601.")

    @model_validator(mode="after")
    def _of_columns(self) -> Time:
        if (self.column is None) == (self.columns is None):
            raise ValueError("the time needs either 'column' or 'columns'")
        if (self.format == "gps_week") != (self.columns is not None) and self.format not in _TEXTS:
            raise ValueError("gps_week needs 'columns: [week, seconds]', and every other number one 'column'")
        zone = zone_ns(self.zone)
        try:
            start_ns(self.start or "1970-01-01", zone)
        except ValueError:
            raise ValueError(
                f"the start '{self.start:.40}' is no ISO 8601 time of a log; write 2026-06-08T14:54:08Z"
            ) from None
        return self

    @property
    def zone_ns(self) -> int:
        """Local time minus UTC in ns."""
        return zone_ns(self.zone)

    @property
    def start_ns(self) -> int:
        """The zero of the times as ns since 1970 UTC, 0 where none is given."""
        return start_ns(self.start, self.zone_ns) if self.start else 0

    @property
    def references(self) -> tuple[int | str, ...]:
        """The columns that the time is in."""
        return self.columns or (() if self.column is None else (self.column,))


class Source(Part):
    """Where the values of a group stand."""

    unit: str = setting("", doc="Unit, such as m/s^2, g, deg/s, km/h.")
    scale: float = setting(1.0, doc="What the file writes as 1, in that unit: 6.1035e-5 for counts of 1/16384.")
    invalid: tuple[float, ...] = setting((), doc="Numbers that stand for no value, such as -1 or -9999.")
    file: str = setting("", doc="Name of the file that holds it, such as *gyro*; the stream's where not given.")

    @property
    def references(self) -> tuple[int | str, ...]:
        """The columns, one for each of the group."""
        raise AttributeError


class Scalar(Source):
    """A single column."""

    column: Reference = setting(doc="Name or number of the column.")

    @property
    def references(self) -> tuple[int | str, ...]:
        """The column."""
        return (self.column,)


class Vector(Source):
    """Three columns: x, y, z as logged."""

    columns: tuple[Reference, Reference, Reference] = setting(doc="Names or numbers of the columns of x, y and z.")
    axes: Axes = setting("", doc="Where x, y and z point, such as FLU or NED; the stream's where not given.")

    @property
    def references(self) -> tuple[int | str, ...]:
        """The columns of x, y and z."""
        return self.columns


class Accel(Vector):
    """An accelerometer."""

    at_rest: Literal["up", "down", "zero"] = setting(
        "up", doc="What it shows at rest: up (specific force), down (-g, as iPhones), zero (gravity already removed)."
    )


class Valid(Part):
    """Rows that count."""

    column: Reference = setting(doc="Name or number of the column.")
    values: tuple[int | float | str, ...] = setting(doc="Rows with one of these are kept, the others are not.")
