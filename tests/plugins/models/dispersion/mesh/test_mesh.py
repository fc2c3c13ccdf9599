"""Meshes: determinism, the cache, tags on every boundary facet, numbering and orientation, quality, refusals."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import gmsh
import numpy as np
import pytest
import shapely
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry, exterior_facet_indices
from waiting import PATIENCE

from dafw.core.options import build
from dafw.plugins.models.dispersion.mesh import generate as generate_module
from dafw.plugins.models.dispersion.mesh.generate import generate
from dafw.plugins.models.dispersion.mesh.load import load, topology
from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.mesh.sizing import demands, expected_nodes, size_function
from dafw.plugins.models.dispersion.mesh.tagged import OUTER, WALL, MeshError
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import Site, load_site

WEST_OAKLAND = Path(__file__).resolve().parents[6] / "shared" / "data" / "west_oakland_buildings.geojson"
SMALL = MeshOptions(wall_size=10.0, far_size=20.0, transition=50.0)


def site_with(*buildings, size=(200.0, 150.0)):
    """A site with its lower left corner at (-size/2) and the given polygons as buildings."""
    x, y = size[0] / 2, size[1] / 2
    names = tuple(f"B{k}" for k in range(len(buildings)))
    return Site((-x, -y, x, y), buildings, names, names, (8.0, 50.0), (71695.8, 111229.1), {})


BLOCKS = site_with(shapely.box(-60, -30, -20, 30), shapely.box(-10, -30, 40, 20))


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """The plant's site and mesh at the default size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DAFW_CACHE", str(tmp_path_factory.mktemp("plant")))
        site = load_site(SiteOptions())
        return SimpleNamespace(site=site, tagged=load(generate(site, MeshOptions())))


def smallest_angles(nodes, triangles):
    """Return the smallest angle of each triangle, in degrees."""
    corners = nodes[triangles]
    sides = [corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3] for k in range(3)]
    cosines = [
        -np.sum(sides[k - 1] * sides[k - 2], axis=1)
        / np.prod(np.linalg.norm([sides[k - 1], sides[k - 2]], axis=2), axis=0)
        for k in range(3)
    ]
    return np.degrees(np.arccos(np.max(cosines, axis=0)))


def twice_areas(nodes, triangles):
    a, b, c = nodes[triangles].transpose(1, 2, 0)
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


# --- properties of a mesh ---------------------------------------------------------------------------------------------


def test_tags_cover_the_whole_boundary_and_nothing_else(plant):
    mesh, tags = plant.tagged.mesh, plant.tagged.facet_tags
    exterior = exterior_facet_indices(mesh.topology)
    assert sorted(tags.indices) == sorted(exterior) and set(tags.values) == {OUTER, WALL}
    midpoints = {tag: _midpoints(mesh, tags.find(tag)) for tag in (OUTER, WALL)}
    rectangle = shapely.box(*plant.site.bounds).exterior
    walls = shapely.MultiLineString([building.exterior for building in plant.site.buildings])
    for tag, line in ((OUTER, rectangle), (WALL, walls)):
        assert shapely.distance(shapely.points(midpoints[tag]), line).max() < 1e-6
        assert _length(mesh, tags.find(tag)) == pytest.approx(line.length, rel=1e-9)


def _ends(mesh, facets):
    for dimensions in ((1, 0), (0, 2)):
        mesh.topology.create_connectivity(*dimensions)
    vertices = np.concatenate([mesh.topology.connectivity(1, 0).links(facet) for facet in facets])
    geometry = entities_to_geometry(mesh, 0, vertices.astype(np.int32)).ravel()
    return mesh.geometry.x[geometry, :2].reshape(-1, 2, 2)


def _midpoints(mesh, facets):
    return _ends(mesh, facets).mean(axis=1)


def _length(mesh, facets):
    return np.linalg.norm(np.diff(_ends(mesh, facets), axis=1), axis=2).sum()


