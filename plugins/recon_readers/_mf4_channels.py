"""The mapping of `reader.mf4`: which channel is what, in which unit, along which axes. Times are the raster's own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Final, TypeAlias

from pydantic import model_validator

from recon.parameters import setting
from recon_readers import _csv_mapping as columns
from recon_readers._mapping_parts import Part, Time

_OF_TABLES: Final = ("time", "file", "valid", "keep", "same_time")
"""Keys of a stream of `reader.csv` that mean nothing here."""
Stream: TypeAlias = columns.Stream


class Imu(columns.Imu):
    """Accelerometer and gyroscope."""

    time: Time | None = setting(None, doc="Not given: channels have times of their own.")  # type: ignore[assignment]


class Gnss(columns.Gnss):
    """A GNSS receiver."""

    time: Time | None = setting(None, doc="Not given: channels have times of their own.")  # type: ignore[assignment]


class Wheel(columns.Wheel):
    """Wheel speeds."""

    time: Time | None = setting(None, doc="Not given: channels have times of their own.")  # type: ignore[assignment]


class Baro(columns.Baro):
    """A barometer."""

    time: Time | None = setting(None, doc="Not given: channels have times of their own.")  # type: ignore[assignment]


class Channels(Part):
    """The streams that the file holds."""

    kinds: ClassVar[tuple[str, ...]] = ("imu", "gnss", "wheel", "baro")

    imu: Imu | None = setting(None, doc="Accelerometer and gyroscope.")
    gnss: Gnss | None = setting(None, doc="GNSS receiver.")
    wheel: Wheel | None = setting(None, doc="Wheel speeds.")
    baro: Baro | None = setting(None, doc="Barometer.")

    @model_validator(mode="after")
    def _not_empty(self) -> Channels:
        if not any(True for _ in self.streams()):
            raise ValueError(f"no stream is named; there are {', '.join(self.kinds)}")
        return self

    @model_validator(mode="after")
    def _of_channels(self) -> Channels:
        for stream in self.streams():
            given = [key for key in _OF_TABLES if getattr(stream, key) != type(stream).model_fields[key].default]
            given += [f"{group}.file" for group, source in stream.sources.items() if source.file]
            if given:
                raise ValueError(f"'{stream.stream}.{given[0]}' means something in tables of text only: leave it out")
        return self

    def streams(self) -> Iterator[Stream]:
        """The mapping of each stream that has one."""
        for name in self.kinds:
            found = getattr(self, name)
            if found is not None:
                yield found
