"""``run.nc``: its contents; it can be opened at any moment; nothing is overwritten."""

import gc
import weakref
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray
from toys import AIRSPACE, NODES, Growth, toy_parts

from dafw import (
    NONNEGATIVE,
    POSITIVE,
    ContractError,
    Domain,
    RunError,
    Selection,
    StateSpace,
    Variable,
    Vehicle,
    open_run,
)
from dafw.core import record as recording
from dafw.core.checkpoints.journal import Journal, entries
from dafw.core.cycle import advance, start
from dafw.core.ensemble import Diagnostic, Route
from dafw.core.ranks import ranks
from dafw.core.record import Record
from dafw.core.run_layout import READINGS_CACHE
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.none import NoFilter


class Still(Growth):
    """A model with any state, which a step does not change."""

    def initial(self, n_members, rng):
        return np.ones((n_members, self.space.size))

    def step(self, members, t, rng):
        return members


VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0)
NO_VEHICLE = Vehicle(np.zeros((0, 2)), speed=1.0, dt=2.0)


def record_run(path, parts=None, cycles=3, members=("rate",), n_members=5, vehicle=VEHICLE, **more):
    parts = parts or toy_parts()
    state = start(parts, n_members, vehicle)
    record = Record(
        path,
        parts,
        state,
        with_members=members,
        section=np.array([[0.0, 0.0], [9.0, 9.0]]),
        attributes={"seed": 0},
        **more,
    )
    done = []
    for _ in range(cycles):
        done.append(advance(parts, state))
        record.append(done[-1])
        state = done[-1].state
    return record, done


def test_it_holds_the_contract_names(tmp_path):
    record, _ = record_run(tmp_path / "run.nc")
    record.close()
    with xarray.open_dataset(tmp_path / "run.nc") as run:
        assert dict(run.sizes) | {"time": 4, "node": 4, "member": 5, "vehicle": 1} == dict(run.sizes)
        for variable, dims in (("gas", ("time", "node")), ("rate", ("time",))):
            for stage in ("truth", "free", "forecast_mean", "forecast_spread", "mean", "spread"):
                assert run[f"{variable}_{stage}"].dims == dims
        assert run["rate_members"].dims == ("time", "member") and "gas_members" not in run
        assert run["err"].dims == run["err_free"].dims == ("time",)
        assert run["vehicle_x"].dims == run["vehicle_y"].dims == ("time", "vehicle")
        assert all("units" in run[name].attrs and "long_name" in run[name].attrs for name in run.data_vars)


