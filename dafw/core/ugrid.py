"""The domain in a netCDF file: mesh topology as UGRID-1.0, obstacles as CF polygons, landmarks by name."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.domain import Domain


def write_domain(file: Any, domain: Domain) -> None:
    """Write the domain into an open netCDF4 file that has its nodes already."""
    corners, places = "corners of the obstacles, one obstacle after the other", "named places"

    def put(name: str, dim: str, values: Any, units: str = "m", **attributes: str) -> None:
        if dim not in file.dimensions:
            file.createDimension(dim, len(values))
        text = np.asarray(values).dtype.kind in "UO"
        variable = file.createVariable(name, str if text else np.asarray(values).dtype, (dim,))
        variable[:] = np.asarray(values, dtype=object) if text else values
        variable.setncatts(attributes if text else {"units": units, **attributes})

    if domain.origin is not None:
        file.setncatts(
            {f"origin_{name}": value for name, value in zip(("longitude", "latitude"), domain.origin, strict=True)}
        )
    if domain.triangles is not None:
        file.createDimension("face", len(domain.triangles))
        file.createDimension("face_corner", 3)
        mesh = file.createVariable("mesh2d", "i4", ())
        mesh.setncatts(
            {
                "cf_role": "mesh_topology",
                "topology_dimension": np.int32(2),
                "node_coordinates": "node_x node_y",
                "face_node_connectivity": "mesh2d_face_nodes",
                "long_name": "triangle mesh",
            }
        )
        faces = file.createVariable("mesh2d_face_nodes", "i4", ("face", "face_corner"))
        faces.setncatts({"cf_role": "face_node_connectivity", "start_index": np.int32(0), "long_name": "corner nodes"})
        faces[:] = domain.triangles
        for axis in "xy":
            file.variables[f"node_{axis}"].standard_name = f"projection_{axis}_coordinate"
    if domain.obstacles:
        put(
            "obstacle_vertex_count",
            "obstacle",
            np.array([len(ring) for ring in domain.obstacles], "i4"),
            "1",
            long_name="number of corners",
        )
        vertices = np.concatenate(domain.obstacles)
        put("obstacle_x", "obstacle_vertex", vertices[:, 0], axis="X", long_name=f"x of the {corners}")
        put("obstacle_y", "obstacle_vertex", vertices[:, 1], axis="Y", long_name=f"y of the {corners}")
        names = list(domain.obstacle_names) or [""] * len(domain.obstacles)
        put("obstacle_name", "obstacle", names, long_name="names of the obstacles")
        container = file.createVariable("obstacles", "i4", ())
        container.setncatts(
            {
                "geometry_type": "polygon",
                "long_name": "obstacles",
                "node_count": "obstacle_vertex_count",
                "node_coordinates": "obstacle_x obstacle_y",
            }
        )
    if domain.landmarks:
        put("landmark_name", "landmark", list(domain.landmarks), long_name=f"names of the {places}")
        points = np.array(list(domain.landmarks.values()), dtype=np.float64)
        put("landmark_x", "landmark", points[:, 0], long_name=f"x of the {places}")
        put("landmark_y", "landmark", points[:, 1], long_name=f"y of the {places}")