def test_topology_is_numbered_like_the_degrees_of_freedom_and_counter_clockwise(plant):
    nodes, triangles = topology(plant.tagged)
    space = fem.functionspace(plant.tagged.mesh, ("Lagrange", 1))
    np.testing.assert_array_equal(nodes, space.tabulate_dof_coordinates()[:, :2])
    assert nodes.shape == (space.dofmap.index_map.size_global, 2)
    assert triangles.dtype == np.int32 and set(triangles.ravel()) == set(range(len(nodes)))
    np.testing.assert_array_equal(np.sort(triangles, axis=1), np.sort(space.dofmap.list, axis=1))
    areas = twice_areas(nodes, triangles)
    assert areas.min() > 0
    assert areas.sum() / 2 == pytest.approx(plant.site.domain.area, rel=1e-9)


def test_the_default_mesh_of_the_plant_has_the_size_and_the_quality_of_the_study(plant):
    nodes, triangles = topology(plant.tagged)
    assert 2300 <= len(nodes) <= 2800
    angles = smallest_angles(nodes, triangles)
    assert angles.min() > 20 and np.quantile(angles, 0.01) > 30


def test_no_passage_of_the_plant_is_one_triangle_wide(plant):
    """A side that joins two buildings is a passage without a node in it: there must be hardly any such side."""
    nodes, triangles = topology(plant.tagged)
    distance = shapely.distance(shapely.points(nodes)[:, None], np.asarray(plant.site.buildings, dtype=object)[None])
    owner = np.where(distance.min(axis=1) < 1e-6, distance.argmin(axis=1), -1)
    sides = np.unique(
        np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])), axis=0
    )
    first, second = owner[sides].T
    assert np.mean((first >= 0) & (second >= 0) & (first != second)) < 0.01


def test_sizes_are_those_asked_for_at_walls_far_away_and_in_passages():
    size = size_function(BLOCKS, SMALL)
    assert size(2, 1, -60.0, 10.0, 0.0, 1e22) == pytest.approx(10.0, rel=0.1)
    assert size(2, 1, -15.0, 0.0, 0.0, 1e22) == pytest.approx(5.0, rel=0.4)
    assert size(2, 1, 99.0, 74.0, 0.0, 1e22) == 20.0
    points, sizes = demands(BLOCKS, SMALL)
    passage = (points[:, 0] > -20.001) & (points[:, 0] < -9.999) & (abs(points[:, 1]) < 20)
    np.testing.assert_allclose(sizes[passage], 5.0, rtol=1e-4)
    assert sizes[~passage].max() == 10.0 and sizes.min() > 4.9


def test_the_expected_number_of_nodes_is_about_right():
    fine = replace(SMALL, wall_size=2.0, far_size=5.0)
    for site in (BLOCKS, site_with()):
        nodes, _ = topology(load(generate(site, fine)))
        assert expected_nodes(site, fine) == pytest.approx(len(nodes), rel=0.3)


def test_a_site_without_buildings_has_an_outer_boundary_only():
    tagged = load(generate(site_with(), SMALL))
    assert set(tagged.facet_tags.values) == {OUTER}
    nodes, triangles = topology(tagged)
    assert twice_areas(nodes, triangles).sum() / 2 == pytest.approx(200 * 150)


@pytest.mark.skipif(not WEST_OAKLAND.exists(), reason=f"the foreign footprints are not there: {WEST_OAKLAND}")
def test_west_oakland():
    site = load_site(SiteOptions(file=str(WEST_OAKLAND)))
    nodes, triangles = topology(load(generate(site, MeshOptions())))
    assert 1000 < len(nodes) < 5000
    assert smallest_angles(nodes, triangles).min() > 15
    assert twice_areas(nodes, triangles).sum() / 2 == pytest.approx(site.domain.area, rel=1e-9)


# --- cache ----------------------------------------------------------------------------------------------------------


def test_equal_input_gives_equal_bytes_here_and_in_another_process(cache, monkeypatch, tmp_path):
    first = generate(BLOCKS, SMALL)
    kept, stamp = first.read_bytes(), first.stat().st_mtime_ns
    assert first.parent == cache and generate(BLOCKS, SMALL) == first
    assert first.stat().st_mtime_ns == stamp
    generate(site_with(), SMALL)
    first.unlink()
    assert generate(BLOCKS, SMALL).read_bytes() == kept
    script = (
        f"import sys; sys.path[:] = {sys.path!r}; from {Path(__file__).stem} import *; print(generate(BLOCKS, SMALL))"
    )
    makers = [
        subprocess.Popen(
            [sys.executable, "-c", script],
            env={**os.environ, "DAFW_CACHE": str(tmp_path / "other")},
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)  # at the same time, into the same folder
    ]
    for maker in makers:
        made = Path(maker.communicate(timeout=PATIENCE)[0].strip())
        assert made.name == first.name and made.read_bytes() == kept
    assert [path.name for path in (tmp_path / "other").iterdir()] == [first.name]


