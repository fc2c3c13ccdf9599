"""The words of a command: what is wrong with them is said in one line."""

from __future__ import annotations

import argparse

from dafw.core.errors import ConfigurationError


class Parser(argparse.ArgumentParser):
    """Raises ConfigurationError where argparse would print its usage and exit."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """Refuse the words in one line, as every command does."""
        raise ConfigurationError(f"{self.prog.removeprefix('dafw ')}: {message}")
