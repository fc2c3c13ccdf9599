"""Named exceptions, each with a command's exit status: 2 if the request was wrong, 1 if a computation failed."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class DafwError(Exception):
    """Base of all errors that dafw raises.

    ``member`` is the number of the member that it is about, if any. ``time`` (s) and ``phase`` say where in a run it
    was raised, if it was raised within a cycle.
    """

    exit_status: ClassVar[int] = 1
    member: int | None = None
    time: float | None = None
    phase: str | None = None

    def __str__(self) -> str:
        text = super().__str__()
        return text if self.member is None else f"member {self.member}: {text}"


class RequestError(DafwError):
    """The request cannot be fulfilled; raised before anything is computed."""

    exit_status = 2


class ConfigurationError(RequestError):
    """A configuration holds a value, a name or a combination that is not accepted."""


class OptionError(ConfigurationError):
    """An option is unknown, of the wrong type or out of range."""


class PluginError(RequestError):
    """A plugin cannot be registered, found or built; the message names it."""


class SiteError(RequestError):
    """A site description cannot be turned into a computational domain."""


class ReadingsError(RequestError):
    """A file of readings cannot be read, or does not fit the study; the message names the file, row and column."""


class RunError(RequestError):
    """A folder or file does not hold a run that can be read, or holds one that must not be overwritten."""


class CheckpointError(RunError):
    """A checkpoint or a journal of a run is damaged or of another version."""


class ComputationError(DafwError):
    """A computation failed although the request was valid."""


class ContractError(ComputationError):
    """A plugin broke its interface: wrong shape, non-finite numbers, changed inputs. The message names the plugin."""


class NoMoreReadingsError(DafwError):
    """The feed of a source has ended: the readings of this cycle will not come, and the run ends before it."""


class DivergenceError(ComputationError):
    """A belief has diverged: its numbers are far beyond what the model can produce."""


class RecordError(ComputationError):
    """The record of a run can no longer be written, for example because the disk is full."""


class FetchError(ComputationError):
    """A server did not give what it was asked for."""


class SolverError(ComputationError):
    """A solver did not reach its tolerance; its result must not be used."""


DISK_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Error numbers of a full or broken disk: the computation failed although the request was valid."""


def is_request(error: BaseException) -> bool:
    """Return whether an error of the operating system is due to the request, such as a file that does not exist."""
    return isinstance(error, OSError) and error.errno not in DISK_FAILURES


def in_one_line(error: BaseException, longest: int | None = None) -> str:
    """Return the text of an error without line ends, of at most ``longest`` characters."""
    return " ".join(str(error).split())[:longest]


@contextmanager
def about_member(member: int) -> Iterator[None]:
    """Mark errors raised in the block as being about ``member``, its number in the array that the model was given."""
    try:
        yield
    except DafwError as error:
        if error.member is None:
            error.member = member
        raise
