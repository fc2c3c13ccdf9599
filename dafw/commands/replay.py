"""``dafw replay``: makes a run again from its own file, and names the first difference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser


def replay_command(words: Sequence[str]) -> int:
    """Make a run again and compare; raises DafwError. Exit status 0: identical, 1: different, 2: a wrong request."""
    parser = Parser(
        prog="dafw replay",
        description="Make a complete run again from the configuration, the seed and the pinned parts in its folder, in "
        "a temporary folder, and compare both to the last bit. Exit status 0: identical, 1: different.",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    folder: Path = parser.parse_args(list(words)).run.resolve()
    from dafw.studies.replaying import first_difference, prepared
    from dafw.studies.stopping import Interrupted

    run = prepared(folder)
    for changed in run.versions:
        print(f"another version: {changed}")
    for changed in run.files:
        print(f"another file: {changed}")
    try:
        found = first_difference(run)
    except Interrupted:
        raise KeyboardInterrupt("the run was not made again") from None
    print(f"different: {found}" if found else "identical")
    return 1 if found else 0
