"""Checks of observers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dafw.authoring.checks import Factory, check, require
from dafw.authoring.evidence import frozen, global_generators, no_global_draws, require_close, require_same_bits
from dafw.authoring.problems import belief, gas_space, routes
from dafw.core.ensemble import Route
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator
from dafw.core.space import Array, StateSpace


def space_for(plugin: Observer) -> StateSpace:
    """Return the space on which the observer is checked."""
    return plugin.check_space() or gas_space()


def _operators(observer: Observer) -> Iterator[tuple[Route, float, ObservationOperator]]:
    """Ask for the readings of every route at three times."""
    for t in (0.0, 1.0, 7.5):
        for route in routes():
            yield route, t, observer.look(space_for(observer), route, t)


@check("observer")
def shapes(factory: Factory) -> None:
    """An operator gives for every member, one or several, as many finite readings as R has rows; if they have places, one for each reading."""  # noqa: E501
    observer = factory()
    space = space_for(observer)
    for _, _, operator in _operators(observer):
        for n_members in (1, 2, 5):
            observer.read(operator, belief(space, n_members))
        places = operator.coordinates
        if places is not None:
            require(
                places.ndim == 2 and len(places) == operator.size,
                f"coordinates of {operator.size} readings have the shape {places.shape}, expected ({operator.size}, d)",
            )


@check("observer")
def covariances(factory: Factory) -> None:
    """R and the covariance of the noise are symmetric and positive definite: filters invert R, and runs draw the noise."""  # noqa: E501
    for _, _, operator in _operators(factory()):
        for name, R in (("R", operator.covariance), ("the noise covariance", operator.noise)):  # noqa: N806
            if R.ndim == 2 and R.size:
                require(np.allclose(R, R.T, rtol=1e-12), f"{name} is not symmetric")
                lowest = float(np.linalg.eigvalsh(R)[0])
                require(lowest > 0.0, f"{name} is not positive definite: its lowest eigenvalue is {lowest:.3g}")


@check("observer")
def inputs_unchanged(factory: Factory) -> None:
    """Reading does not change the members."""
    observer = factory()
    members = np.array(belief(space_for(observer)).members)
    before = frozen(members)
    for _, _, operator in _operators(observer):
        operator.apply(members)
        require(frozen(members) == before, "reading changed the members")


@check("observer")
def determinism(factory: Factory) -> None:
    """The same route at the same time gives the same readings and R, bit for bit: the cycle adds the noise, not the observer."""  # noqa: E501
    with global_generators():
        first = _readings(factory())
    with global_generators():
        second = _readings(factory())
    for a, b in zip(first, second, strict=True):
        require_same_bits(a, b, "two readings of the same differ")


@check("observer")
def own_generator(factory: Factory) -> None:
    """An observer draws no random numbers: it is given no generator, and global ones may be advanced by any other code."""  # noqa: E501
    with no_global_draws():
        _readings(factory())


def _readings(observer: Observer) -> list[Array]:
    ensemble = belief(space_for(observer))
    return [
        part
        for _, _, operator in _operators(observer)
        for part in (operator.apply(ensemble.members), operator.covariance, operator.noise, *_reported(operator))
    ]


def _reported(operator: ObservationOperator) -> list[Array]:
    """Return the values of the diagnostics by name."""
    return [np.asarray(operator.diagnostics[name].values) for name in sorted(operator.diagnostics)]


@check("observer")
def diagnostics(factory: Factory) -> None:
    """A diagnostic of an observer has the same axes and lengths in every cycle: a run file has one variable for it."""
    first: dict[tuple[str, int], tuple[tuple[str, ...], tuple[int, ...]]] = {}
    for route, t, operator in _operators(factory()):
        for name, reported in operator.diagnostics.items():
            found = tuple(reported.dims), np.shape(reported.values)
            expected = first.setdefault((name, len(route.paths)), found)  # a run has one number of vehicles
            require(
                found == expected,
                f"'{name}' has the axes {found[0]} and the shape {found[1]} at t = {t:g} s, "
                f"and had {expected[0]} and {expected[1]} before",
            )


@check("observer")
def member_order(factory: Factory) -> None:
    """Each member is read independently of the others: members in another order give the same readings in that order."""  # noqa: E501
    observer = factory()
    members = belief(space_for(observer)).members
    order = np.array([3, 0, 5, 1, 4, 2])
    for _, _, operator in _operators(observer):
        found = operator.apply(members[order])
        require_close(found, operator.apply(members)[order], 1e-12, "what a member reads depends on the others")


@check("observer")
def restart(factory: Factory) -> None:
    """Readings depend on route and time, not on earlier readings: a run can be stopped and continued anywhere."""
    used = factory()
    members = belief(space_for(used)).members
    for route, t, operator in _operators(used):
        fresh = factory().look(space_for(used), route, t)
        message = f"at t = {t:g} s a fresh observer reads something else"
        require_same_bits(operator.apply(members), fresh.apply(members), message)
        require_same_bits(operator.covariance, fresh.covariance, f"{message}: another R")
        for used_value, fresh_value in zip(_reported(operator), _reported(fresh), strict=True):
            require_same_bits(used_value, fresh_value, f"{message}: another diagnostic")
