"""Entry points to records: lazy, by name.

All names are known from the metadata of the installed distributions; a module is imported when its stage is asked
for, and a broken one is reported only then. A registry is a value that is passed on, never a global.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Final

from recon.errors import PluginBroken, PluginConflict, PluginInvalid, PluginNotFound
from recon.problems import did_you_mean
from recon.stages import ROLES, Stage, role_of

GROUP: Final = "recon.plugins"
PIPELINE: Final = "pipeline."
"""Beginning of the names of entry points that are pipelines, not stages."""

_TELL_AUTHOR: Final = "tell its author, or uninstall it"


@dataclass(frozen=True)
class Source:
    """Where a stage comes from: the distribution with its version, and the module; "" where there is none."""

    distribution: str = ""
    version: str = ""
    module: str = ""

    def __str__(self) -> str:
        return f"{self.distribution} {self.version}".strip() or self.module


class Registry:
    """The stages at hand."""

    def __init__(self, sources: dict[str, list[Source]], records: Iterable[Stage] = ()) -> None:
        self._sources = sources
        self._records: dict[str, Stage] = {}
        for record in records:
            _verify(record, Source())
            self._records[record.key] = record
            self._sources[record.key] = [Source(module=record.run.__module__)]

    @classmethod
    def installed(cls) -> Registry:
        """The stages of all installed distributions."""
        sources: dict[str, list[Source]] = {}
        for point in entry_points(group=GROUP):
            if not point.name.startswith(PIPELINE):
                sources.setdefault(point.name, []).append(_source(point))
        return cls(sources)

    @classmethod
    def of(cls, *records: Stage) -> Registry:
        """Only the records given; for tests and for stages made in a notebook."""
        return cls({}, records)

    def with_records(self, *records: Stage) -> Registry:
        """These stages and the records given, which win over those of the same name."""
        joined = Registry(dict(self._sources), records)
        joined._records = {**self._records, **joined._records}
        return joined

    def __contains__(self, key: object) -> bool:
        return key in self._sources

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._sources))

    def names(self, role: str) -> list[str]:
        """Keys of one role, sorted."""
        return [key for key in self if role_of(key) == role]

    def source(self, key: str) -> Source:
        """Where the stage of that name comes from."""
        return self._sources[key][0]

    def get(self, key: str) -> Stage:
        """The record of a stage; imports its module on first use.

        Raises PluginNotFound, PluginConflict, PluginBroken, PluginInvalid.
        """
        if key not in self._records:
            self._records[key] = self._load(key)
        return self._records[key]

    def _load(self, key: str) -> Stage:
        sources = self._sources.get(key)
        if not sources:
            raise PluginNotFound(f"there is no stage '{key}'", self.suggest(key))
        if len(sources) > 1:
            claims = " and ".join(f"{source.distribution} {source.version} ({source.module})" for source in sources)
            raise PluginConflict(f"the stage '{key}' is claimed by {claims}", "uninstall one of them")
        record = _declared(sources[0]).get(key)
        if record is None:
            raise PluginBroken(f"{sources[0].module} ({sources[0]}) declares no stage '{key}'", _TELL_AUTHOR)
        return record

    def suggest(self, key: str) -> str:
        """What else the user may have meant."""
        role, _, name = key.partition(".")
        if role not in ROLES:
            anywhere = [known for known in self if known.partition(".")[2] == (name or key)]
            return f"did you mean '{anywhere[0]}'?" if anywhere else did_you_mean(key, self) or "see 'recon plugins'"
        return did_you_mean(key, self.names(role)) or f"installed: {', '.join(self.names(role)) or 'none of that role'}"


def _source(point: EntryPoint) -> Source:
    distribution = point.dist
    name, version = (distribution.name, distribution.version) if distribution else ("", "")
    return Source(name, version, point.value.partition(":")[0].strip())


def _declared(source: Source) -> dict[str, Stage]:
    """Records that a module declares, verified, by key."""
    import pluggy

    from recon import hookspecs

    try:
        module = importlib.import_module(source.module)
    except Exception as error:  # whatever a stranger's module raises while it is imported
        raise PluginBroken(
            f"{source.module} ({source}) cannot be imported: {type(error).__name__}: {error}", _TELL_AUTHOR
        ) from error
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    try:
        manager.register(module)
        manager.check_pending()
        declared = [
            record for role in ROLES for records in getattr(manager.hook, f"declare_{role}s")() for record in records
        ]
        for record in declared:
            _verify(record, source)
    except PluginInvalid:
        raise
    except Exception as error:  # a hook of a wrong name, a wrong argument, or its body
        raise PluginBroken(
            f"{source.module} ({source}) cannot be used: {type(error).__name__}: {error}", _TELL_AUTHOR
        ) from error
    return {record.key: record for record in declared}


def _verify(record: Stage, source: Source) -> None:
    if not isinstance(record, Stage) or not record.role:
        raise PluginInvalid(f"{source.module} yields a {type(record).__name__}, which is no record", _TELL_AUTHOR)
    faults = record.faults()
    if faults:
        raise PluginInvalid(f"{record.key}: {'; '.join(faults)}", _TELL_AUTHOR)
