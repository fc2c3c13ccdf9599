"""``dafw doctor``: prints what this machine lacks, as a table, as JSON, or as names of Debian packages.

It must also work in a broken environment, in which dafw itself may not be importable. So this file and
doctor_findings.py beside it use only the standard library and syntax of Python 3.9, and can be run by path::

    python3 dafw/commands/doctor.py [--json | --system | --packages]
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING or __package__:
    from dafw.commands.doctor_findings import Finding, diagnose, diagnose_system
    from dafw.commands.parser import Parser
else:  # run by path: Python looks for modules in the folder of this file
    from argparse import ArgumentParser as Parser

    from doctor_findings import Finding, diagnose, diagnose_system

if TYPE_CHECKING:
    from collections.abc import Sequence


def doctor_command(words: Sequence[str]) -> int:
    """Print what was found; return the exit status: 0 if nothing is missing, otherwise 1.

    setup.sh asks for ``--system``, which leaves the Python packages out, and for ``--packages``, which prints the
    missing Debian packages on one line and always returns 0.
    """
    parser = Parser(prog="dafw doctor", description="Say what dafw needs, what is missing and what mends it.")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--json", action="store_true", help="print JSON instead of a table")
    what.add_argument("--system", action="store_true", help="leave the Python packages out")
    what.add_argument("--packages", action="store_true", help="print only the missing Debian packages, on one line")
    asked = parser.parse_args(words)
    if asked.packages:
        print(*dict.fromkeys(package for finding in diagnose_system() for package in finding.packages))
        return 0
    findings = diagnose_system() if asked.system else diagnose()
    print(json.dumps([asdict(finding) for finding in findings], indent=2) if asked.json else _table(findings))
    return 0 if all(finding.ok for finding in findings) else 1


def _table(findings: list[Finding]) -> str:
    width = max(len(finding.name) for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{'ok     ' if finding.ok else 'MISSING'}  {finding.name:<{width}}  {finding.found}")
        if not finding.ok:
            lines.append(f"{'':<{width + 11}}mend: {finding.remedy}")
    missing = sum(not finding.ok for finding in findings)
    lines.append(f"{missing} of {len(findings)} need mending" if missing else f"all {len(findings)} are well")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(doctor_command(sys.argv[1:]))
