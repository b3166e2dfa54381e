import json
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.errors import ConfigError
from recon.problems import Where
from recon.yaml_nodes import MOST_BYTES, MOST_LEVELS, Node, load, load_file

PIPELINE = """\
recon: 1
steps:
  - use: reader.auto
  - use: fuser.map
    params: {gyro_noise: 1e-3, lever_arm: [0.8 m, -0.3 m]}
"""


def problems_of(text):
    with pytest.raises(ConfigError) as caught:
        load(text, "f.yaml")
    return caught.value.problems


def problem_of(text):
    (problem,) = problems_of(text)
    return problem


# --- values ---


def test_a_document_becomes_ordinary_data():
    assert load(PIPELINE, "f.yaml").plain() == {
        "recon": 1,
        "steps": [
            {"use": "reader.auto"},
            {"use": "fuser.map", "params": {"gyro_noise": 0.001, "lever_arm": ["0.8 m", "-0.3 m"]}},
        ],
    }


@pytest.mark.parametrize(
    ("text", "value"),
    [("'1'", "1"), ('"true"', "true"), ("'~'", "~"), ("''", ""), ("|\n  1\n", "1\n"), (">-\n  1\n", "1")],
)
def test_a_scalar_in_quotes_or_a_block_is_text(text, value):
    assert load(f"a: {text}", "f.yaml").plain()["a"] == value


def test_a_missing_value_is_none():
    assert load("a:\nb: 1", "f.yaml").plain() == {"a": None, "b": 1}


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**63 - 1)
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(st.characters(min_codepoint=32, max_codepoint=0x2000, exclude_categories=["Cc", "Cs"])),
        lambda inner: st.lists(inner) | st.dictionaries(st.text("abc: #-'", max_size=5), inner),
    )
)
def test_json_reads_as_json(data):
    # YAML 1.2 is a superset of JSON
    assert load(json.dumps(data, ensure_ascii=False), "f.yaml").plain() == data


def test_a_byte_order_mark_is_accepted():
    root = load("\ufeffa: 1", "f.yaml")
    assert root.plain() == {"a": 1}
    assert root.where_of_key("a") == Where("f.yaml", 1, 1)


# --- places ---


def test_every_node_and_key_knows_its_place():
    root = load(PIPELINE, "f.yaml")
    step = root.at(["steps", 1])
    assert step.where == Where("f.yaml", 4, 5)
    assert step.where_of_key("params") == Where("f.yaml", 5, 5)
    assert root.at(["steps", 1, "params", "gyro_noise"]).where == Where("f.yaml", 5, 26)
    assert root.at(["steps", 1, "params", "lever_arm", 1]).where == Where("f.yaml", 5, 51)


def test_columns_count_characters_and_not_bytes():
    assert load("{é: ü, a: 1}", "f.yaml").where_of_key("a") == Where("f.yaml", 1, 8)


@pytest.mark.parametrize("path", [["steps", 1, "nothing", 0], ["steps", 1, 0], ["steps", 1]])
def test_a_path_that_does_not_exist_leads_to_the_nearest_node(path):
    root = load(PIPELINE, "f.yaml")
    assert root.at(path) is root.at(["steps", 1])


@pytest.mark.parametrize("path", [["steps", 2], ["steps", -1], ["steps", "1"]])
def test_an_index_that_does_not_exist_leads_to_the_list(path):
    root = load(PIPELINE, "f.yaml")
    assert root.at(path) is root.at(["steps"])


def test_the_place_of_a_key_that_is_not_there_is_the_mapping():
    step = load(PIPELINE, "f.yaml").at(["steps", 0])
    assert step.where_of_key("params") == step.where


def test_ordinary_data_can_be_placed_at_an_option():
    where = Where("--set fuser.map.lever_arm=[1, 2]")
    data = {"a": [1, 2.5, None, True, "x", {"b": []}]}
    node = Node.of(data, where)
    assert node.plain() == data
    assert node.at(["a", 5, "b"]).where == node.where_of_key("a") == where


def test_numbers_and_arrays_of_numpy_become_ordinary_data():
    data = {"a": np.float64(0.5), "b": np.array([[1, 2]]), "c": [np.bool_(True), np.int64(3), np.str_("x")]}
    plain = Node.of(data, Where("f")).plain()
    assert plain == {"a": 0.5, "b": [[1, 2]], "c": [True, 3, "x"]}
    assert type(plain["a"]) is float
    assert [type(value) for value in plain["c"]] == [bool, int, str]


