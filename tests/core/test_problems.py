import pickle

import pytest

from recon.problems import MOST_CHOICES, MOST_QUOTED, MOST_TEXT, Problem, Where, did_you_mean, one_of

PARAMETERS = ["gyro_noise", "gyro_bias", "accel_noise", "lever_arm", "cutoff"]


@pytest.mark.parametrize(
    ("where", "text"),
    [
        (Where("a.yaml", 4, 14), "a.yaml:4:14"),
        (Where("a.yaml", 4), "a.yaml:4"),
        (Where("a.yaml"), "a.yaml"),
        (Where("--set fuser.map.x=1"), "--set fuser.map.x=1"),
    ],
)
def test_a_place_names_only_what_is_known(where, text):
    assert str(where) == text


def test_text_holds_place_sentence_and_hint():
    problem = Problem(
        Where("pipelines/bad.yaml", 4, 14),
        "unknown-parameter",
        "fuser.map has no parameter 'gyro_nois'",
        did_you_mean("gyro_nois", PARAMETERS),
    )
    assert problem.as_text() == (
        "pipelines/bad.yaml:4:14: error: fuser.map has no parameter 'gyro_nois'; did you mean 'gyro_noise'?"
    )


def test_a_problem_without_place_and_hint_is_one_plain_sentence():
    assert Problem(None, "no-steps", "the pipeline has no steps").as_text() == "error: the pipeline has no steps"


def test_notes_follow_on_indented_lines():
    problem = Problem(Where("a.yaml", 3, 1), "twice", "'x' is given twice", notes=((Where("a.yaml", 1, 1), "first"),))
    assert problem.as_text().splitlines()[1] == "    a.yaml:1:1: note: first"


def test_json_has_null_for_places_that_are_not_known():
    problem = Problem(None, "code", "text", "hint", ((Where("a.yaml", 2), "note"),))
    assert problem.as_dict() == {
        "file": None,
        "line": None,
        "column": None,
        "code": "code",
        "text": "text",
        "hint": "hint",
        "notes": [{"file": "a.yaml", "line": 2, "column": None, "text": "note"}],
    }


def test_github_annotation_escapes_what_its_syntax_uses():
    problem = Problem(Where("a,b:c.yaml", 2, 5), "code", "50 % is\nwrong: yes, it is")
    assert problem.as_github() == ("::error file=a%2Cb%3Ac.yaml,line=2,col=5,title=code::50 %25 is%0Awrong: yes, it is")


def test_github_annotation_without_place_still_names_the_kind():
    assert Problem(None, "code", "text").as_github() == "::error title=code::text"


def test_github_annotation_is_one_line_with_its_notes():
    problem = Problem(Where("a.yaml"), "code", "text", notes=((Where("b.yaml", 1, 2), "note"),))
    assert problem.as_github() == "::error file=a.yaml,title=code::text%0A    b.yaml:1:2: note: note"


def test_a_long_quotation_is_cut_and_the_sentence_around_it_stays():
    long = "x" * 10_000
    notes = ((Where("a.yaml"), f"'{long}' was first given here"),)
    problem = Problem(None, "code", f"the sensor's '{long}' is unlike 'y', isn't it", f"write '{long}'", notes)
    cut = f"'{'x' * MOST_QUOTED}...'"
    assert problem.text == f"the sensor's {cut} is unlike 'y', isn't it"
    assert problem.hint == f"write {cut}"
    assert problem.notes == ((Where("a.yaml"), f"{cut} was first given here"),)


def test_what_stands_between_two_quotations_is_not_cut():
    text = f"'a' {'and much more ' * 10} 'b'"
    assert Problem(None, "code", text).text == text


def test_a_text_without_end_is_cut_whatever_it_holds():
    assert len(Problem(None, "code", "it's" * 1000).text) == MOST_TEXT + len("...")


def test_problems_cross_process_borders():
    problem = Problem(Where("a.yaml", 1, 2), "code", "text", "hint", ((Where("b.yaml"), "note"),))
    assert pickle.loads(pickle.dumps(problem)) == problem


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("gyro_nois", "gyro_noise"),
        ("Gyro_Noise", "gyro_noise"),
        ("gyro-noise", "gyro_noise"),
        ("lever", "lever_arm"),
        ("cutof", "cutoff"),
        ("acel_noise", "accel_noise"),
    ],
)
def test_the_nearest_word_is_offered(word, meant):
    assert did_you_mean(word, PARAMETERS) == f"did you mean '{meant}'?"


def test_the_last_part_of_a_dotted_name_is_enough():
    assert did_you_mean("map", ["filter.lowpass", "fuser.map", "fuser.mean"]) == "did you mean 'fuser.map'?"


def test_a_role_that_two_names_share_makes_them_no_more_alike():
    assert did_you_mean("exporter.foxglove", ["exporter.plots", "exporter.geojson"]) == ""
    assert did_you_mean("exporter.blendr", ["exporter.plots", "exporter.blender"]) == "did you mean 'exporter.blender'?"


@pytest.mark.parametrize("word", ["", "  ", "xyzzy", "cutoff_of_something_else_entirely"])
def test_nothing_is_offered_for_a_word_that_is_near_to_none(word):
    assert did_you_mean(word, PARAMETERS) == ""


@pytest.mark.parametrize(("word", "choice"), [("a", "aligner.forward"), ("a", "ab"), ("fi", "filter.resample")])
def test_one_or_two_letters_are_the_beginning_of_too_much(word, choice):
    assert did_you_mean(word, [choice]) == ""


def test_a_word_too_long_to_be_shown_is_compared_with_nothing():
    # comparing takes as long as the word is: seconds for a whole file in the place of a name
    assert did_you_mean("x" * (MOST_QUOTED + 1), ["x" * MOST_QUOTED]) == ""


def test_a_word_is_not_offered_for_itself():
    assert did_you_mean("cutoff", ["cutoff"]) == ""


def test_the_offer_does_not_depend_on_the_order_of_the_choices():
    # both differ from the word in one letter of three
    assert did_you_mean("bat", ["cat", "bar"]) == did_you_mean("bat", ["bar", "cat"]) != ""


@pytest.mark.parametrize(
    ("choices", "text"),
    [([], ""), (["a"], "'a'"), (["a", "b"], "'a' or 'b'"), (["a", "b", "c"], "'a', 'b' or 'c'")],
)
def test_choices_read_as_a_sentence(choices, text):
    assert one_of(choices) == text


def test_a_long_list_of_choices_is_cut_and_counted():
    choices = [f"c{number}" for number in range(MOST_CHOICES + 5)]
    assert one_of(choices).endswith(f"'c{MOST_CHOICES - 1}', ... ({MOST_CHOICES + 5} in all)")
    assert one_of(choices[:MOST_CHOICES]).endswith(f" or 'c{MOST_CHOICES - 1}'")
