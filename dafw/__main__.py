"""``python -m dafw``: the command ``dafw``."""

import sys

from dafw.commands import main

if __name__ == "__main__":
    sys.exit(main())
