"""Named exceptions, each with the exit status of a command: 2, the request was wrong; 1, a computation failed."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class DafwError(Exception):
    """Everything that dafw raises on purpose; ``member`` is the number of the member it was about, where it was one."""

    exit_status: ClassVar[int] = 1
    member: int | None = None

    def __str__(self) -> str:
        text = super().__str__()
        return text if self.member is None else f"member {self.member}: {text}"


class RequestError(DafwError):
    """What was asked for cannot be done: found before anything is computed."""

    exit_status = 2


class ConfigurationError(RequestError):
    """A configuration holds a value, a name or a combination that is not accepted."""


class OptionError(ConfigurationError):
    """An option is unknown, of the wrong type or out of range."""


class PluginError(RequestError):
    """A plugin cannot be registered, found or built; the message names it."""


class SiteError(RequestError):
    """A site description cannot be turned into a computational domain."""


class RunError(RequestError):
    """A folder or file does not hold a run that can be read, or holds one that must not be overwritten."""


class ComputationError(DafwError):
    """A computation failed although the request was a legal one."""


class ContractError(ComputationError):
    """A plugin broke its interface: wrong shape, non-finite numbers, changed inputs. The message names the plugin."""


class DivergenceError(ComputationError):
    """A belief has left all sense: its numbers are far beyond what the model can produce."""


class RecordError(ComputationError):
    """A run cannot be written on: the disk is full, say."""


class SolverError(ComputationError):
    """A solver did not reach its tolerance; its result must not be used."""


DISK_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""A disk that is full or broken: a computation fails although the request was a legal one."""


def is_request(error: BaseException) -> bool:
    """Say whether an error of the operating system is about what was asked for, such as a file that is not there."""
    return isinstance(error, OSError) and error.errno not in DISK_FAILURES


@contextmanager
def about_member(member: int) -> Iterator[None]:
    """Have errors say which member of the ensemble they are about, counted in what a model was handed."""
    try:
        yield
    except DafwError as error:
        if error.member is None:
            error.member = member
        raise
