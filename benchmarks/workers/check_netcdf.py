"""Ask the compliance checker of IOOS about a file; run by the interpreter of the checker's own environment.

``python check_netcdf.py FILE SUITE...`` prints one JSON list: every complaint as "CHECK: MESSAGE", of all weights but
the lowest, which are recommendations of global attributes such as ``history``. A check that stops with an error counts.
"""

import json
import sys

from compliance_checker.runner import CheckSuite


def main(path: str, suites: list[str]) -> None:
    """Print what the suites complain about."""
    CheckSuite.load_all_available_checkers()
    checker = CheckSuite()
    said = []
    for results, errors in checker.run_all(checker.load_dataset(path), suites).values():
        for one in results:
            passed = one.value if isinstance(one.value, bool) else one.value[0] == one.value[1]
            if not passed and one.weight > 1:
                messages = dict.fromkeys(one.msgs or ["failed"])
                said += [f"{one.name}: {message}" for message in messages if "global attribute" not in message]
        said += [f"{name}: the check itself stopped with {error[0]!r}" for name, error in errors.items()]
    print(json.dumps(said))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
