"""Checkpoints: values and arrays there and back to the last bit, damage that is noticed, nothing that is executed."""

import io
import json
import pickle
import random
import zipfile
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from toys import Counting, Growth, Hop, OneNode

from dafw import Diagnostic, Ensemble, Forecast, Observation, ObservationOperator, Selection, Study
from dafw.core.checkpoints.checkpoint_file import (
    KEPT,
    TOLD,
    TOLD_OF,
    Checkpoint,
    checkpoints,
    read_checkpoint,
    write_checkpoint,
)
from dafw.core.checkpoints.fingerprint import changed_versions, described, difference, digest, start_digest
from dafw.core.checkpoints.journal import Journal, entries
from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.core.checkpoints.values import UnwritableError, packed, unpacked
from dafw.core.cycle import advance
from dafw.core.errors import CheckpointError
from dafw.core.executors.processes import Processes
from dafw.core.window import PastCycle
from dafw.plugins.filters.enkf import EnKF


@dataclass(frozen=True, eq=False, kw_only=True)
class Weighed(ObservationOperator):
    """An operator as a plugin may define one."""

    factor: float

    def apply(self, members):
        return self.factor * members[:, : self.size]


@pytest.fixture(scope="module")
def begun():
    study = Study(
        model=Counting(), truth=Growth(), free=Growth(), observer=OneNode(), policy=Hop(), filter=EnKF(),
        start=[[0.0, 0.0]], members=3, seed=5,
    )  # fmt: skip
    return study.begin()


def there_and_back(state, parts):
    found = {}
    tree = json.loads(json.dumps(packed(state, parts, found)))
    stream = io.BytesIO()
    np.savez(stream, **found)
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as file:
        return unpacked(tree, parts, {name: file[name] for name in file.files})


def same(one, other):
    """Return whether two values agree in their types, their bits, and the order of their numbers in memory."""
    if one is other:
        return True
    if isinstance(one, np.ndarray):
        strides = [
            [stride for stride, size in zip(array.strides, array.shape, strict=True) if size > 1]
            for array in (one, other)
        ]
        order = [np.argsort([-stride for stride in some], kind="stable").tolist() for some in strides]
        alike = (one.dtype, one.shape, one.flags.writeable) == (other.dtype, other.shape, other.flags.writeable)
        return alike and one.tobytes() == other.tobytes() and order[0] == order[1]
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other)) and type(one) is type(other)
    if hasattr(one, "__dict__") and not isinstance(one, np.generic):
        return type(one) is type(other) and same(dict(vars(one)), dict(vars(other)))
    return type(one) is type(other) and repr(one) == repr(other)


def test_a_state_goes_there_and_back_and_the_next_cycle_has_the_same_bits(begun):
    parts, state = begun
    state = advance(parts, advance(parts, state).state).state
    again = there_and_back(state, parts)
    assert again.belief.ensemble.space is parts.model.space and again.vehicle.airspace is parts.model.domain
    one, other = advance(parts, state).state, advance(parts, again).state
    for role in ("belief", "truth", "free"):
        mine, theirs = getattr(one, role), getattr(other, role)
        assert mine.ensemble.members.tobytes() == theirs.ensemble.members.tobytes()
        assert mine.ensemble.time == theirs.ensemble.time
    assert same(dict(one.belief.memory), dict(other.belief.memory))


KINDS = arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.bool_, "<U3"]), array_shapes(max_dims=3, max_side=4)
)
MEMORY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | KINDS | KINDS.map(np.transpose)
    | st.floats().map(np.float64),
    lambda inner: st.lists(inner, max_size=3) | st.lists(inner, max_size=3).map(tuple)
    | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)  # fmt: skip


@given(memory=st.dictionaries(st.text(max_size=3), MEMORY, max_size=3))
@settings(max_examples=40, deadline=None)
def test_whatever_a_plugin_remembers_comes_back(begun, memory):
    parts, state = begun
    again = there_and_back(replace(state, policy_memory=memory), parts)
    assert same(again.policy_memory, memory)


