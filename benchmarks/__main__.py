"""The command ``python -m benchmarks``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks import benchmarks, machine
from dafw.core.errors import DafwError


def main(words: Sequence[str] | None = None) -> int:
    """Run benchmarks, print a table, write JSON; return the exit status."""
    known = benchmarks()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Measure speed and accuracy, and compare them with required values."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"benchmarks to run, by default all: {[*known]}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to FILE")
    parser.add_argument("--list", action="store_true", help="say what they measure, and run nothing")
    parser.add_argument("--short", action="store_true", help="smallest cases: only checks that the benchmarks work")
    asked = parser.parse_args(words)
    if unknown := [name for name in asked.names if name not in known]:
        parser.error(f"there is no benchmark '{unknown[0]}' (there are: {', '.join(known)})")
    if asked.list:
        for name in asked.names or known:
            print(f"{name:32} {(known[name].__doc__ or '').partition(chr(10))[0]}")
        return 0
    results = []
    print(f"{'benchmark':32} {'value':>10} {'required':>10} unit")
    for name in asked.names or known:
        try:
            found = known[name](asked.short)
        except DafwError as error:
            print(f"benchmarks: {name}: {error}", file=sys.stderr)
            return error.exit_status
        print(f"{name:32} {found.value:10.4g} {found.baseline:10.4g} {found.unit}", flush=True)
        results.append({"name": name, **vars(found), "machine": machine(), "short": asked.short})
        if asked.json:
            asked.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
