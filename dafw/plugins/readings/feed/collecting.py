"""Waiting for the readings of a cycle: until its time has come, until the feed is past it, or until the feed ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from dafw.plugins.readings.feed.desk import Desk
from dafw.plugins.readings.feed.feed import Feed

LOOK = 0.1
"""Seconds between two looks whether the run was asked to stop."""


@dataclass(frozen=True)
class Patience:
    """How long to wait: by the wall's clock or not, at most so many seconds for a message, and until asked to stop."""

    wall: bool
    silence: float | None
    asked_to_stop: Callable[[], bool]


def collect(feed: Feed, desk: Desk, cycle: int, grace: float, patience: Patience) -> None:
    """Put the entries of a cycle on the desk; raises KeyboardInterrupt if the run was asked to stop."""
    heard, drained = monotonic(), 0
    while True:
        left = _left(feed, desk, grace) if patience.wall else LOOK
        if not feed.tells_ends(desk.state) and _is_over(feed, desk, grace, left, drained, patience):
            if feed.ended and not desk.state.ended:
                if patience.asked_to_stop():  # what stops the run has ended its feed, too
                    raise KeyboardInterrupt
                feed.say_end(cycle, desk.state)
            if not (desk.state.ended and desk.is_barren):
                feed.end_cycle(cycle, desk.state)
            return
        entry = feed.next(max(0.0, min(left, LOOK)), cycle, desk.state)
        if entry is not None and entry.ends:
            if not entry.own:
                feed.end_cycle(cycle, desk.state)
            return
        if entry is not None:
            heard = monotonic()
            drained += left <= 0.0
            desk.put(entry)
            continue
        if has_ended(feed, desk):
            continue
        if patience.wall and left <= 0.0:
            feed.end_cycle(cycle, desk.state)
            return
        if patience.silence is not None and monotonic() - heard > patience.silence:
            feed.say_end(cycle, desk.state)
        if patience.asked_to_stop():
            raise KeyboardInterrupt


def has_ended(feed: Feed, desk: Desk) -> bool:
    """Return whether no more messages will come."""
    return feed.ended or desk.state.ended


def _left(feed: Feed, desk: Desk, grace: float) -> float:
    """Return the seconds until the end of the cycle by the wall's clock."""
    return (desk.state.zero or 0.0) + desk.end + grace - feed.clock()


def _is_over(feed: Feed, desk: Desk, grace: float, left: float, drained: int, patience: Patience) -> bool:
    """Return whether the cycle has its readings.

    By the wall's clock, a cycle whose time has come waits no longer than for the message that says that all was sent.
    What came until the end of the grace is still taken, but not more than a cycle may have: so a feed that never pauses
    cannot hold a cycle up.
    """
    if has_ended(feed, desk):
        return True
    if patience.wall:
        return (left <= grace and desk.has_all) or (left <= 0.0 and drained >= desk.rules.most)
    return desk.is_over(grace)
