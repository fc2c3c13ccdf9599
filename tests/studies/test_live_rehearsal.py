"""A live run rehearses its first cycle: what that is told, and that nothing of it enters the run."""

from __future__ import annotations

import numpy as np
import pytest
from live_feeds import lines, waves
from run_files import contents

from dafw import Domain, Request, StateSpace, Study, Variable
from dafw.core.ensemble import Ensemble
from dafw.core.observation import nothing
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.live import Live
from dafw.plugins.readings.twin import Twin
from dafw.studies import running
from dafw.studies.running import run_study

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
SPACE = StateSpace([Variable("gas", 4, units="mg m-3", coordinates=NODES), Variable("rate", 1)])
GROUND = Domain((0.0, 0.0, 100.0, 100.0), triangles=np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32))
VALUES = np.array([[1.0, 2.0, 3.0, 4.0, 7.0]])


def rehearsed(space=SPACE, domain=GROUND, values=VALUES, **options):
    source = Live.from_options(**options)
    source.suit(space, domain, 1.0)
    truth = Ensemble(values, space)
    return source.rehearsal(Request(0, 0.0, 1.0, space, domain, nothing(), truth))


def test_it_is_given_readings_of_a_truth_where_messages_would_be():
    (at_nodes,) = rehearsed()
    assert at_nodes.values.tolist() == [1.0, 2.0, 3.0, 4.0] and at_nodes.time == 1.0
    np.testing.assert_allclose(at_nodes.operator.apply(VALUES)[0], at_nodes.values)
    np.testing.assert_allclose(np.sqrt(at_nodes.variance), 0.004)
    (at_entries,) = rehearsed(entries={"a": 2})
    assert at_entries.values.tolist() == [3.0]
    (along,) = rehearsed(paths={"a": [[0, 0], [100, 0]]})
    assert along.values.tolist() == [2.5]
    (single,) = rehearsed(variable="rate")
    assert single.values.tolist() == [7.0]
    (silent,) = rehearsed(values=np.zeros((1, 5)))
    assert silent.values.tolist() == [0.0] * 4 and (silent.variance == 1.0).all()
    assert Twin().rehearsal(Request(0, 0.0, 1.0, SPACE, GROUND, nothing())) == ()


def test_no_bit_of_a_run_depends_on_it(tmp_path, monkeypatch):
    (tmp_path / "feed.jsonl").write_text(lines())
    run_study(waves(tmp_path / "feed.jsonl"), tmp_path / "rehearsed")
    assert "the first cycle was rehearsed in" in (tmp_path / "rehearsed" / "run.log").read_text()
    monkeypatch.setattr(running, "rehearse", lambda parts, state: None)
    run_study(waves(tmp_path / "feed.jsonl"), tmp_path / "not")
    assert contents(tmp_path / "rehearsed") == contents(tmp_path / "not")


class Stubborn(Lorenz96):
    """Cannot be stepped alone."""

    def step(self, members, t, rng):
        if len(members) == 1:
            raise ArithmeticError("alone")
        return super().step(members, t, rng)


@pytest.mark.parametrize("live", [True, False])
def test_one_that_fails_is_no_reason_to_end_and_only_live_runs_rehearse(live, tmp_path):
    (tmp_path / "feed.jsonl").write_text(lines())
    readings = Live.from_options(source=str(tmp_path / "feed.jsonl")) if live else Twin()
    truth = {} if live else {"truth": Lorenz96()}
    study = Study(model=Stubborn(), readings=readings, filter=ETKF(), members=4, cycles=2, **truth)
    assert run_study(study, tmp_path / "run")["status"] == "complete"
    told = "the first cycle could not be rehearsed: at t = 0 s, phase 'truth': model 'Stubborn' raised ArithmeticError"
    assert (told in (tmp_path / "run" / "run.log").read_text()) == live