def test_what_defines_a_mesh_names_its_file():
    other = site_with(shapely.box(-60, -30, -20, 30), shapely.box(-10, -30, 40, 20.5))
    renamed = replace(BLOCKS, names=("left", "right"))
    files = [generate(site, SMALL).name for site in (BLOCKS, other, renamed)]
    files.append(generate(BLOCKS, replace(SMALL, wall_size=9.0)).name)
    assert files[0] == files[2] and len(set(files)) == 3


@pytest.mark.parametrize(
    "damage", [lambda whole: whole[: len(whole) // 2], lambda whole: b"", lambda whole: whole[:-3] + b"xyz"]
)
def test_a_damaged_file_is_refused_by_load_and_made_anew_by_generate(damage, caplog):
    path = generate(BLOCKS, SMALL)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    with pytest.raises(MeshError, match="damaged"):
        load(path)
    assert generate(BLOCKS, SMALL).read_bytes() == whole
    assert "is damaged: it is made anew" in caplog.text


def test_a_file_that_cannot_be_read_says_why():
    path = generate(BLOCKS, SMALL)
    path.unlink()
    path.mkdir()
    with pytest.raises(MeshError, match=r"^mesh: cannot read .*\.msh \(Is a directory\); DAFW_CACHE moves the cache$"):
        generate(BLOCKS, SMALL)


def test_gmsh_leaves_no_trace(capfd, monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    load(generate(BLOCKS, SMALL))
    assert not gmsh.isInitialized() and signal.getsignal(signal.SIGINT) is before
    gmsh.initialize(interruptible=False)
    try:
        gmsh.model.add("somebody else's")
        generate(BLOCKS, replace(SMALL, wall_size=8.0))
        assert gmsh.isInitialized() and gmsh.model.getCurrent() == "somebody else's"
    finally:
        gmsh.finalize()
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wall_size": 0.0}, "wall_size above 0, got 0.0"),
        ({"wall_size": -3.0}, "wall_size above 0, got -3.0"),
        ({"far_size": float("nan")}, "far_size above 0, got nan"),
        ({"transition": float("inf")}, "transition above 0, got inf"),
        ({"across": 0}, "across above 0, got 0"),
        ({"wall_size": 30.0, "far_size": 20.0}, "at least the wall_size, 30 m, got 20 m"),
        ({"wall_size": 0.001, "far_size": 0.01}, "nodes are asked for, expected at most 1000000"),
        ({"max_nodes": 50}, "expected at most 50"),
    ],
)
def test_options_that_make_no_sense(options, message, cache):
    with pytest.raises(MeshError, match=message) as caught:
        generate(BLOCKS, replace(MeshOptions(), **options))
    assert caught.value.exit_status == 2 and not cache.exists()


def test_buildings_that_overlap_or_stick_out_are_refused(cache):
    block = shapely.box(-50, -20, 20, 20)
    for other in (shapely.box(0, -30, 60, 30), shapely.box(60, 0, 130, 30)):
        with pytest.raises(MeshError, match="disjoint and inside the rectangle"):
            generate(site_with(block, other), SMALL)
    assert not cache.exists()


def test_a_failure_of_gmsh_is_a_mesh_error(cache, monkeypatch):
    monkeypatch.setattr(generate_module, "_draw", lambda site: gmsh.model.geo.addPlaneSurface([99]))
    with pytest.raises(MeshError, match="gmsh failed"):
        generate(BLOCKS, SMALL)
    assert list(cache.iterdir()) == []


def test_a_cache_that_cannot_be_written_and_a_file_that_is_not_there(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path / "file"))
    with pytest.raises(MeshError, match="DAFW_CACHE"):
        generate(BLOCKS, SMALL)
    with pytest.raises(MeshError, match="not found"):
        load(tmp_path / "nowhere.msh")


def test_the_options_build_from_a_configuration():
    assert build(MeshOptions, {"wall_size": 6, "across": 1}, "model 'ad', mesh") == MeshOptions(wall_size=6.0, across=1)