@pytest.mark.parametrize("data", [{1: "x"}, {"a": {1, 2}}, [b"x"], np.datetime64("2024-05-01")])
def test_data_that_yaml_cannot_hold_is_refused(data):
    with pytest.raises(TypeError):
        Node.of(data, Where("--set"))


def test_nodes_cross_process_borders():
    root = load(PIPELINE, "f.yaml")
    assert pickle.loads(pickle.dumps(root)) == root


# --- problems ---


def test_every_problem_is_found_at_once():
    text = "a: 1\na: 2\n1: x\nb: &q [1]\nc: *q\n<<: {d: 1}\ne: !!str 5\nf: .inf\n? [a]\n: 1\ng: 'open"
    assert [(found.code, found.where.line, found.where.column) for found in problems_of(text)] == [
        ("yaml-duplicate-key", 2, 1),
        ("yaml-key", 3, 1),
        ("yaml-anchor", 4, 4),
        ("yaml-anchor", 5, 4),
        ("yaml-merge", 6, 1),
        ("yaml-tag", 7, 4),
        ("yaml-number", 8, 4),
        ("yaml-key", 9, 3),
        ("yaml-syntax", 11, 4),
    ]


def test_a_duplicate_key_names_where_the_first_was():
    assert problem_of("a:\n  b: 1\n  b: 2\n").as_text() == (
        "f.yaml:3:3: error: 'b' is given twice; keep one of them\n    f.yaml:2:3: note: 'b' was first given here"
    )


@pytest.mark.parametrize("key", ["1", "1.5", "true", "null", "~"])
def test_a_key_that_is_not_text_is_a_problem_until_it_is_quoted(key):
    assert problem_of(f"{key}: x").as_text() == f"f.yaml:1:1: error: a key must be text; write '{key}' in quotes"
    assert load(f"'{key}': x", "f.yaml").plain() == {key: "x"}


@pytest.mark.parametrize("text", ["? \n: x", "[a]: x", "{a: b}: x"])
def test_a_key_that_is_empty_or_a_collection_is_a_problem(text):
    assert problem_of(text).code == "yaml-key"


@pytest.mark.parametrize("text", [".inf", "-.Inf", ".NAN", "1e999", "-1e999", str(2**63), "0x" + "f" * 17, "9" * 5000])
def test_numbers_that_no_double_or_64_bit_integer_holds_are_problems(text):
    problem = problem_of(f"a: {text}")
    assert (problem.code, problem.where) == ("yaml-number", Where("f.yaml", 1, 4))


@pytest.mark.parametrize(
    ("text", "place", "sentence"),
    [
        ("a:\n\t- b", (2, 1), "a tab cannot indent a line; use spaces"),
        ("a: |\n x\n\ty\n", (3, 1), "a tab cannot indent a line; use spaces"),
        ("a: @x", (1, 4), "plain text cannot begin with '@'; quote it"),
        ("é: [é, %x]", (1, 8), "plain text cannot begin with '%'; quote it"),
        ("a: 'x\nb: 1", (1, 4), "this quote is never closed"),
        ('a: "C:\\data"', (1, 4), "a backslash in this text begins no escape of YAML; use single quotes"),
        ('a: "C:\\xray"', (1, 4), "a backslash in this text begins no escape of YAML; use single quotes"),
        ("a: [1, 2\nb: 3", (1, 4), "this '[' is never closed, or a ',' is missing behind one of its items"),
        ("a: {x: 1", (1, 4), "this '{' is never closed, or a ',' is missing behind one of its items"),
        ("a: b: c", (1, 5), "a ': ' is not expected here; check the indentation, or quote the text"),
        (
            "a:\n  - 1\n b: 2",
            (3, 2),
            "this does not continue what comes before it; check the indentation and the quotes",
        ),
        ("a: 'b' c", (1, 8), "this does not continue what comes before it; check the indentation and the quotes"),
    ],
)
def test_syntax_errors_become_one_plain_sentence(text, place, sentence):
    problem = problem_of(text)
    assert problem.where == Where("f.yaml", *place)
    assert problem.sentence == sentence


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n", "---\n", "---\n...\n", "\ufeff"])
def test_an_empty_document_is_a_problem(text):
    assert problem_of(text).code == "yaml-empty"