def test_a_past_with_operators_weights_and_shared_arrays_comes_back(begun):
    parts, state = begun
    shared = np.arange(12.0).reshape(3, 4)[:, ::2]
    fixed = np.arange(4.0)
    fixed.setflags(write=False)
    members = np.asfortranarray(np.arange(15.0).reshape(3, 5))
    belief = Forecast(
        Ensemble(members, parts.model.space, 0.1 + 0.2, weights=[0.2, 0.3, 0.5]),
        {"fixed": fixed, "shared": shared},
        {"rank": Diagnostic(np.int64(3), (), "1", "rank")},
    )
    seen = Observation([1.5], Selection(indices=np.array([2]), covariance=np.array([0.1]), sensors=("a",)), 2.0)
    other = Observation([0.5], Weighed(covariance=np.array([0.1]), factor=np.nan), 4.0)
    past = (PastCycle(0, belief, seen), PastCycle(1, None, other))
    again = there_and_back(replace(state, past=past, filter_memory={"shared": shared}), parts)
    assert same(again.past, past)
    assert again.past[0].belief.memory["shared"] is again.filter_memory["shared"]


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        ({"f": len}, r"state.filter_memory\['f'\] is of the type builtin_function_or_method"),
        ({"a": [np.array([None])]}, r"\['a'\]\[0\] is an array of Python objects"),
        ({"a": np.ma.array([1.0])}, "MaskedArray"),
        ({(1, 2): 3.0}, "keys that are neither texts nor numbers"),
        ({"s": Growth(space=OneNode)}, "type Growth"),
    ],
)
def test_what_cannot_be_written_is_named(begun, memory, message):
    parts, state = begun
    with pytest.raises(UnwritableError, match=message):
        packed(replace(state, filter_memory=memory), parts, {})


@pytest.mark.parametrize(
    "tree",
    [
        {"value": "os.system", "fields": {}},
        {"operator": "subprocess:Popen", "fields": {"args": "true"}},
        {"operator": "builtins:eval", "fields": {}},
        {"value": "State", "fields": {"cycle": 0}},
        {"array": "a9", "axes": [], "fixed": True},
        {"space": "nowhere"},
        [],
        None,
    ],
)
def test_a_tree_makes_only_what_the_study_has_loaded(begun, tree):
    with pytest.raises(CheckpointError, match="its state cannot be read"):
        unpacked(tree, begun[0], {})


SAID = {name: kind() for name, kind in TOLD_OF.items()}


@pytest.fixture
def written(tmp_path):
    for cycle in (3, 7, 12):
        told = {**SAID, "state": {"number": cycle}}
        write_checkpoint(tmp_path, Checkpoint(cycle, told, {"a0": np.arange(50.0) + cycle, "a1": np.array(cycle)}))
    return tmp_path


def test_the_newest_checkpoints_are_kept_and_read(written):
    files = checkpoints(written)
    assert [read_checkpoint(path).cycle for path in files] == [12, 7] and len(files) == KEPT
    found = read_checkpoint(files[0])
    assert found.told["state"] == {"number": 12} and found.arrays["a1"].shape == ()
    assert np.array_equal(found.arrays["a0"], np.arange(50.0) + 12)
    assert not list(written.glob(".*"))


