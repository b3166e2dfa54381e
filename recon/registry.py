"""Entry points to records: lazy, by name.

All names are known from the metadata of the installed distributions; a module is imported when its stage is asked
for, and a broken one is reported only then. A registry is a value that is passed on, never a global.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Final

from recon import __version__
from recon.declaration import Stage
from recon.errors import ConfigError, PluginBroken, PluginConflict, PluginInvalid, PluginNotFound
from recon.problems import Problem, Where, did_you_mean
from recon.requirement import FIRST_PARTY, canonical, requirements_of, unmet
from recon.stages import ROLES, role_of

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

    def __init__(
        self,
        sources: dict[str, list[Source]],
        records: Iterable[Stage] = (),
        blocked: Mapping[str, str] | None = None,
        options: Sequence[str] | None = None,
    ) -> None:
        self.options = options
        """Of a command that finds the same stages; None where no command does, for some are not installed."""
        self._sources = sources
        self._blocked = blocked or {}
        self._records: dict[str, Stage] = {}
        for record in records:
            _verify(record, Source())
            self._records[record.key] = record
            self._sources[record.key] = [Source(module=record.run.__module__)]

    @classmethod
    def installed(cls, *, block: Collection[str] = (), first_party_only: bool = False) -> Registry:
        """The stages of all installed distributions; those that are blocked count as not installed.

        block : stages by their key, and distributions, as with `--no-plugin`
        first_party_only : block all but recon's own, as with `--first-party-only`

        Raises ConfigError for a name in `block` that is neither: whoever blocks wants to be sure.
        """
        found = _installed_sources()
        _refuse_unknown(block, found)
        sources: dict[str, list[Source]] = {}
        blocked: dict[str, str] = {}
        for key, source in found:
            option = _blocking(key, source, block, first_party_only=first_party_only)
            if option:
                blocked[key] = f"the stage '{key}' ({source}) is blocked by {option}"
            else:
                sources.setdefault(key, []).append(source)
        options = [word for name in block for word in ("--no-plugin", name)] + ["--first-party-only"] * first_party_only
        return cls(sources, blocked=blocked, options=options)

    @classmethod
    def of(cls, *records: Stage) -> Registry:
        """Only the records given; for tests and for stages made in a notebook."""
        return cls({}, records)

    def with_records(self, *records: Stage) -> Registry:
        """These stages and the records given, which win over those of the same name."""
        joined = Registry(dict(self._sources), records, self._blocked)
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

        Raises PluginNotFound, also for one that is blocked, PluginConflict, PluginBroken, PluginInvalid.
        """
        if key not in self._records:
            self._records[key] = self._load(key)
        return self._records[key]

    def _load(self, key: str) -> Stage:
        sources = self._sources.get(key)
        if not sources:
            raise self.not_found(key)
        if len(sources) > 1:
            claims = " and ".join(f"{source.distribution} {source.version} ({source.module})" for source in sources)
            hint = "uninstall one of them, or block one with --no-plugin DISTRIBUTION"
            raise PluginConflict(f"the stage '{key}' is claimed by {claims}", hint)
        _refuse_too_new(sources[0])
        record = _declared(sources[0]).get(key)
        if record is None:
            text = f"{sources[0].module} ({sources[0]}) declares no stage '{key}'"
            hook = f"its function declare_{role_of(key)}s, marked with @hookimpl, is to yield it"
            raise PluginBroken(f"{text}: {hook}", _TELL_AUTHOR)
        return record

    def not_found(self, key: str) -> PluginNotFound:
        """Why a stage is not here, and what to do: to be raised, or told among other problems."""
        if key in self._blocked:
            return PluginNotFound(self._blocked[key], "leave the option away, or use another stage")
        return PluginNotFound(f"there is no stage '{key}'", self.suggest(key))

    def suggest(self, key: str) -> str:
        """What else the user may have meant."""
        role, _, name = key.partition(".")
        if role not in ROLES:
            anywhere = [known for known in self if known.partition(".")[2] == (name or key)]
            return f"did you mean '{anywhere[0]}'?" if anywhere else did_you_mean(key, self) or "see 'recon plugins'"
        return did_you_mean(key, self.names(role)) or f"installed: {', '.join(self.names(role)) or 'none of that role'}"


def _installed_sources() -> list[tuple[str, Source]]:
    """Stage and source of every entry point; the metadata of a distribution are parsed once, which takes a while."""
    told: dict[int, tuple[str, str]] = {}
    found = []
    for point in entry_points(group=GROUP):
        if point.name.startswith(PIPELINE):
            continue
        distribution = point.dist
        if id(distribution) not in told:
            told[id(distribution)] = (distribution.name, distribution.version) if distribution else ("", "")
        found.append((point.name, Source(*told[id(distribution)], point.value.partition(":")[0].strip())))
    return found


def _blocking(key: str, source: Source, block: Collection[str], *, first_party_only: bool) -> str:
    """The option that blocks a stage of that source, "" where none does."""
    for name in block:
        if name == key or canonical(name) == canonical(source.distribution):
            return f"--no-plugin {name}"
    foreign = canonical(source.distribution) != FIRST_PARTY
    return "--first-party-only" if first_party_only and foreign else ""


def _refuse_unknown(block: Collection[str], found: Collection[tuple[str, Source]]) -> None:
    known = sorted({name for key, source in found for name in (key, source.distribution)})
    problems = [
        Problem(
            Where(f"--no-plugin {name}"),
            "bad-option",
            f"there is neither a stage nor a distribution '{name}'",
            did_you_mean(name, known) or "see 'recon plugins'",
        )
        for name in block
        if not any(_blocking(key, source, [name], first_party_only=False) for key, source in found)
    ]
    if problems:
        raise ConfigError(problems)


def _refuse_too_new(source: Source) -> None:
    """Raises PluginBroken where a distribution needs a newer recon, which its import might not survive."""
    if canonical(source.distribution) in ("", FIRST_PARTY):
        return
    needed = unmet(requirements_of(source.distribution), __version__)
    if needed:
        raise PluginBroken(f"{source} needs {needed}, this is {__version__}", "update recon")


def _declared(source: Source) -> dict[str, Stage]:
    """Records that a module declares, verified, by key."""
    import pluggy

    from recon import hookspecs

    try:
        module = importlib.import_module(source.module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a stranger's module raises while it is imported
        raise PluginBroken(
            f"{source.module} ({source}) cannot be imported: {type(error).__name__}: {error}", _TELL_AUTHOR
        ) from error
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    try:
        manager.register(module)
        manager.check_pending()
        hooks = [f"declare_{role}s" for role in ROLES]
        returned = [(hook, records) for hook in hooks for records in getattr(manager.hook, hook)()]
        for hook, records in returned:
            if isinstance(records, Stage):
                text = f"{source.module} ({source}): {hook} returns {records.key}, it is to yield it"
                raise PluginInvalid(text, _TELL_AUTHOR)
        declared = [record for _, records in returned for record in records]
        for record in declared:
            _verify(record, source)
    except PluginInvalid:
        raise
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a hook of a wrong name, a wrong argument, or its body
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
