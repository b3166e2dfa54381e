from __future__ import annotations

import pytest
from helpers import filter_of

from recon.errors import PluginInvalid, PluginNotFound
from recon.registry import Registry, Source
from recon.stages import Filter


def same(*, imu, params):
    return {"imu": imu}


def test_a_record_is_found_by_its_key():
    stage = filter_of(same)
    registry = Registry.of(stage)
    assert registry.get("filter.work") is stage
    assert "filter.work" in registry
    assert list(registry) == registry.names("filter") == ["filter.work"]
    assert registry.names("reader") == []
    assert registry.source("filter.work") == Source(module=__name__)


def test_an_unknown_name_says_what_was_meant():
    registry = Registry.of(filter_of(same), filter_of(same, "lowpass"))
    with pytest.raises(PluginNotFound) as caught:
        registry.get("filter.lowpas")
    assert str(caught.value) == "there is no stage 'filter.lowpas'\n  did you mean 'filter.lowpass'?"


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("lowpass", "did you mean 'filter.lowpass'?"),
        ("detector.lowpass", "installed: none of that role"),
        ("filtr.lowpass", "did you mean 'filter.lowpass'?"),
        ("filter.zzz", "installed: filter.lowpass"),
        ("zzz", "see 'recon plugins'"),
        ("", "see 'recon plugins'"),
    ],
)
def test_suggestions(key, hint):
    assert Registry.of(filter_of(same, "lowpass")).suggest(key) == hint


def test_a_faulty_record_is_refused_with_all_its_faults():
    with pytest.raises(PluginInvalid, match=r"filter.Bad: the name 'Bad' must be .*; the summary is empty"):
        Registry.of(Filter(name="Bad", summary="", run=lambda params: {}))


def test_records_of_a_notebook_win_over_those_of_the_same_name():
    first, second, other = filter_of(same), filter_of(same), filter_of(same, "other")
    registry = Registry.of(first, other)
    joined = registry.with_records(second)
    assert joined.get("filter.work") is second
    assert joined.get("filter.other") is other
    assert registry.get("filter.work") is first


def test_an_installed_stage_keeps_its_origin_beside_records_and_one_in_its_place_tells_its_own():
    installed = Registry.installed()
    installed.get("filter.remove_gravity")
    joined = installed.with_records(filter_of(same))
    assert joined.source("filter.remove_gravity").distribution == "recon-dynamics"
    replaced = installed.with_records(filter_of(same, "remove_gravity"))
    assert replaced.source("filter.remove_gravity") == Source(module=__name__)
    assert installed.source("filter.remove_gravity").distribution == "recon-dynamics"


def test_registries_share_nothing():
    one, two = Registry.of(filter_of(same)), Registry.of()
    assert "filter.work" in one
    assert "filter.work" not in two