def test_damage_anywhere_in_a_checkpoint_is_noticed_or_harmless(written):
    path = checkpoints(written)[0]
    whole, rng = path.read_bytes(), random.Random(0)
    found = read_checkpoint(path)
    noticed = 0
    for place in [rng.randrange(len(whole)) for _ in range(60)]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            again = read_checkpoint(path)
        except CheckpointError as error:
            assert str(path) in str(error)
            noticed += 1
        else:  # a date of the zip file, say
            assert again.told == found.told
            assert all(np.array_equal(again.arrays[name], found.arrays[name]) for name in found.arrays)
    assert noticed > 30
    for length in (0, 1, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(CheckpointError, match="is damaged"):
            read_checkpoint(path)


class Bomb:
    """Raises an error where it is unpickled."""

    def __reduce__(self):
        return (pytest.fail, ("the checkpoint was executed",))


def test_a_pickle_in_a_checkpoint_is_refused_and_not_executed(tmp_path):
    path = tmp_path / "state-000000001.npz"
    with path.open("wb") as stream:
        np.savez(stream, **{TOLD: np.array([Bomb()], dtype=object)})
    with pytest.raises(CheckpointError, match="is damaged"):
        read_checkpoint(path)
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(CheckpointError, match="is damaged"):
        read_checkpoint(path)


def test_a_checkpoint_of_another_version_is_refused(written):
    path = checkpoints(written)[0]
    text = json.dumps({"format": "dafw checkpoint", "version": 99, "cycle": 1}).encode()
    with zipfile.ZipFile(path, "w") as file, file.open(f"{TOLD}.npy", "w") as stream:
        np.lib.format.write_array(stream, np.frombuffer(text, dtype=np.uint8))
    with pytest.raises(CheckpointError, match="version 99, expected 'dafw checkpoint' of version 1"):
        read_checkpoint(path)


def test_a_checkpoint_that_says_it_is_encrypted_is_damaged(written):
    path = checkpoints(written)[0]
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    with pytest.raises(CheckpointError, match=r"is damaged .RuntimeError: .*encrypted"):
        read_checkpoint(path)


@pytest.mark.parametrize("name", TOLD_OF)
def test_a_checkpoint_that_does_not_say_everything_is_refused(name, tmp_path):
    write_checkpoint(tmp_path, Checkpoint(1, {**SAID, name: None}, {}))
    if name != "cycle":  # it is written in any case
        with pytest.raises(CheckpointError, match=f"is damaged .it does not say its {name}"):
            read_checkpoint(checkpoints(tmp_path)[0])


def test_a_journal_is_read_up_to_a_length_and_goes_on_there(tmp_path):
    path, lengths = tmp_path / "rows", []
    with Journal(path) as journal:
        for number in range(4):
            journal.add({"row": number}, {"x": np.arange(number, dtype="f4"), "y": np.array([[True]])})
            lengths.append(journal.length())
    with Journal(path, lengths[1]) as journal:
        journal.add({"row": "new"})
        end = journal.length()
    found = list(entries(path, end))
    assert [told["row"] for told, _ in found] == [0, 1, "new"]
    assert found[1][1]["x"].dtype == np.float32 and found[1][1]["y"].shape == (1, 1)
    assert len(list(entries(path, lengths[0]))) == 1
    for wrong in (lengths[0] + 1, end + 1, end - 1):
        with pytest.raises(CheckpointError, match="is damaged"):
            list(entries(path, wrong))


def test_damage_anywhere_in_a_journal_is_noticed(tmp_path):
    path = tmp_path / "rows"
    with Journal(path) as journal:
        for number in range(3):
            journal.add({"row": number}, {"x": np.arange(5.0)})
        length = journal.length()
    whole = path.read_bytes()
    for place in range(0, length, 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(CheckpointError, match="is damaged"):
            list(entries(path, length))
    path.unlink()
    with pytest.raises(CheckpointError, match="is damaged"):
        list(entries(path, length))


@pytest.mark.parametrize(
    ("plan", "cycles", "seconds", "cost", "due"),
    [
        (CheckpointPlan(), 1, 29.0, 0.0, False),
        (CheckpointPlan(), 1, 30.0, 0.1, True),
        (CheckpointPlan(), 1, 30.0, 0.5, False),  # 0.5 s in 50 s are 1 %
        (CheckpointPlan(), 1, 50.0, 0.5, True),
        (CheckpointPlan(every=None), 10**6, 1e9, 0.0, False),
        (CheckpointPlan(cycles=3), 2, 1e9, 0.0, False),
        (CheckpointPlan(cycles=3), 3, 0.0, 1e9, True),
        (CheckpointPlan(every=None, cycles=1), 1, 0.0, 0.0, True),
    ],
)
def test_when_a_checkpoint_is_due(plan, cycles, seconds, cost, due):
    assert plan.is_due(cycles, seconds, cost) is due
    assert plan.wanted is (plan != CheckpointPlan(every=None))


def test_what_must_be_the_same_is_described(begun):
    parts = {"observer": OneNode(), "policy": Hop(), "filter": EnKF(), "start": [[0.0, 0.0]], "members": 3}
    study = Study(model=Growth(), truth=Growth(rate=2.0), **parts)
    other = Study(model=Growth(), truth=Growth(rate=3.0), **parts, checkpoint=CheckpointPlan(cycles=1), pictures=True)
    assert difference(described(study), described(other)) == "truth.rate = 2.0, now it is 3.0"
    assert digest(described(study)) != digest(described(other))
    free = {"executor": Processes(workers=2), "advice": ["-"], "checkpoint": CheckpointPlan(cycles=1)}
    equal = Study(model=Growth(), truth=Growth(rate=2.0), **parts, **free)
    assert described(study) == described(equal) and digest(described(study)) == digest(described(equal))
    assert changed_versions({"numpy": "1", "old": "2"}, {"numpy": "2", "new": "3"}) == [
        "numpy was 1 and is 2",
        "old was 2 and is not there",
        "new was not there and is 3",
    ]
    state = begun[1]
    bumped = state.belief.ensemble.members.copy()
    bumped[0, 0] = np.nextafter(bumped[0, 0], 2.0)
    changed = replace(state, belief=state.belief.with_members(bumped))
    pairs = zip(start_digest(state).split(), start_digest(changed).split(), strict=True)
    assert [one == other for one, other in pairs] == [False, True, True]


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ({"filter": {"a": 1}}, {"filter": {"a": 1, "b": None}}, "no filter.b, now it is null"),
        ({"filter": {"a": 1, "b": None}}, {"filter": {"a": 1}}, "filter.b = null, which is no option now"),
        ({"filter": {"a": [1]}}, {"filter": {"a": None}}, "filter.a = [1], now it is null"),
        ({"filter": None}, {"filter": {"a": 1}}, 'filter = null, now it is {"a": 1}'),
    ],
)
def test_a_difference_tells_an_option_without_a_value_from_none_at_all(before, now, words):
    assert difference(before, now) == words
