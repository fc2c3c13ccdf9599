"""Parsing the arguments of a command; wrong arguments give a one-line error."""

from __future__ import annotations

import argparse
from typing import NoReturn

from dafw.core.errors import ConfigurationError


class Parser(argparse.ArgumentParser):
    """Raises ConfigurationError if argparse would print its usage and exit."""

    def error(self, message: str) -> NoReturn:
        """Raise ConfigurationError with a one-line message."""
        raise ConfigurationError(f"{self.prog.removeprefix('dafw ')}: {message}")