def test_rows_are_the_states_after_so_many_cycles(tmp_path):
    record, done = record_run(tmp_path / "run.nc")
    record.close()
    with open_run(tmp_path) as run:
        np.testing.assert_array_equal(run["time"], [0.0, 2.0, 4.0, 6.0])
        for row, cycle in enumerate(done, start=1):
            belief = cycle.state.belief.ensemble
            np.testing.assert_array_equal(run["gas_mean"][row], belief.mean[:4].astype("f4"))
            np.testing.assert_array_equal(run["rate_mean"][row], belief.mean[4])
            np.testing.assert_array_equal(run["rate_members"][row], belief.members[:, 4])
            np.testing.assert_array_equal(run["observation_value"][row], cycle.observation.values)
            truth = cycle.state.truth.ensemble.members[0, :4]
            expected = np.linalg.norm(truth - belief.mean[:4]) / np.linalg.norm(truth) * 100
            assert run["err"][row] == pytest.approx(expected, rel=1e-14)
        assert np.isnan(run["gas_forecast_mean"][0]).all() and run["gas_mean"][0].notnull().all()
        np.testing.assert_array_equal(run["vehicle_x"][:, 0], [0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize("seconds", [0.0, 1e9], ids=["each row is written at once", "all rows wait"])
def test_ranks_are_those_of_each_cycle_whenever_rows_are_written(seconds, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "FLUSH_SECONDS", seconds)
    record, done = record_run(tmp_path / "run.nc", cycles=12)
    record.close()
    with open_run(tmp_path) as run:
        for row, cycle in enumerate(done, start=1):
            one = cycle.observation
            expected = ranks(one.values, one.variance, cycle.predicted, cycle.forecast.weights)
            np.testing.assert_array_equal(run["observation_rank"][row], expected)


def test_fields_share_a_dimension_only_where_they_share_their_places(tmp_path):
    parts = toy_parts()
    elsewhere = Variable("heat", 4, coordinates=parts.model.space["gas"].coordinates + 1.0)
    beside = Variable("mist", 4, coordinates=parts.model.space["gas"].coordinates.copy())
    space = StateSpace([parts.model.space["gas"], elsewhere, beside, Variable("few", 3)])
    parts = toy_parts(**{role: Still(space=space) for role in ("model", "truth", "free")})
    record, _ = record_run(tmp_path / "run.nc", parts, members=())
    record.close()
    with xarray.open_dataset(tmp_path / "run.nc", decode_coords=False) as run:
        assert run["gas_mean"].dims == run["mist_mean"].dims == ("time", "node")
        assert run["heat_mean"].dims == ("time", "node_heat") and run["few_mean"].dims == ("time", "node_few")
        assert run["heat_mean"].attrs["coordinates"] == "node_heat_x node_heat_y"
        assert "mesh" not in run["gas_mean"].attrs and "coordinates" not in run["few_mean"].attrs


def test_error_and_spread_of_a_positive_variable_have_no_units(tmp_path):
    for kind, units in ((POSITIVE, "1"), (NONNEGATIVE, "g s-1")):
        space = StateSpace([Variable("gas", 4, kind, "g s-1", NODES)])
        parts = toy_parts(**{role: Still(space=space) for role in ("model", "truth", "free")})
        record, _ = record_run(tmp_path / f"{kind.value}.nc", parts, members=())
        record.close()
        with open_run(tmp_path / f"{kind.value}.nc") as run:
            names = ("rmse", "spread", "gas_spread", "gas_forecast_spread")
            assert [run[name].attrs["units"] for name in (*names, "gas_mean")] == [*[units] * 4, "g s-1"]


def test_it_opens_while_it_is_written(tmp_path):
    record, _ = record_run(tmp_path / "run.nc")
    record.flush()
    with open_run(tmp_path / "run.nc") as run:
        assert run.sizes["time"] == 4
    record.close()


def test_what_was_written_does_not_stay_in_memory(tmp_path):
    record, _ = record_run(tmp_path / "run.nc")
    file = record._file._file
    over_time = [one for one in file.variables.values() if "time" in one.dimensions]
    assert len(over_time) > 20
    # By default HDF5 holds up to 64 MB of each variable until the file is closed, that is, all of most files.
    assert all(one.get_var_chunk_cache()[0] <= READINGS_CACHE for one in over_time)
    assert sum(one.get_var_chunk_cache()[0] for one in over_time) < 8_000_000
    record.close()


@pytest.mark.parametrize("filter", [{}, {"filter": EnKS(window=2)}])
def test_rows_that_wait_do_not_keep_whole_ensembles_in_memory(filter, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "FLUSH_SECONDS", 1e9)
    parts = toy_parts(**filter)
    record, done = record_run(tmp_path / "run.nc", parts, cycles=6)
    beliefs = [one for cycle in done for one in (cycle.state.belief, *cycle.analysis.revised.values())]
    members = {id(one): weakref.ref(one) for one in (belief.ensemble.members for belief in beliefs)}
    assert len(record._rows) == 6 and len(members) >= 6
    state = done[-1].state
    del done, beliefs
    gc.collect()
    held = [state.belief, *(one.belief for one in state.past)]
    needed = {id(belief.ensemble.members) for belief in held}
    assert {place for place, one in members.items() if one() is not None} <= needed
    record.close()


def test_revised_beliefs_that_wait_count_as_held(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "FLUSH_SECONDS", 1e9)
    waiting = {}
    for name, filter_ in {"filter": toy_parts().filter, "smoother": EnKS(window=2)}.items():
        record, _ = record_run(tmp_path / f"{name}.nc", toy_parts(filter=filter_), cycles=1)
        monkeypatch.setattr(recording, "HELD_BYTES", 6 * record._row_bytes)
        record.close()
        record, _ = record_run(tmp_path / f"{name}_again.nc", toy_parts(filter=filter_), cycles=6)
        waiting[name] = len(record._rows)
        record.close()
    assert waiting["filter"] == 6 and waiting["smoother"] < 6


def test_a_run_is_never_overwritten(tmp_path):
    record, _ = record_run(tmp_path / "run.nc")
    record.close()
    content = (tmp_path / "run.nc").read_bytes()
    with pytest.raises(RunError, match="holds a run already"):
        record_run(tmp_path / "run.nc")
    assert (tmp_path / "run.nc").read_bytes() == content


class Talkative(type(toy_parts().policy)):
    """Reports a score for each of three sectors."""

    def decide(self, belief, vehicle, rng):
        route = super().decide(belief, vehicle, rng)
        score = Diagnostic(np.arange(3.0) + belief.time, ("sector",), "1", "score")
        return Route(route.paths, diagnostics={"score": score})


def test_diagnostics_of_plugins_are_kept_under_their_kind(tmp_path):
    record, _ = record_run(tmp_path / "run.nc", toy_parts(policy=Talkative()))
    record.close()
    with open_run(tmp_path) as run:
        assert run["policy_score"].dims == ("time", "sector")
        np.testing.assert_array_equal(run["policy_score"][1:, 0], [0.0, 2.0, 4.0])
        assert run["policy_score"][0].isnull().all()


class PerVehicle(type(toy_parts().policy)):
    """Reports a number for each vehicle."""

    def decide(self, belief, vehicle, rng):
        route = super().decide(belief, vehicle, rng)
        return Route(route.paths, diagnostics={"battery": Diagnostic(np.ones(len(route.paths)), ("vehicle",))})


class Listing(NoFilter):
    """Reports a list of numbers, ``listed`` long."""

    listed = 0

    def analyse(self, forecast, predicted, observation, rng):
        numbers = np.ones(self.listed, dtype=np.int64)
        found = {"kept": Diagnostic(numbers, ("kept",)), "members": Diagnostic(np.ones((5, 0)), ("member", "kept"))}
        return replace(super().analyse(forecast, predicted, observation, rng), diagnostics=found)


class FirstNode(type(toy_parts().observer)):
    """Reads a node without a vehicle."""

    def operator(self, space, route, t):
        return Selection(indices=np.array([0]), covariance=np.array([0.01]))


def test_a_diagnostic_may_have_an_axis_of_length_zero(tmp_path):
    parts = toy_parts(policy=PerVehicle(), observer=FirstNode(), filter=Listing())
    with Journal(tmp_path / "rows.journal") as journal:
        record, _ = record_run(tmp_path / "run.nc", parts, vehicle=NO_VEHICLE, journal=journal)
        later, length = record.settle(), journal.length()
        record.close()
    before = (entries(tmp_path / "rows.journal", length), later)
    for _ in range(2):
        with open_run(tmp_path) as run:
            assert run["policy_battery"].shape == run["vehicle_x"].shape == run["filter_kept"].shape == (4, 0)
            assert run["filter_members"].shape == (4, 5, 0) and run["gas_mean"].notnull().all()
        record_run(tmp_path / "run.nc", parts, cycles=0, vehicle=NO_VEHICLE, before=before)[0].close()


def test_a_diagnostic_that_outgrows_an_axis_of_length_zero_is_refused(tmp_path):
    parts = toy_parts(observer=FirstNode(), filter=Listing())
    record, done = record_run(tmp_path / "run.nc", parts)
    parts.filter.listed = 1
    with pytest.raises(ContractError, match=r"'filter_kept' must have the shape \(0,\), got \(1,\)"):
        record.append(advance(parts, done[-1].state))
    record.close()


def counting(*values):
    """Return a policy that reports one of the values in each cycle."""

    class Counting(type(toy_parts().policy)):
        def decide(self, belief, vehicle, rng):
            route = super().decide(belief, vehicle, rng)
            return Route(route.paths, diagnostics={"count": Diagnostic(values[int(belief.time / 2.0)])})

    return toy_parts(policy=Counting())


@pytest.mark.parametrize(
    "values",
    [(2**31, 2**40, -(2**62)), (-1, 0, 1), (np.uint64(2**63 - 1), np.uint8(3), 0), (True, False, True), (0.5, 2, -1)],
)
def test_whole_numbers_are_kept_to_the_last(tmp_path, values):
    record, _ = record_run(tmp_path / "run.nc", counting(*values))
    record.close()
    with netCDF4.Dataset(tmp_path / "run.nc") as file:
        assert file["policy_count"][:].tolist() == [None, *values]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0, np.uint64(2**63), 0), "holds 9223372036854775808, a file holds whole numbers up to"),
        ((0, 2.5, 0), "'policy_count' was of the type int64 at first, got float64"),
        ((True, 300, 0), "'policy_count' was of the type int8 at first, got int64"),
    ],
)
def test_a_number_that_would_become_another_is_refused(tmp_path, values, message):
    with pytest.raises(ContractError, match=message):
        record_run(tmp_path / "run.nc", counting(*values))


