"""Checks of models."""

from __future__ import annotations

import numpy as np

from dafw.authoring.checks import Factory, NotApplicable, check, require
from dafw.authoring.evidence import (
    frozen,
    global_generators,
    no_global_draws,
    require_in_set,
    require_same_bits,
    restored,
)
from dafw.core.ensemble import Ensemble, Forecast, Memory
from dafw.core.executors.batches import Batch, step_members
from dafw.core.interfaces import Model
from dafw.core.rng import MemberStreams, Streams
from dafw.core.space import StateSpace

MEMBERS, STEPS = 3, 2


def _streams(role: str, cycle: int = 0, seed: int = 0) -> MemberStreams:
    return Streams(seed).members(role, cycle)


def stepped(model: Model, n_members: int = MEMBERS, steps: int = STEPS) -> list[Forecast]:
    """Return the first guess and the forecasts of the following steps."""
    states = [model.first_guess(n_members, _streams("initial"))]
    for cycle in range(steps):
        states.append(model.forecast(states[-1].ensemble, states[-1].memory, _streams("step", cycle)))
    return states


@check("model")
def shapes(factory: Factory) -> None:
    """Model, first guess and step agree on the state space, for one member and for several, and every number is finite."""  # noqa: E501
    model = factory()
    require(isinstance(model.space, StateSpace), f"space must be a StateSpace, got {type(model.space).__name__}")
    require(model.dt > 0.0, f"dt must be above zero, got {model.dt}")
    for n_members in (1, 2, 5):
        last = stepped(model, n_members, 1)[-1].ensemble
        require(np.isclose(last.time, model.dt), f"after a step the time is {last.time}, expected {model.dt}")


@check("model")
def inputs_unchanged(factory: Factory) -> None:
    """A step does not change the members and the memory that it is given: the cycle still needs them."""
    model = factory()
    state = stepped(model, steps=1)[-1]
    members, memory = frozen(state.ensemble.members), frozen(state.memory)
    model.forecast(state.ensemble, state.memory, _streams("step", 1))
    require(frozen(state.ensemble.members) == members, "a step changed the members it was handed")
    require(frozen(state.memory) == memory, "a step changed the memory it was handed")


@check("model")
def determinism(factory: Factory) -> None:
    """The same inputs and the same streams give the same bits: a study can be repeated."""
    with global_generators():
        first = stepped(factory(), steps=1)
    with global_generators():
        second = stepped(factory(), steps=1)
    for what, a, b in zip(("first guesses", "steps"), first, second, strict=True):
        require_same_bits(a.ensemble.members, b.ensemble.members, f"two {what} of the same differ")


@check("model")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the streams passed in, never from global generators, which any other code may advance."""  # noqa: E501
    with no_global_draws():
        stepped(factory(), steps=1)


@check("model")
def larger_ensemble(factory: Factory) -> None:
    """Adding members to an ensemble does not change the first guesses of the others."""
    model = factory()
    small = model.first_guess(2, _streams("initial")).ensemble.members
    large = model.first_guess(5, _streams("initial")).ensemble.members
    require_same_bits(large[:2], small, "the first guess of 2 members differs when 3 more are drawn")


@check("model")
def batches(factory: Factory) -> None:
    """Members stepped in separate batches equal members stepped together, bit for bit: serial and parallel runs agree."""  # noqa: E501
    with global_generators():
        state = stepped(factory(), steps=1)[-1]
        together = factory().forecast(state.ensemble, state.memory, _streams("step", 1))
    for batch in (slice(0, 1), slice(1, MEMBERS)):
        with global_generators():
            part = Ensemble(state.ensemble.members[batch].copy(), state.ensemble.space, state.ensemble.time)
            streams = _streams("step", 1).shifted(batch.start)
            apart = factory().forecast(part, _rows(state.memory, batch), streams)
        which = f"members {batch.start} to {batch.stop - 1}"
        require_same_bits(
            apart.ensemble.members, together.ensemble.members[batch], f"{which} differ when stepped by themselves"
        )
        require_same_bits(apart.memory, _rows(together.memory, batch), f"the memory of {which} differs")


def _rows(memory: Memory | None, batch: slice) -> Memory | None:
    return None if memory is None else {name: np.asarray(value)[batch] for name, value in memory.items()}


@check("model")
def restart(factory: Factory) -> None:
    """A run stopped after any step and continued from its file has the same bits: the plugin keeps nothing on itself."""  # noqa: E501
    with global_generators():
        whole = stepped(factory())
    with global_generators():
        pieces = whole[:1]
        for cycle in range(STEPS):
            last = pieces[-1]
            ensemble = Ensemble(last.ensemble.members.copy(), last.ensemble.space, last.ensemble.time)
            pieces.append(factory().forecast(ensemble, restored(last.memory), _streams("step", cycle)))
    for step, (first, second) in enumerate(zip(whole, pieces, strict=True)):
        message = f"step {step}: the members differ in a run that was cut off before it"
        require_same_bits(first.ensemble.members, second.ensemble.members, message)


@check("model")
def several_steps(factory: Factory) -> None:
    """A re-run over several steps equals single steps, bit for bit, whether or not the model makes several at once."""
    with global_generators():
        single = stepped(factory())
    with global_generators():
        start = single[0]
        members, memory = start.ensemble.members.copy(), restored(start.memory)
        batch = Batch(members, memory, start.ensemble.time, _streams("step"), STEPS, keep=True)
        together = step_members(factory(), batch).steps
    for number, (one, step) in enumerate(zip(single[1:], together, strict=True), 1):
        which = f"after {number} of {STEPS} steps of a re-run"
        require_same_bits(step.members, one.ensemble.members, f"the members differ {which}")
        require_same_bits(step.memory, one.memory, f"the memory differs {which}")


@check("model")
def first_guess_in_set(factory: Factory) -> None:
    """First guesses are in the range of each variable: nonnegative numbers are not below zero, positive numbers are above zero, and angles lie in [0, 2 pi)."""  # noqa: E501
    model = factory()
    members = model.first_guess(20, _streams("initial")).ensemble.members
    require_in_set(model.space, members, "a first guess")


@check("model")
def first_guess_possible(factory: Factory) -> None:
    """A model that tells how likely first guesses are calls none of its own impossible: filters divide by that density."""  # noqa: E501
    model = factory()
    if type(model).log_first_guess is Model.log_first_guess:
        raise NotApplicable("it does not tell how likely its first guesses are")
    members = model.first_guess(20, _streams("initial")).ensemble.members
    model.checked_log_density(members, drawn=True)


@check("model")
def steps_in_set(factory: Factory) -> None:
    """Steps keep every variable in its range: nonnegative numbers are not below zero, positive numbers are above zero, and angles lie in [0, 2 pi)."""  # noqa: E501
    model = factory()
    for state in stepped(model)[1:]:
        require_in_set(model.space, state.ensemble.members, "a step")
