"""The mapping of `reader.csv`: which column is what, in which unit, along which axis, on which clock.

    imu:
      time: {column: millis, format: unix, unit: ms}
      axes: FRD
      accel: {columns: [ax, ay, az], unit: g}
      gyro: {columns: [gx, gy, gz], unit: deg/s}
    gnss:
      time: {columns: [week, sow], format: gps_week}
      height_datum: ellipsoid
      lat: {column: 4}
      ...

A column is named by its word in the header, or by its number, which counts from 1.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, TypeAlias

from pydantic import (
    BeforeValidator,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from recon.numerics.axes import is_earth, turn
from recon.parameters import Params, setting
from recon.problems import did_you_mean
from recon.schema import STREAMS, Change
from recon.stages import Schemas
from recon.units import convert
from recon.utc import iso_ns, zone_ns

_TEXTS: Final = ("iso", "day_first", "month_first")
DEGREES: Final = ("lat", "lon")
"""Groups whose unit need not be told."""


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
            iso_ns(self.start or "1970-01-01", zone)
        except ValueError:
            raise ValueError(f"the start '{self.start:.40}' is no ISO 8601 time; write 2026-06-08T14:54:08Z") from None
        return self

    @property
    def zone_ns(self) -> int:
        """Local time minus UTC in ns."""
        return zone_ns(self.zone)

    @property
    def start_ns(self) -> int:
        """The zero of the times as ns since 1970 UTC, 0 where none is given."""
        return iso_ns(self.start, self.zone_ns) if self.start else 0

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


class Stream(Part):
    """What every stream has."""

    stream: ClassVar[str] = ""

    time: Time = setting(doc="The clock: {column: ..., format: unix | iso | relative | ...}")
    file: str = setting("", doc="Name of the file that holds the stream, such as *gps*; any file where not given.")
    valid: Valid | None = setting(None, doc="Which rows count.")
    keep: Literal["auto", "all", "changes"] = setting(
        "auto", doc="all rows with values; changes: those that differ from the last; auto: what the values tell."
    )
    same_time: Literal["refuse", "first"] = setting("refuse", doc="What becomes of rows of one time: first keeps one.")

    @field_validator("*", mode="after")
    @classmethod
    def _in_a_unit(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, Source):
            (wanted, *_) = STREAMS[cls.stream].columns_of(info.field_name or "")
            if wanted.unit and not value.unit and wanted.name not in DEGREES:
                raise ValueError(f"'unit' is missing: write the unit of the file, such as {wanted.unit}")
            if not wanted.unit and value.unit:
                raise ValueError(f"{wanted.name} has no unit")
            convert(1.0, value.unit or wanted.unit or "1", wanted.unit or "1")
        return value

    @model_validator(mode="after")
    def _not_empty(self) -> Stream:
        if not self.sources:
            raise ValueError(f"no column of '{self.stream}' is named")
        return self

    @property
    def sources(self) -> dict[str, Scalar | Vector]:
        """Where each group stands, by group."""
        given = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: value for name, value in given.items() if isinstance(value, Scalar | Vector)}

    def axes_of(self, group: str) -> str:
        """Where x, y and z of a group point, "" where it is not told."""
        return getattr(self.sources[group], "axes", "") or str(getattr(self, "axes", ""))

    def file_of(self, group: str) -> str:
        """Pattern of the name of the file that holds a group, "" for any."""
        return self.sources[group].file or self.file


class Imu(Stream):
    """Accelerometer and gyroscope."""

    stream: ClassVar[str] = "imu"

    axes: Axes = setting("", doc="Where x, y and z point, such as FLU or FRD; not given: as logged.")
    accel: Accel | None = setting(None, doc="Accelerometer.")
    gyro: Vector | None = setting(None, doc="Gyroscope; a turn is positive by the right hand about its axis.")
    temperature: Scalar | None = setting(None, doc="Temperature of the sensors.")


class Gnss(Stream):
    """A GNSS receiver."""

    stream: ClassVar[str] = "gnss"

    height_datum: Literal["mean_sea_level", "ellipsoid"] | None = setting(
        None, doc="Surface above which the height counts; needed with a height."
    )
    north: Literal["true", "magnetic"] = setting("true", doc="North from which the course counts.")
    lat: Scalar | None = setting(None, doc="Latitude.")
    lon: Scalar | None = setting(None, doc="Longitude.")
    height: Scalar | None = setting(None, doc="Height.")
    speed: Scalar | None = setting(None, doc="Speed over ground.")
    course: Scalar | None = setting(None, doc="Course over ground, clockwise from north.")
    vel: Vector | None = setting(None, doc="Velocity; needs axes such as NED or ENU.")
    pos_std: Vector | None = setting(None, doc="Standard deviation of the position; needs axes.")
    vel_std: Vector | None = setting(None, doc="Standard deviation of the velocity; needs axes.")
    fix: Scalar | None = setting(None, doc="0 none, 1 time only, 2 two-dimensional, 3 three-dimensional.")
    satellites: Scalar | None = setting(None, doc="Number of satellites used.")

    @model_validator(mode="after")
    def _told_of_the_earth(self) -> Gnss:
        if self.height is not None and self.height_datum is None:
            raise ValueError("'height_datum' is missing: write mean_sea_level or ellipsoid")
        for name, source in self.sources.items():
            if isinstance(source, Vector) and not is_earth(source.axes):
                raise ValueError(f"{name} needs axes of the Earth, such as 'axes: NED' or 'axes: ENU'")
        return self


class Mag(Stream):
    """A magnetometer."""

    stream: ClassVar[str] = "mag"

    axes: Axes = setting("", doc="Where x, y and z point, such as FLU or FRD; not given: as logged.")
    mag: Vector = setting(doc="Magnetic flux density.")


class Baro(Stream):
    """A barometer."""

    stream: ClassVar[str] = "baro"

    pressure: Scalar = setting(doc="Pressure.")
    temperature: Scalar | None = setting(None, doc="Temperature of the sensor.")


class Wheel(Stream):
    """Wheel speeds."""

    stream: ClassVar[str] = "wheel"

    speed: Scalar = setting(doc="Speed of the vehicle by its wheels.")
    speed_front_left: Scalar | None = setting(None, doc="Speed of a wheel.")
    speed_front_right: Scalar | None = setting(None, doc="Speed of a wheel.")
    speed_rear_left: Scalar | None = setting(None, doc="Speed of a wheel.")
    speed_rear_right: Scalar | None = setting(None, doc="Speed of a wheel.")
    steering_angle: Scalar | None = setting(None, doc="Angle of the front wheels, positive to the left.")


class Columns(Part):
    """The streams that the file holds."""

    imu: Imu | None = setting(None, doc="Accelerometer and gyroscope.")
    gnss: Gnss | None = setting(None, doc="GNSS receiver.")
    mag: Mag | None = setting(None, doc="Magnetometer.")
    baro: Baro | None = setting(None, doc="Barometer.")
    wheel: Wheel | None = setting(None, doc="Wheel speeds.")

    @model_validator(mode="after")
    def _not_empty(self) -> Columns:
        if not any(True for _ in self.streams()):
            raise ValueError(f"no stream is named; there are {', '.join(type(self).model_fields)}")
        return self

    def streams(self) -> Iterator[Stream]:
        """The mapping of each stream that has one."""
        for name in type(self).model_fields:
            found = getattr(self, name)
            if found is not None:
                yield found


def schemas(mappings: Iterable[Stream]) -> Schemas:
    """The streams and columns of mappings, as a reader plans them."""
    found = {}
    for mapping in mappings:
        schema = STREAMS[mapping.stream].only(*mapping.sources).possible()
        accel = mapping.sources.get("accel")
        if isinstance(accel, Accel) and accel.at_rest == "zero":
            schema = Change(quantities={"accel": "acceleration"}).apply(schema)
        found[mapping.stream] = schema
    return found


def gnss_facts(mapping: Stream, groups: Collection[str]) -> dict[str, str]:
    """What a mapping says of these columns of a GNSS receiver; nothing of other sensors."""
    facts: dict[str, str] = {}
    if isinstance(mapping, Gnss):
        if "height" in groups and mapping.height_datum:
            facts["height_datum"] = mapping.height_datum
        if "course" in groups:
            facts["heading_kind"] = "course_true" if mapping.north == "true" else "magnetic"
    return facts