def test_readings_of_changing_number_are_padded(tmp_path):
    parts = toy_parts()
    two = type(parts.observer)

    class Changing(two):
        def operator(self, space, route, t):
            one = super().operator(space, route, t)
            if t == 2.0:
                return replace(one, indices=np.array([2, 4]), covariance=np.ones(2))
            return one

    record, _ = record_run(tmp_path / "run.nc", toy_parts(observer=Changing()))
    record.close()
    with open_run(tmp_path) as run:
        assert run["observation_value"].count("observation").values.tolist() == [0, 1, 2, 1]
        # the second reading is of the rate, which is not a node
        assert np.nan_to_num(run["observation_node"].values, nan=-1).tolist()[2] == [2, -1]


def test_a_variable_that_only_some_readings_have_is_read_as_it_was_written(tmp_path):
    record, _ = record_run(tmp_path / "run.nc", cycles=0)
    read = [np.arange(3), np.arange(5), np.arange(2)]
    rows = [{"time": 2.0 * (1 + n), "observation_value": 10.0 * (1 + n) + one} for n, one in enumerate(read)]
    rows[0]["observation_node"] = np.array([6, 7, 8])
    for row in rows:  # one by one: the second makes room for five readings
        record._file.write([row])
    record._file.write([{"time": 8.0, "observation_node": np.array([9])}])
    record.close()
    with netCDF4.Dataset(tmp_path / "run.nc") as run:
        run.set_auto_mask(False)
        nodes, values = run["observation_node"][:], run["observation_value"][:]
    assert nodes.tolist() == [5 * [-1], [6, 7, 8, -1, -1], 5 * [-1], 5 * [-1], [9, -1, -1, -1, -1]]
    assert values[1:4, 0].tolist() == [10.0, 20.0, 30.0] and np.isnan(values[4]).all()


