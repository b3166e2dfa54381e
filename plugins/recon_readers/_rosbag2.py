"""Messages of ROS 2 bags in SQLite. Only those of topics that are read are taken from the file.

Reference: ros2/rosbag2, rosbag2_storage_sqlite3; tables topics, messages and, since Iron, message_definitions.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon_readers._collector import Language
from recon_readers._mcap_channels import ros_language, unread
from recon_readers._topics import Channel, Intake

_DAMAGED: Final = (sqlite3.Error, UnicodeDecodeError)
"""What SQLite says of a damaged file may itself be damaged text."""
_READ_ONLY: Final = "mode=ro&immutable=1"
_JOURNALS: Final = ("-wal", "-journal")
_AGAIN: Final = "copy it again, or repair it with 'sqlite3 FILE .recover'"


def take_in(path: Path, intake: Intake) -> None:
    """Take in the messages of one file. Raises ReadFailed where it is no bag."""
    with _consistent(path) as file, closing(sqlite3.connect(f"{file.as_uri()}?{_READ_ONLY}", uri=True)) as bag:
        bag.text_factory = lambda data: data.decode("utf-8", "replace")
        try:
            channels = _channels(bag, intake)
        except _DAMAGED as error:
            raise ReadFailed(path, f"it is no whole ROS 2 bag: {error}", hint=_AGAIN) from error
        taken = 0
        try:
            for number, logged_ns, data in bag.execute(_messages(channels)):
                if isinstance(data, bytes) and isinstance(logged_ns, int) and 0 <= logged_ns < 2**63:
                    taken += 1
                    channels[number].add(data, logged_ns)
        except _DAMAGED as error:
            text = f"{path.name} is damaged ({error}): {taken} messages before that place are used"
            intake.learnt += [Metric("damaged_places", 1.0, note=path.name), warning(f"{text}; {_AGAIN}")]


@contextmanager
def _consistent(path: Path) -> Iterator[Path]:
    """The file, or a copy that has taken in what a recorder that was killed left in the journal beside it."""
    journals = [path.with_name(path.name + ending) for ending in _JOURNALS]
    left = [journal for journal in journals if journal.is_file() and journal.stat().st_size]
    if not left:
        yield path.resolve()
        return
    with TemporaryDirectory() as folder:
        for file in (path, *left):
            shutil.copyfile(file, Path(folder) / file.name)
        copy = Path(folder).resolve() / path.name
        with closing(sqlite3.connect(copy)) as bag, suppress(*_DAMAGED):
            bag.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        yield copy


def _messages(channels: Mapping[int, Channel]) -> str:
    """The query for messages of the topics that are read."""
    numbers = ", ".join(str(number) for number, channel in channels.items() if channel.topic.collector is not None)
    return f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({numbers})"


def _channels(bag: sqlite3.Connection, intake: Intake) -> dict[int, Channel]:
    """By the file's number of the topic."""
    texts = _definitions(bag)
    counts = _counts(bag)
    found = {}
    for number, topic, name, form in bag.execute("SELECT id, name, type, serialization_format FROM topics").fetchall():
        if not (isinstance(number, int) and isinstance(topic, str) and isinstance(name, str)):
            intake.learnt.append(warning("a row of the table of topics is damaged: its messages are not read"))
            continue
        language, text = texts.get(name, ("ros2msg", ""))
        parts: list[tuple[str, str]] = []
        how = Language(unread, ("", ""))
        try:
            if form == "cdr":
                parts, how = ros_language(name, text, language, form, intake)
        except ValueError as error:
            intake.learnt.append(warning(f"{topic} is not read: {error}"))
        found[number] = channel = intake.channel(topic, name, parts, how)
        if channel.topic.collector is None:
            channel.topic.count += counts.get(number, 0)
    return found


def _counts(bag: sqlite3.Connection) -> dict[int, int]:
    """Messages by topic; none where the file is damaged."""
    try:
        return dict(bag.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
    except _DAMAGED:
        return {}


def _definitions(bag: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Language and text by type; none in bags older than Iron."""
    try:
        rows = bag.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        return {name: (language, text) for name, language, text in rows if isinstance(language and text, str)}
    except _DAMAGED:
        return {}
