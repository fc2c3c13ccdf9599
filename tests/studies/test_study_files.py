"""Study files: what they may say, and one clear line about what they may not."""

import pytest
import yaml

from dafw import ConfigurationError
from dafw.studies.study_files import load_study, parse_seeds, runs_of, study_names, study_of


@pytest.fixture
def written(tmp_path):
    """Return what writes a study file and loads it."""

    def load(text):
        (tmp_path / "study").mkdir()
        (tmp_path / "study" / "mine.yaml").write_text(text)
        return load_study("mine", tmp_path)

    return load


@pytest.mark.parametrize(
    ("given", "seeds"),
    [
        (7, (7,)),
        ("100-103", (100, 101, 102, 103)),
        ("3,5, 8-9", (3, 5, 8, 9)),
        ([1, "4-5", 2], (1, 4, 5, 2)),
        ("5-5", (5,)),
        ("9223372036854775807", (2**63 - 1,)),
    ],
)
def test_seeds_are_numbers_and_ranges(given, seeds):
    assert parse_seeds(given, "seeds") == seeds


@pytest.mark.parametrize(
    "given",
    [
        *("", "a-b", "9-3", "1--3", "-1", "1.5", "range(3)", "1,,2", "4,4", "²"),
        *("0-999999999999", "9223372036854775808", [1, "0-2"]),
        *([], None, True, [True], [1.0], {"from": 1}, [[1, 2]]),
    ],
)
def test_nonsense_for_seeds_is_refused_with_what_was_given(given):
    with pytest.raises(ConfigurationError, match=r"^--seeds: .*\bgot |^--seeds: the same seed twice in ") as caught:
        parse_seeds(given, "--seeds")
    assert repr(given) in str(caught.value)


def of(text, *overrides):
    return study_of("mine", yaml.safe_load(text), overrides)


def test_configurations_are_combined_with_all_axes():
    study = of(
        "overrides: [experiment=lorenz96]\n"
        "configurations: {a: [filter=etkf], b: [filter=enkf]}\n"
        "axes:\n  members: [10, 20]\n  truth: {same: [], other: [truth.forcing=9]}\n"
        "seeds: 1-2\nsuccess: 30\n",
        "cycles=3",
    )
    assert [one.name for one in study.configurations] == [
        f"{base},members={members},truth={truth}"
        for base in ("a", "b")
        for members in (10, 20)
        for truth in ("same", "other")
    ]
    last = study.configurations[-1]
    words = ("experiment=lorenz96", "filter=enkf", "members=20", "truth.forcing=9", "cycles=3")
    assert last.overrides == ("pictures=false", "record.fields=ends", *words)
    assert last.place == {"members": "20", "truth": "other"}
    assert (study.seeds, study.success) == ((1, 2), 30.0)
    assert [(one.name[0], seed) for one, seed in runs_of(study)][7:9] == [("b", 1), ("a", 2)]


def test_an_axis_alone_names_the_configurations():
    study = of("axes: {filter.rotation: [true, false]}\n")
    assert [one.name for one in study.configurations] == ["filter.rotation=true", "filter.rotation=false"]
    assert [one.overrides[-1] for one in study.configurations] == ["filter.rotation=true", "filter.rotation=false"]
    assert [one.name for one in of("title: nothing else\n").configurations] == ["all"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- a\n", "expected a mapping, got ['a']"),
        ("seed: 0-9\n", "unknown option 'seed', did you mean 'seeds'?"),
        ("seeds: nine\n", "seeds: expected numbers and ranges such as 3,5,100-199, got 'nine'"),
        ("success: -1\n", "option 'success' must be above 0.0, got -1"),
        ("overrides: filter=etkf\n", "option 'overrides' must be of type list[str], got 'filter=etkf'"),
        ("configurations: {a: filter=etkf}\n", "option 'configurations' must be of type dict[str, list[str]]"),
        ("configurations: {a/b: []}\n", "a configuration must be named by letters, digits"),
        ("configurations: {..: []}\n", "it names a folder), got '..'"),
        ("axes: {start: [[0, 1]]}\n", "axis 'start' must be a list of values, or a mapping of names to lists"),
        ("axes: {members: []}\n", "axis 'members' must be a list of values"),
        ("axes: {members: 3}\n", "axis 'members' must be a list of values, or a mapping of names to lists of"),
        ("axes: {a: {b: c}}\n", "axis 'a' must be a list of values"),
        ("configurations: {'a': [], 'a,b=1': []}\naxes: {b: {'1,b=1': [], '1': []}}\n", "are called 'a,b=1,b=1'"),
        ("axes: {members: [10, '10']}\n", "axis 'members' has the same value twice"),
        ("overrides: [seed=3]\n", "'seed=3': the seeds stand under seeds, or in --seeds"),
        ("axes: {seed: [1, 2]}\n", "'seed=1': the seeds stand under seeds"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_the_study(text, message):
    with pytest.raises(ConfigurationError) as caught:
        of(text)
    assert str(caught.value).startswith("study 'mine'") and message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("defaults: [literal]\n", "no defaults list"),
        ("title: ${nowhere}\n", "'nowhere' not found"),
        ("a: [\n", "no YAML"),
    ],
)
def test_a_file_that_cannot_be_loaded_is_one_line_too(text, message, written):
    with pytest.raises(ConfigurationError, match=rf"^study 'mine': .*{message}.*$"):
        written(text)


@pytest.mark.parametrize("name", ["nothing", "../mine"])
def test_a_name_that_is_none_brings_those_that_are(name):
    with pytest.raises(
        ConfigurationError,
        match=r"^there is no study '.*' \(there are: ablation, filters, forecast, leak, literal, mismatch, "
        r"recommended, tiny\)$",
    ):
        load_study(name)


def test_shipped_studies_load_and_a_folder_may_add_others(written, tmp_path):
    for name in study_names():
        study = load_study(name)
        assert study.title and study.configurations and study.seeds
    written("seeds: 1\n")
    assert study_names(tmp_path) == sorted([*study_names(), "mine"])
    literal = load_study("literal")
    assert literal.seeds == tuple(range(30))
    assert [one.place["policy.theta"] for one in literal.configurations] == ["0.0", "0.2", "0.3"]