def test_the_mesh_is_ugrid_and_the_buildings_are_cf(tmp_path):
    import xugrid

    parts = toy_parts()
    ring = np.array([[2.0, 2.0], [4.0, 2.0], [3.0, 4.0]])
    parts.model.domain = Domain(
        AIRSPACE.bounds, (ring,), ("tank",), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), {"release": (1.0, 1.0)}
    )
    record, _ = record_run(tmp_path / "run.nc", parts)
    record.close()
    with xarray.open_dataset(tmp_path / "run.nc") as run:
        assert run["obstacle_vertex_count"].item() == 3 and run["obstacle_name"].item() == "tank"
        assert run["landmark_name"].item() == "release"
        grid = xugrid.UgridDataset(run).ugrid.grid
        assert (grid.n_node, grid.n_face) == (4, 2)


@pytest.mark.parametrize("content", [None, b"", b"not a netCDF file at all"])
def test_what_is_no_run_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "run.nc").write_bytes(content)
    with pytest.raises(RunError):
        open_run(tmp_path)


def still_open(folder):
    """Return the files in a folder that this process has open."""
    links = [link for link in Path("/proc/self/fd").iterdir() if link.exists()]
    return [place for link in links if (place := link.readlink()).is_relative_to(folder)]


def test_a_damaged_run_is_refused_and_not_left_open(tmp_path):
    record_run(tmp_path / "run.nc", cycles=30)[0].close()
    whole, opened = (tmp_path / "run.nc").read_bytes(), []
    for place in range(0, 12_000, 256):
        damaged = tmp_path / f"damaged{place}.nc"
        damaged.write_bytes(whole[:place] + b"Z" * 64 + whole[place + 64 :])
        try:
            open_run(damaged).close()
        except RunError as error:
            assert str(damaged) in str(error)
            if not isinstance(error.__cause__, OSError):  # what HDF5 cannot open at all, it may itself keep open
                opened.append(damaged)
    assert len(opened) > 5 and not set(opened) & set(still_open(tmp_path))


