"""Open a file with uxarray and draw its fields; run by the interpreter of uxarray's own environment.

``python draw_with_uxarray.py FILE`` prints one JSON object: the sum of the numbers of every field on the mesh that was
opened and drawn, by its name. Fields at nodes become means over the faces to be drawn.
"""

import json
import sys

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
import uxarray


def main(path: str) -> None:
    """Draw the last map of every field as polygons."""
    dataset = uxarray.open_dataset(path, path, decode_times=False)
    drawn = {}
    for name, field in dataset.data_vars.items():
        if "n_node" not in field.dims:
            continue
        total = float(np.nansum(field.values, dtype=np.float64))
        others = {dim: -1 for dim in field.dims if dim != "n_node"}
        on_faces = field.isel(others).topological_mean(destination="face")
        polygons = on_faces.to_polycollection()
        axes = plt.figure().add_subplot()
        polygons.set_transform(axes.transData)  # metres, which uxarray takes for degrees: so without a projection
        axes.add_collection(polygons)
        axes.autoscale_view()
        axes.figure.canvas.draw()
        if len(polygons.get_paths()) == dataset.uxgrid.n_face:
            drawn[str(name)] = total
        plt.close("all")
    print(json.dumps(drawn))


if __name__ == "__main__":
    main(sys.argv[1])
