"""Topics of a log to streams: which are read, by their types or by parameters; several of a kind; what is left.

A topic becomes a stream by the type of its messages, `_message_kinds`. Of several IMUs the first by name becomes imu,
the next imu_2, and so on. Messages whose meaning their type does not settle, such as an Odometry, are read where a
parameter names their topic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import BeforeValidator

from recon.errors import NothingUsable, ReadFailed
from recon.parameters import Params, setting
from recon.problems import did_you_mean
from recon.rows import Metric, metrics, warning
from recon.schema import STREAMS
from recon.stages import Wanted
from recon.tables import Array, Streams, with_meta
from recon_readers._arrays import interleave
from recon_readers._collector import Collector, Language
from recon_readers._limits import MOST_FAULTY, possible
from recon_readers._mapping_parts import Axes
from recon_readers._message_kinds import KINDS, Kind
from recon_readers._sensing import doubts, turned
from recon_readers._streams import described, valued
from recon_readers._time_order import EARLIEST_NS, Times, rising

READ: Final = ("imu", "gnss", "mag", "baro", "wheel", "reference")
"""Streams that topics can become."""
_MOST_NAMED: Final = 10

Names: TypeAlias = Annotated[
    tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)
]


class TopicParams(Params):
    """Which topics are read, and what their types leave open."""

    imu: Names = setting((), doc="Topics of imu, the first becomes imu, the next imu_2; by type where not given.")
    gnss: Names = setting((), doc="Topics of gnss; a TwistStamped here is a velocity east, north, up.")
    mag: Names = setting((), doc="Topics of mag; by type where not given.")
    baro: Names = setting((), doc="Topics of baro; by type where not given.")
    wheel: Names = setting((), doc="Topics of wheel: an Odometry or a TwistStamped whose x is the wheels' speed.")
    reference: Names = setting((), doc="Topics of reference: an Odometry, a PoseStamped, PoseInFrame, FrameTransform.")
    axes: Axes = setting("FLU", doc="Where x, y, z of imu and mag point: FLU by REP 103; some drivers write FRD.")
    at_rest: Literal["up", "down"] = setting("up", doc="What a still accelerometer shows: +g upwards, or downwards.")
    time: Literal["stamp", "log"] = setting("stamp", doc="Times of measurement in the messages, or of recording.")
    height_datum: Literal["mean_sea_level", "ellipsoid"] | None = setting(
        None, doc="Surface above which GNSS heights count; by the type where not given: NavSatFix says ellipsoid."
    )

    def named(self, stream: str) -> tuple[str, ...]:
        """The topics of a stream, none where their types tell."""
        found: tuple[str, ...] = getattr(self, stream)
        return found


@dataclass(frozen=True)
class Part:
    """What a topic gives a stream: the kind of message, and the path to it inside the topic's messages."""

    kind: Kind
    path: str

    def paths(self, wanted: Wanted) -> list[str]:
        """What is read of it; nothing where the stream is not wanted."""
        columns = wanted.of(self.kind.stream, self.kind.columns)
        return [self.path + self.kind.columns[name] for name in columns] + [
            self.path + path for path in self.kind.beside if columns
        ]


@dataclass
class Topic:
    """A topic that was seen; `collector` is None where nothing of it is read."""

    type: str
    parts: list[Part] = field(default_factory=list)
    collector: Collector | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    count: int = 0


@dataclass(frozen=True)
class Channel:
    """How a file calls a topic."""

    topic: Topic
    language: Language

    def add(self, message: bytes, logged_ns: int) -> None:
        """Take in a message, with the time in ns at which it was recorded."""
        self.topic.count += 1
        if self.topic.collector is not None:
            self.topic.collector.add(self.language, message, logged_ns)


