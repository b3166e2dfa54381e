from __future__ import annotations

from recon.stages import ROLES, Analyzer, Delegation, Exporter, Reader, Simulator, role_of


def test_the_role_is_read_from_the_key():
    assert [role_of(key) for key in ("filter.clean", "filter.", "filter", "filtre.clean")] == ["filter", "", "", ""]
    assert all(record.role == role for role, record in ROLES.items())


def test_a_reader_that_hands_over_is_given_the_registry():
    def read(path, params):
        return {}

    def hand_over(path, params, registry):
        return {}

    assert Reader(name="a", summary="A.", run=read).faults() == []
    assert Reader(name="a", summary="A.", run=hand_over, params=Delegation).faults() == []
    assert Reader(name="a", summary="A.", run=hand_over).faults() == [
        "its function takes the argument(s) ['registry'], which it does not declare to read"
    ]
    assert Reader(name="a", summary="A.", run=read, params=Delegation).faults() == [
        "its function does not take the argument(s) ['registry'], which it is given"
    ]


def test_an_exporter_of_every_stream_is_given_them():
    def every(*, streams, folder, about, params):
        return []

    assert Exporter(name="a", summary="A.", run=every, every_stream=True).faults() == []
    assert Exporter(name="a", summary="A.", run=every).faults() != []


def test_roles_without_streams_need_none():
    assert Simulator(name="a", summary="A.", run=lambda params: {}).faults() == []
    assert Analyzer(name="a", summary="A.", run=lambda params: {}).faults() == []
