"""``dafw new-plugin``: the plugins that it writes work, conform and are short; nothing is ever overwritten."""

from __future__ import annotations

import pytest
from fresh import environment

from dafw.authoring.templates import CODE, new_plugin
from dafw.commands import main

LINES = 15


def test_every_kind_installs_conforms_and_passes_its_own_test(tmp_path):
    fresh = environment()
    folders = {kind: tmp_path / kind for kind in CODE}
    for kind, folder in folders.items():
        assert main(["new-plugin", kind, f"my_{kind}", str(folder)]) == 0
    installed = fresh.run(
        "python", "-m", "pip", "install", "--target", tmp_path / "site", *folders.values(), cwd=tmp_path
    )
    assert installed.returncode == 0, installed.stderr
    tests = [folder / "tests" for folder in folders.values()]
    words = ("python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "error", *tests)
    done = fresh.run(*words, cwd=tmp_path, path=tmp_path / "site")
    assert done.returncode == 0 and " passed, 9 skipped in " in done.stdout, done.stdout + done.stderr


def test_a_working_filter_takes_few_lines_of_python(tmp_path):
    new_plugin("filter", "short", tmp_path)
    lines = [
        line
        for path in (tmp_path / "dafw_short").glob("*.py")
        for line in path.read_text().splitlines()
        if line.strip() and not line.strip().startswith(('"""', "#"))
    ]
    assert 5 < len(lines) <= LINES


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gadget", "mine", "new"], "there is no kind 'gadget' (kinds: model, observer, policy, filter, readings)"),
        (["filter", "my-filter", "new"], "expected a name of small letters, digits and '_' like my_filter"),
        (["filter", "class", "new"], "got 'class'"),
        (["filter", "etkf", "new"], "the filter 'etkf' is there already"),
        (["filter", "mine", "full"], "is there already and not empty; nothing was written"),
        (["filter", "mine", "full/file"], "is there already and not empty; nothing was written"),
        (["filter", "mine", "full/file/new"], "cannot be written"),
        (["filter", "mine"], "the following arguments are required: DIR"),
    ],
)
def test_what_cannot_be_done_is_refused(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("mine")
    assert main(["new-plugin", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.rglob("*")] == ["full", "file"]
    assert (tmp_path / "full" / "file").read_text() == "mine"