class Intake:
    """All topics of a log, and what becomes of them."""

    def __init__(self, path: Path, reader: str, params: TopicParams, wanted: Wanted) -> None:
        self.path, self.reader, self.params, self.wanted = path, reader, params, wanted
        self.topics: dict[str, Topic] = {}
        self.learnt: list[Metric] = []

    def uses(self, topic: str, parts: Iterable[tuple[str, str]]) -> bool:
        """Is anything of a topic of these message types (path, type) read? To be asked before a definition is."""
        return any(self._is_read(topic, kind) for _, name in parts for kind in KINDS.get(name, ()))

    def channel(
        self, topic: str, name: str, parts: Iterable[tuple[str, str]], language: Language, **facts: Any
    ) -> Channel:
        """A channel of a file, whose messages hold the types `parts` (path, type); facts : of its streams."""
        known = self.topics.get(topic)
        if known is None or known.type != name:
            known = self.topics.setdefault(topic if known is None else f"{topic} ({name})", Topic(name))
        if not known.parts:
            known.parts = [Part(kind, path) for path, part in parts for kind in KINDS.get(part, ())]
            known.facts = facts
            read = [part for part in known.parts if self._is_read(topic, part.kind)]
            paths = [path for part in read for path in part.paths(self.wanted)]
            if paths:
                known.collector = Collector(paths, [part.path + part.kind.stamp for part in read])
        return Channel(known, language)

    def _is_read(self, topic: str, kind: Kind) -> bool:
        if not self.wanted.of(kind.stream, kind.columns):
            return False
        named = self.params.named(kind.stream)
        return topic in named if named else not kind.asked

    # --- what comes of it -------------------------------------------------------------------------------------------

    def streams(self, **facts: Any) -> Streams:
        """All streams. Raises ReadFailed where a parameter names what is not there, NothingUsable without a stream."""
        self._refuse_unknown()
        made: dict[str, pa.Table] = {}
        for stream in READ:
            made |= self._numbered(stream, list(self._sources(stream)), facts)
        if not made:
            raise self._nothing()
        self._account()
        self._compare_clocks(made)
        return {**made, "metrics": metrics([*self.learnt, *doubts(made)])}

    def _sources(self, stream: str) -> Iterator[tuple[str, Topic, Part]]:
        """(topic's name, topic, part) of what a stream is made of, in the order in which it is numbered."""
        for name in self.params.named(stream) or sorted(self.topics):
            topic = self.topics.get(name)
            if topic is not None and topic.collector is not None:
                fitting = [part for part in topic.parts if part.kind.stream == stream]
                yield from ((name, topic, part) for part in fitting[:1] if self._is_read(name, part.kind))

    def _numbered(
        self, stream: str, sources: Sequence[tuple[str, Topic, Part]], facts: Mapping[str, Any]
    ) -> dict[str, pa.Table]:
        """imu, imu_2, ... of what is found. A topic with columns that an earlier one lacks completes it."""
        groups: list[list[tuple[str, Times, dict[str, Array], dict[str, Any]]]] = []
        for name, topic, part in sources:
            t_ns, columns = self._read(name, topic, part)
            if not columns:
                continue
            own = {**facts, **self._facts(topic, part, columns)}
            home = next((g for g in groups if not any(set(columns) & set(one[2]) for one in g)), None)
            (home.append if home else lambda one: groups.append([one]))((name, t_ns, columns, own))
        made = {}
        for number, group in enumerate(groups, start=1):
            key = stream if number == 1 else f"{stream}_{number}"
            made[key] = _table(stream, group)
            note = ", ".join(f"{name} ({self.topics[name].type})" for name, *_ in group)
            self.learnt.append(Metric("topic", float(made[key].num_rows), method=key, note=note))
        if len(made) > 1:
            told = ", ".join(f"{key} is {group[0][0]}" for key, group in zip(made, groups, strict=True))
            choice = f"choose with --set {self.reader}.{stream}=TOPIC"
            self.learnt.append(warning(f"{told}: steps read {stream} unless told otherwise; {choice}"))
        return made

    def _read(self, name: str, topic: Topic, part: Part) -> tuple[Times, dict[str, Array]]:
        """Times that rise and the columns at them; none where the topic has no message that is whole."""
        assert topic.collector is not None
        collector = topic.collector
        t_ns = collector.times("" if self.params.time == "log" else part.path + part.kind.stamp)
        if not len(t_ns):
            t_ns = collector.times("")
            if len(t_ns):
                note = f"{name}: no message has a time of measurement: those of recording are taken"
                self.learnt.append(warning(note))
        wanted = self.wanted.of(part.kind.stream, part.kind.columns)
        columns = {column: collector.numbers(part.path + part.kind.columns[column]) for column in wanted}
        columns |= {path: collector.numbers(part.path + path) for path in part.kind.beside}
        rows = self._in_order(name, t_ns)
        columns = part.kind.finish({key: values[rows] for key, values in columns.items()})
        if part.kind.facts.get("axes"):
            columns = turned(columns, self.params.axes, down=self.params.at_rest == "down")
        for column, values in columns.items():
            columns[column], told = possible(self.path, part.kind.stream, column, values, most=MOST_FAULTY)
            self.learnt += told
        return t_ns[rows], valued(columns)

    def _in_order(self, name: str, t_ns: Times) -> NDArray[np.intp] | slice:
        """The rows of a topic in the order of time, without those of a clock that was not set where it mostly was.

        t_ns : (n,) ns since 1970
        """
        unset = t_ns < EARLIEST_NS
        if not 0 < 2 * np.count_nonzero(unset) < len(unset):
            rows, told = rising(t_ns, name)
            self.learnt += told
            return rows
        count = int(unset.sum())
        text = f"{count} of {len(t_ns)} messages of {name} are stamped by a clock that was not set: they are left out"
        self.learnt += [Metric("rows_left_out", float(count), note=text), warning(text)]
        later = np.flatnonzero(~unset)
        rows, told = rising(t_ns[later], name)
        self.learnt += told
        return later[rows]

    def _facts(self, topic: Topic, part: Part, columns: dict[str, Array]) -> dict[str, Any]:
        facts = {**part.kind.facts, **topic.facts}
        if "axes" in facts:
            facts["axes"] = self.params.axes
        if "height" not in columns:
            facts.pop("height_datum", None)
        elif self.params.height_datum is not None:
            facts["height_datum"] = self.params.height_datum
        elif "height_datum" not in facts:
            del columns["height"]
            ways = f"--set {self.reader}.height_datum=ellipsoid or =mean_sea_level"
            text = f"{topic.type} does not say above what its altitudes count: they are left out; give {ways}"
            self.learnt.append(warning(text))
        return facts

    def _account(self) -> None:
        """What was not read, and why."""
        left = []
        for name, topic in sorted(self.topics.items()):
            asked = [part.kind for part in topic.parts if part.kind.asked]
            if topic.collector is None and asked and not any(name in self.params.named(s) for s in READ):
                ways = " or ".join(f"--set {self.reader}.{kind.stream}={name}" for kind in asked)
                note = f"{name} ({topic.type}) is not read: {asked[0].asked}; say which by {ways}"
                self.learnt.append(Metric("topic_to_choose", float(topic.count), note=note))
            elif topic.collector is None:
                left.append(f"{name} ({topic.type})")
            if topic.collector is not None and topic.collector.broken:
                text = f"{topic.collector.broken} messages of {name} are not whole"
                self.learnt += [Metric("messages_broken", float(topic.collector.broken), note=name), warning(text)]
        if left:
            self.learnt.append(Metric("topics_left", float(len(left)), note=_some(left)))

    def _compare_clocks(self, made: Mapping[str, pa.Table]) -> None:
        """A warning where stamps of two topics are of two clocks."""
        spans = {key: (t[0].value, t[-1].value) for key, table in made.items() if len(t := table["time"])}
        for key, (first, last) in spans.items():
            other, span = next(iter(spans.items()))
            apart = max(first - span[1], span[0] - last) * 1e-9
            if apart > 600.0:
                text = f"the times of {key} and {other} are {apart:.6g} s apart: are they of two clocks?"
                self.learnt.append(warning(f"{text} --set {self.reader}.time=log takes those of recording"))

    def _refuse_unknown(self) -> None:
        for stream in READ:
            for name in self.params.named(stream):
                topic = self.topics.get(name)
                if topic is None:
                    hint = did_you_mean(name, self.topics) or f"its topics are {_some(sorted(self.topics))}"
                    raise ReadFailed(self.path, f"it has no topic '{name}'", hint=hint)
                if not any(part.kind.stream == stream for part in topic.parts):
                    fitting = sorted(key for key, kinds in KINDS.items() if any(k.stream == stream for k in kinds))
                    hint = f"{stream} is read from {', '.join(fitting)}"
                    raise ReadFailed(self.path, f"{name} ({topic.type}) holds nothing for {stream}", hint=hint)

    def _nothing(self) -> ReadFailed:
        told = [f"{name} ({topic.type})" for name, topic in sorted(self.topics.items())]
        offered = sorted({part.kind.stream for topic in self.topics.values() for part in topic.parts if topic.count})
        self._account()
        asked = [row.note for row in self.learnt if row.name == "topic_to_choose"]
        if not told:
            return NothingUsable(self.path, "it holds no topic", hint="was anything recorded?")
        broken = [name for name, topic in sorted(self.topics.items()) if topic.collector and topic.collector.broken]
        if broken:
            hint = "the file is damaged, or its messages are packed in a way that is not read"
            return NothingUsable(self.path, f"no message of {_some(broken)} is whole", hint=hint)
        if asked:
            return NothingUsable(self.path, "none of its topics is read unless it is named", hint="\n  ".join(asked))
        if offered:
            what = f"it holds {', '.join(offered)} and nothing that the steps read"
            return NothingUsable(self.path, what, hint="'recon inspect' shows what is in it")
        known = sorted({name.replace("/msg/", "/") for name in KINDS if not name.startswith("foxglove_msgs")})
        hint = f"types that are read: {', '.join(known)}, by themselves or as fields of others"
        return NothingUsable(self.path, f"no topic holds a type of message that is read: {_some(told)}", hint=hint)


def _table(stream: str, group: Sequence[tuple[str, Times, dict[str, Array], dict[str, Any]]]) -> pa.Table:
    """The stream of one topic, or of several that complete each other: then with null where only one has a row."""
    _, t_ns, columns, facts = group[0]
    if len(group) > 1:
        parts = {f"{n}/{key}": (t, values) for n, (_, t, own, _) in enumerate(group) for key, values in own.items()}
        t_ns, spread = interleave(parts)
        columns = {key.partition("/")[2]: values for key, values in spread.items()}
        facts = {key: value for *_, own in group for key, value in own.items()}
    clock, scale = ("absolute", "UTC") if len(t_ns) and t_ns[0] >= EARLIEST_NS else ("relative", "boot")
    table = described(STREAMS[stream], t_ns, columns)
    return with_meta(table, **facts, topic=", ".join(one[0] for one in group), clock=clock, time_scale=scale)


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def writes() -> dict[str, Any]:
    """What topics can become, as a reader declares it."""
    return {stream: STREAMS[stream].possible() for stream in READ}
