"""JSON of names that are no UTF-8."""

from __future__ import annotations

import json

import pytest

from recon.storage.json_text import readable, to_json


@pytest.mark.parametrize(
    ("text", "read"),
    [
        (b"caf\xe9".decode(errors="surrogateescape"), r"caf\xe9"),
        (b"\x80\xff".decode(errors="surrogateescape"), r"\x80\xff"),
        ("\ud800", r"\ud800"),
        ('café \U0001f600 \\ "', 'café \U0001f600 \\ "'),
    ],
)
def test_every_text_is_written_as_utf_8_and_read_as_people_would_write_it(text: str, read: str) -> None:
    written = to_json({"name": text}).encode("utf-8")
    assert json.loads(written) == {"name": read}
    assert readable(text) == read


def test_a_number_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        to_json([float("nan")])
