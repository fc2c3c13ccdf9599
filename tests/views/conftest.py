"""Synthetic runs, written as ``dafw run`` writes them: a cloud drifting among buildings, and a ring without a map."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from absent import without_free_run, without_truth
from matplotlib.path import Path as Outline
from scipy.spatial import Delaunay

WIDTH, HEIGHT = 800.0, 600.0
RELEASE = np.array([560.0, 340.0])


def grid_of_buildings(rows: int, columns: int) -> list[np.ndarray]:
    """Rotated rectangles, (4, 2) each, on a regular grid with free space between them."""
    rng = np.random.default_rng(3)
    outlines = []
    for row in range(rows):
        for column in range(columns):
            middle = np.array([WIDTH * (column + 1) / (columns + 1), HEIGHT * (row + 1) / (rows + 1)])
            if np.linalg.norm(middle - RELEASE) < 40.0:
                continue
            width, depth, turn = rng.uniform(35, 65), rng.uniform(25, 45), rng.uniform(-0.4, 0.4)
            corners = 0.5 * np.array([[-width, -depth], [width, -depth], [width, depth], [-width, depth]])
            cosine, sine = np.cos(turn), np.sin(turn)
            outlines.append(middle + corners @ np.array([[cosine, sine], [-sine, cosine]]))
    return outlines


def mesh_with_holes(outlines: list[np.ndarray], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 2) and triangles (m, 3) of a Delaunay mesh whose holes are the buildings."""
    x, y = np.meshgrid(
        np.linspace(0, WIDTH, round(WIDTH / spacing) + 1), np.linspace(0, HEIGHT, round(HEIGHT / spacing) + 1)
    )
    inner = np.column_stack([x.ravel(), y.ravel()])
    walls = []
    for outline in outlines:
        closed = np.vstack([outline, outline[:1]])
        walls += [
            np.linspace(a, b, 1 + round(np.linalg.norm(b - a) / (0.6 * spacing)))[:-1] for a, b in pairwise(closed)
        ]
    wall = np.vstack(walls) if walls else np.empty((0, 2))
    keep = np.ones(len(inner), bool)
    if len(wall):
        keep = np.min(np.linalg.norm(inner[:, None] - wall[None], axis=2), axis=1) > 0.45 * spacing
    for outline in outlines:
        keep &= ~Outline(outline).contains_points(inner)
    nodes = np.vstack([inner[keep], wall])
    triangles = Delaunay(nodes).simplices
    centres = nodes[triangles].mean(axis=1)
    solid = np.zeros(len(triangles), bool)
    for outline in outlines:
        solid |= Outline(outline).contains_points(centres)
    a, b, c = (nodes[triangles[:, corner]] for corner in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return nodes, triangles[~solid & (np.abs(area) > 1e-6)]


def cloud(
    nodes: np.ndarray, time: np.ndarray, speed: np.ndarray, direction: np.ndarray, diffusion: float
) -> np.ndarray:
    """A Gaussian that drifts and spreads, (time, node); its maximum is 1 at the start."""
    step = np.diff(time, prepend=time[0])[:, None] * speed[:, None]
    middle = RELEASE + np.cumsum(step * np.column_stack([np.cos(direction), np.sin(direction)]), axis=0)
    variance = 25.0**2 + 2.0 * diffusion * time
    squared = np.sum((nodes[None] - middle[:, None]) ** 2, axis=2)
    return (25.0**2 / variance)[:, None] * np.exp(-0.5 * squared / variance[:, None])


def chase(middle: np.ndarray, start: np.ndarray, reach: float) -> np.ndarray:
    """A path (time, 2) of a vehicle that flies to the cloud and then circles in it."""
    path = [start]
    for index, target in enumerate(middle[1:]):
        aim = target + 45.0 * np.array([np.cos(0.45 * index), np.sin(0.45 * index)]) - path[-1]
        path.append(path[-1] + aim * min(1.0, reach / np.linalg.norm(aim)))
    return np.array(path)


def plant(
    steps: int = 20,
    dt: float = 5.0,
    spacing: float = 45.0,
    rows: int = 3,
    columns: int = 4,
    learning: float = 25.0,
    seed: int = 1,
) -> xr.Dataset:
    """A run of the flagship as in its file. The error of the belief's wind decays in ``learning`` seconds."""
    rng = np.random.default_rng(seed)
    outlines = grid_of_buildings(rows, columns)
    nodes, faces = mesh_with_holes(outlines, spacing)
    time = dt * np.arange(steps + 1)
    rate = 1.0 / (1.0 + np.exp((time - learning) / 5.0))
    constant = np.ones_like(time)
    wind = {
        "truth": (5.0 * constant, np.pi * constant),
        "free": (2.5 * constant, 1.5 * np.pi * constant),
        "mean": (5.0 - 2.5 * rate + 0.1 * rng.standard_normal(time.size), np.pi * (1 + 0.5 * rate)),
    }
    true = cloud(nodes, time, *wind["truth"], 0.8)
    free = cloud(nodes, time, *wind["free"], 4.0)
    drifted = cloud(nodes, time, *wind["mean"], 4.0)
    share = (0.3 + 0.7 * rate)[:, None]
    mean = share * drifted + (1 - share) * true
    members = {
        "speed": wind["mean"][0][:, None] + (0.2 + 1.5 * rate)[:, None] * rng.standard_normal((1, 10)),
        "direction": (wind["mean"][1][:, None] + (0.05 + rate)[:, None] * rng.standard_normal((1, 10))) % (2 * np.pi),
    }

    def err(values: np.ndarray) -> np.ndarray:
        return 100.0 * np.linalg.norm(values - true, axis=1) / np.linalg.norm(true, axis=1)

    track = RELEASE + np.outer(5.0 * time, [np.cos(np.pi), np.sin(np.pi)])
    path = chase(track, np.array([720.0, 90.0]), 10.0 * dt)
    nearest = np.argmin(np.linalg.norm(nodes[None] - path[:, None], axis=2), axis=1)
    seen = np.column_stack([nearest, np.roll(nearest, 1)])
    seen[0] = -1
    seen[1::3, 1] = -1
    none = seen < 0

    def reading(values: np.ndarray) -> np.ndarray:
        return np.where(none, np.nan, np.take_along_axis(values, np.where(none, 0, seen), axis=1))

    at = {axis: np.where(none, np.nan, nodes[seen, number]) for number, axis in enumerate("xy")}
    innovation = np.where(np.arange(time.size)[:, None] == 0, np.nan, rng.standard_normal((time.size, 2)))
    vertex = np.vstack(outlines) if outlines else np.empty((0, 2))
    concentration, metres = {"units": "kg m-3"}, {"units": "m"}
    per_node = {"truth": true, "free": free, "forecast_mean": mean, "mean": mean}
    variables = {f"concentration_{k}": (("time", "node"), v, concentration) for k, v in per_node.items()}
    variables |= {
        f"concentration_{k}": (("time", "node"), 0.2 * mean, concentration) for k in ("spread", "forecast_spread")
    }
    for number, (name, units) in enumerate({"speed": "m s-1", "direction": "rad"}.items()):
        kept = {
            suffix: values[number] % (2 * np.pi) if name == "direction" else values[number]
            for suffix, values in wind.items()
        }
        kept |= {"forecast_mean": kept["mean"], "spread": 0.2 + rate, "forecast_spread": 0.2 + rate}
        variables |= {f"wind_{name}_{suffix}": ("time", values, {"units": units}) for suffix, values in kept.items()}
        variables[f"wind_{name}_members"] = (("time", "member"), members[name], {"units": units})
    variables |= {
        "mesh2d": ((), 0, {"cf_role": "mesh_topology", "topology_dimension": 2}),
        "mesh2d_face_nodes": (("face", "three"), faces.astype("int32"), {"start_index": 0}),
        "err": ("time", err(mean), {"units": "percent"}),
        "err_free": ("time", err(free), {"units": "percent"}),
        "err_forecast": ("time", err(mean), {"units": "percent"}),
        "vehicle_x": (("time", "vehicle"), path[:, :1], metres),
        "vehicle_y": (("time", "vehicle"), path[:, 1:], metres),
        "observation_x": (("time", "observation"), at["x"], metres),
        "observation_y": (("time", "observation"), at["y"], metres),
        "observation_value": (("time", "observation"), reading(true), concentration),
        "observation_forecast_mean": (("time", "observation"), reading(mean), concentration),
        "observation_node": (("time", "observation"), seen.astype("int32")),
        "innovation_mean": ("time", innovation.mean(axis=1)),
        "innovation_rms": ("time", np.sqrt(np.mean(innovation**2, axis=1))),
        "phase_seconds": (("time", "phase"), np.full((time.size, 2), 0.1), {"units": "s"}),
    }
    sectors = rng.uniform(0.0, 1.0, (time.size, 1, 8))
    sectors[0] = np.nan
    variables |= {
        "observation_variance": (("time", "observation"), np.where(none, np.nan, 1e-4)),
        "observation_forecast_spread": (("time", "observation"), reading(0.2 * mean)),
        "observation_rank": (("time", "observation"), np.where(none, np.nan, rng.uniform(size=seen.shape))),
        "policy_sector_score": (("time", "vehicle", "sector"), sectors),
    }
    section = np.array([[620.0, 360.0], [420.0, 335.0], [250.0, 355.0], [90.0, 300.0]])
    coordinates = {
        "time": ("time", time, {"units": "s"}),
        "node_x": ("node", nodes[:, 0], metres),
        "node_y": ("node", nodes[:, 1], metres),
        "obstacle_vertex_count": ("obstacle", np.array([len(o) for o in outlines], "int32")),
        "obstacle_x": ("obstacle_vertex", vertex[:, 0], metres),
        "obstacle_y": ("obstacle_vertex", vertex[:, 1], metres),
        "obstacle_name": ("obstacle", np.array([f"hall {i}" for i in range(len(outlines))], object)),
        "landmark_name": ("landmark", np.array(["gate", "release"], object)),
        "landmark_x": ("landmark", np.array([10.0, RELEASE[0]]), metres),
        "landmark_y": ("landmark", np.array([10.0, RELEASE[1]]), metres),
        "section_x": ("section_point", section[:, 0], metres),
        "section_y": ("section_point", section[:, 1], metres),
    }
    return xr.Dataset(variables, coordinates, {"name": "plant", "seed": seed, "scored_variable": "concentration"})


def ring(size: int = 40, steps: int = 60) -> xr.Dataset:
    """A run without coordinates: waves on a ring, positive and negative, as a Lorenz-96 study records them."""
    time = 0.05 * np.arange(steps + 1)
    phase = 2 * np.pi * (4 * np.arange(size)[None] / size - time[:, None])
    fields = {"truth": 6 * np.sin(phase) + 2, "mean": 6 * np.sin(phase + np.exp(-time)[:, None]) + 2}
    fields |= {"free": 6 * np.sin(2 * phase) + 2}
    variables = {f"x_{k}": (("time", "node"), v, {"units": "1"}) for k, v in fields.items()}
    variables |= {"err": ("time", 80 * np.exp(-time)), "err_free": ("time", 80 + 0 * time)}
    return xr.Dataset(
        variables, {"time": ("time", time, {"units": "s"})}, {"name": "ring", "seed": 1, "scored_variable": "x"}
    )


@pytest.fixture(scope="session")
def plant_run() -> xr.Dataset:
    return plant()


@pytest.fixture(scope="session")
def ring_run() -> xr.Dataset:
    return ring()


@pytest.fixture(scope="session")
def make_plant():
    return plant


@pytest.fixture(scope="session")
def lone_run(plant_run: xr.Dataset) -> xr.Dataset:
    """Stations instead of vehicles, and no free run: its variables exist, but are empty or NaN."""
    run = plant_run.isel(vehicle=slice(0, 0)).copy(deep=True)
    for name in [name for name in run.data_vars if str(name).endswith("_free")]:
        run[name].values[:] = np.nan
    return run


@pytest.fixture(scope="session")
def untold_run(plant_run: xr.Dataset) -> xr.Dataset:
    """Neither a truth nor a free run."""
    return without_free_run(without_truth(plant_run))


@pytest.fixture
def plant_folder(plant_run: xr.Dataset, tmp_path: Path) -> Path:
    folder = tmp_path / "plant"
    folder.mkdir()
    plant_run.to_netcdf(folder / "run.nc")
    return folder
