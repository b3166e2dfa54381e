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

from collections.abc import Collection, Iterable, Iterator
from typing import Any, ClassVar, Final, Literal

from pydantic import (
    ValidationInfo,
    field_validator,
    model_validator,
)

from recon.declaration import Schemas
from recon.numerics.axes import is_earth
from recon.parameters import setting
from recon.schema import STREAMS, Change
from recon.units import convert
from recon_readers._mapping_parts import Accel, Axes, Part, Scalar, Source, Time, Valid, Vector

DEGREES: Final = ("lat", "lon")
"""Groups whose unit need not be told."""


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
                raise ValueError(f"{name} needs axes of the Earth of its own, such as 'axes: NED' or 'axes: ENU'")
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