def test_a_second_document_is_a_problem_at_its_start():
    problem = problem_of("a: 1\n---\nb: 2\n")
    assert (problem.code, problem.where.line) == ("yaml-documents", 2)


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ("{a: ", "}"), ("? ", "")])
def test_depth_is_limited(opening, closing):
    deepest = opening * MOST_LEVELS + "x" + closing * MOST_LEVELS
    if closing:
        assert load(deepest, "f.yaml").plain()
        assert problem_of(opening + deepest + closing).code == "yaml-depth"
    assert problems_of(opening * 20_000)[-1].code == "yaml-depth"


@pytest.mark.parametrize("character", ["\0", "\x07", "\x1b", "\x7f", "\x85", "\u2028", "\ufeff", "\ufffe", "\ud800"])
def test_invisible_and_broken_characters_are_problems(character):
    problem = problem_of(f"a: 1\r\nb: {character}x")
    assert (problem.code, problem.where) == ("yaml-character", Where("f.yaml", 2, 4))
    assert f"U+{ord(character):04X}" in problem.text


@given(st.text(st.sampled_from("ab1:-?[]{},#&*!|>'\"%@` \n\t\\.~<é"), max_size=60))
def test_any_text_is_read_or_refused_in_one_way(text):
    with suppress(ConfigError):
        json.dumps(load(text, "f.yaml").plain(), allow_nan=False)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused_in_one_way(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(data)
    with suppress(ConfigError):
        json.dumps(load_file(path).plain(), allow_nan=False)


def test_both_parsers_of_pyyaml_see_the_same():
    texts = ["a:\n\t- b", "a: b: c", "é: [é, %x]", "a: 'x", 'a: "\\q"', "a: {x: 1", "a: 1\na: &b 2", "[" * 99, PIPELINE]
    code = (
        "import json, sys, yaml\n"
        "if sys.argv[2] == 'python' and hasattr(yaml, 'CSafeLoader'): del yaml.CSafeLoader\n"
        "from recon.yaml_nodes import load\n"
        "from recon.errors import ConfigError\n"
        "for text in json.loads(sys.argv[1]):\n"
        "    try: print(load(text, 'f.yaml'))\n"
        "    except ConfigError as error: print(error)\n"
    )
    c, python = (
        subprocess.run([sys.executable, "-c", code, json.dumps(texts), parser], check=True, capture_output=True).stdout
        for parser in ("c", "python")
    )
    assert c == python
    assert c.splitlines()[-1].startswith(b"Node(")


# --- files ---


def test_a_file_is_read_and_named(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: \xc3\xa9\r\nb: 2\r\n")
    root = load_file(path)
    assert root.plain() == {"a": "é", "b": 2}
    assert root.where_of_key("b") == Where(str(path), 2, 1)


@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"])
def test_the_first_byte_that_is_not_utf_8_is_placed(tmp_path, start):
    path = tmp_path / "p.yaml"
    path.write_bytes(start + b"a: 1\r\n\xc3\xa9: \xe9 # latin-1\n")
    with pytest.raises(ConfigError) as caught:
        load_file(path)
    assert str(caught.value) == f"{path}:2:4: error: byte 0xe9 is not UTF-8; save the file as UTF-8"


def test_a_missing_file_a_folder_and_an_impossible_path_get_a_sentence(tmp_path):
    for path, sentence in [
        (tmp_path / "none.yaml", "there is no such file"),
        (tmp_path, "this is a folder, not a file"),
        ("a\0b", "the file cannot be read: its name holds a NUL"),
    ]:
        with pytest.raises(ConfigError) as caught:
            load_file(path)
        assert str(caught.value) == f"{path}: error: {sentence}"


def test_a_file_below_a_file_cannot_be_read(tmp_path):
    (tmp_path / "file").write_text("a: 1")
    with pytest.raises(ConfigError, match="the file cannot be read: Not a directory"):
        load_file(tmp_path / "file" / "p.yaml")


def test_importing_loads_nothing_heavy():
    code = "import sys, recon.yaml_nodes; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert "recon.yaml_nodes" in loaded
    assert not {"numpy", "pyarrow", "pydantic", "rich", "scipy"} & set(loaded)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no device files")
def test_a_device_is_refused_rather_than_read_for_ever() -> None:
    with pytest.raises(ConfigError, match="a device or a pipe"):
        load_file(Path("/dev/zero"))


def test_a_file_that_no_person_wrote_is_refused_by_its_size(tmp_path: Path) -> None:
    with (tmp_path / "big.yaml").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(ConfigError, match="larger than 4 MiB"):
        load_file(tmp_path / "big.yaml")