@pytest.mark.parametrize("filter", [{}, {"filter": EnKS()}, {"filter": EnKS(window=1)}])
def test_fields_of_the_ends_alone_leave_everything_else_as_it_is(filter, tmp_path):
    for fields in ("all", "ends"):
        (tmp_path / fields).mkdir()
        kept = {"members": ("gas", "rate"), "fields": fields}
        record, _ = record_run(tmp_path / fields / "run.nc", toy_parts(**filter), cycles=5, **kept)
        record.close()
    with open_run(tmp_path / "all") as whole, open_run(tmp_path / "ends") as thin:
        assert set(whole.variables) == set(thin.variables) and whole.sizes == thin.sizes
        for name in set(whole.variables) - {"phase_seconds"}:
            is_field = {"time", "node"} <= set(whole[name].dims)
            rows = {"time": [0, 5]} if is_field else {}
            np.testing.assert_array_equal(thin[name].isel(rows), whole[name].isel(rows), err_msg=name)
            assert not is_field or thin[name][1:5].isnull().all(), name


@pytest.mark.parametrize("filter", [{}, {"filter": EnKS(window=2)}])
def test_a_run_that_goes_on_without_a_further_cycle_has_its_last_fields(filter, tmp_path):
    for name in ("whole", "again"):
        (tmp_path / name).mkdir()
    parts, kept = toy_parts(**filter), {"members": ("gas", "rate"), "fields": "ends"}
    record, done = record_run(tmp_path / "whole" / "run.nc", parts, **kept)
    record.close()
    places = [tmp_path / "again" / name for name in ("run.nc", "rows.journal")]
    with Journal(places[1]) as journal:
        record, _ = record_run(places[0], parts, **kept, journal=journal)
        later, length = record.settle(), journal.length()
        record.close()
    with Journal(places[1], length) as journal:
        before = (entries(places[1], length), later)
        record, _ = record_run(places[0], parts, cycles=0, **kept, journal=journal, before=before)
        assert record.settle().keys() == later.keys()  # it may be interrupted again
        record.close()
    with open_run(tmp_path / "whole") as whole, open_run(tmp_path / "again") as again:
        assert again["gas_forecast_mean"][3].notnull().all()
        for name in set(whole.variables) - {"phase_seconds"}:
            np.testing.assert_array_equal(again[name], whole[name], err_msg=name)
    record, _ = record_run(places[0], parts, cycles=0, **kept, before=(entries(places[1], length), later))
    record.append(advance(parts, done[-1].state))
    record.close()
    with open_run(tmp_path / "again") as run:
        assert run["gas_mean"][3].isnull().all() and run["gas_mean"][4].notnull().all()


def test_truths_that_nothing_is_compared_with_any_more_are_dropped(tmp_path):
    parts, kept = toy_parts(filter=EnKS(window=2)), {"fields": "ends"}
    with Journal(tmp_path / "rows.journal") as journal:
        record, _ = record_run(tmp_path / "run.nc", parts, cycles=6, **kept, journal=journal)
        later, length = record.settle(), journal.length()
    assert list(record._truths) == [5, 6]
    record.close()
    before = (entries(tmp_path / "rows.journal", length), later)
    record, _ = record_run(tmp_path / "run.nc", parts, cycles=0, **kept, before=before)
    assert list(record._truths) == [5, 6]
    record.close()
    record, _ = record_run(tmp_path / "all.nc", toy_parts(filter=EnKS()), cycles=6, **kept)
    record.flush()
    assert len(record._truths) == 7
    record.close()
