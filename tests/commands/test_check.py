"""``dafw check``: a line for each check, and what is refused."""

from __future__ import annotations

import pytest

from dafw.commands import main
from dafw.commands.check import check_command


def test_the_command_prints_a_line_for_each_check(capsys):
    assert main(["check", "etkf", "stationary"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "2 plugins checked, nothing to mend"
    assert lines[0].split() == ["filter", "'etkf'", "shapes", "passed"]
    assert "filter 'etkf' infinite_radius not applicable declares no localization_option" in [
        " ".join(line.split()) for line in lines
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nonesuch"], "there is no plugin 'nonesuch' (there are: "),
        ([], "expected either names of plugins or --all"),
        (["none", "--all"], "expected either names of plugins or --all"),
    ],
)
def test_a_wrong_request_is_one_line_and_status_2(words, message, capsys):
    assert main(["check", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_a_reader_that_leaves_ends_the_command(monkeypatch):
    written = []

    def leave(text, **options):
        written.append(text)
        raise BrokenPipeError

    monkeypatch.setattr("dafw.commands.check.print", leave, raising=False)
    with pytest.raises(BrokenPipeError):
        check_command(["stationary", "etkf"])
    assert len(written) == 1
