"""Re-runs of the dispersion models: several steps at once have the bits of single ones, whatever is kept."""

import numpy as np
import pytest

from dafw.core.errors import ConfigurationError
from dafw.core.executors.serial import Serial
from dafw.core.options import build
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion import model as module
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.transport import transport

STREAMS = Streams(11)
CYCLES = 6
WAYS = pytest.mark.parametrize(
    "changes",
    [
        {},
        {"transport": {"solver": "direct"}},
        {"transport": {"solver": "direct", "scheme": "fct", "outflow": "open"}},
        {"transport": {"solver": "direct"}, "noise": 0.1},
        {"transport": {"solver": "direct"}, "estimate": ["diffusion"]},
        {"transport": {"solver": "direct"}, "wind_change": {"kind": "prescribed", "veer": 0.4}},
        {"transport": {"solver": "direct"}, "source": {"kind": "leak", "rate": 0.1, "start": 2.5}},
    ],
    ids=["iterative", "direct", "fct", "noise", "diffusion", "changing wind", "leak"],
)


@pytest.fixture(scope="module")
def make(small_model):
    return lambda changes, cls=AdvectionDiffusion: build(cls, small_model | changes, "model 'test'")


def one_by_one(model, n_members=4):
    """Return the forecasts of the cycles, each stepped alone."""
    states = [model.first_guess(n_members, STREAMS.members("initial", 0))]
    for cycle in range(CYCLES):
        last = states[-1]
        states.append(model.forecast(last.ensemble, last.memory, STREAMS.members("model error", cycle)))
    return states


def rerun(model, start, last=CYCLES):
    return Rerun(model, Serial(), STREAMS)(start, 0, last, keep=True).states


def same(states, others):
    for one, other in zip(states, others, strict=True):
        assert one.ensemble.members.tobytes() == other.ensemble.members.tobytes()
        assert one.ensemble.time == other.ensemble.time
        assert one.diagnostics.keys() == other.diagnostics.keys()
        for name, diagnostic in one.diagnostics.items():
            np.testing.assert_array_equal(diagnostic.values, other.diagnostics[name].values)


@WAYS
def test_several_steps_at_once_have_the_bits_of_single_ones(make, changes, monkeypatch):
    states = one_by_one(make(changes))
    same(rerun(make(changes), states[0]), states[1:])
    size = states[0].ensemble.members.nbytes
    monkeypatch.setattr(module, "BLOCK_BYTES", 3 * size)  # blocks of 4 and of 2 steps
    same(rerun(make(changes), states[0]), states[1:])


def test_around_buildings_too(make):
    changes = {"transport": {"solver": "direct"}}
    states = one_by_one(make(changes, AdvectionDiffusionINS), 2)
    same(rerun(make(changes, AdvectionDiffusionINS), states[0]), states[1:])


@WAYS
def test_the_bits_do_not_depend_on_what_is_kept(make, changes, monkeypatch):
    alone = one_by_one(make(changes))
    used = make(changes)
    other = rerun(used, used.first_guess(7, STREAMS.members("others", 0)), last=2)
    assert other[0].ensemble.members.tobytes() != alone[1].ensemble.members.tobytes()
    same(rerun(used, alone[0]), alone[1:])
    monkeypatch.setattr(transport, "SYSTEMS_BYTES", 0.0)
    few = make(changes)
    for _ in range(2):
        same(rerun(few, alone[0]), alone[1:])
        same(one_by_one(few)[1:], alone[1:])
    assert len(few._systems) == 1


def test_members_with_the_same_parameters_share_a_system_and_other_members_do_not_push_it_out(make):
    model = make({"transport": {"solver": "direct"}})
    start = model.first_guess(4, STREAMS.members("initial", 0))
    members = start.ensemble.members.copy()
    members[2] = members[0]
    belief = start.ensemble.with_members(members)
    rerun(model, belief)
    assert len(model._systems) == 3
    made = []
    model.system = lambda *words: made.append(words) or AdvectionDiffusion.system(model, *words)
    rerun(model, model.first_guess(30, STREAMS.members("others", 0)), last=1)
    assert len(made) == 30
    rerun(model, belief)
    assert len(made) == 30


def test_a_divided_mesh_needs_the_iterative_solver(make):
    model = make({"transport": {"solver": "direct"}})
    with pytest.raises(ConfigurationError, match="solver 'direct' works in one process, expected 'iterative'"):
        model.distribute(object())
