"""The wheel has every file of the package and of conf/, and nothing else; test_acme.py and test_docs.py use it."""

from __future__ import annotations

import zipfile

from fresh import ROOT, environment


def test_the_wheel_has_all_files_of_the_package_and_its_configuration():
    (wheel,) = (environment().bin.parents[1] / "wheels").glob("dafw-*.whl")
    with zipfile.ZipFile(wheel) as opened:
        found = {name for name in opened.namelist() if ".dist-info/" not in name}
        metadata = opened.read(next(name for name in opened.namelist() if name.endswith("/METADATA"))).decode()
        listed = {name.rpartition("/")[2] for name in opened.namelist() if ".dist-info/" in name}
    folders = {"dafw": "dafw", "conf": "dafw/conf"}
    expected = {
        f"{inside}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, inside in folders.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }
    assert found == expected
    assert {"dafw/conf/config.yaml", "dafw/views/page/page.html"} <= found
    assert any(name.endswith("/plant.geojson") for name in found) and any(name.endswith(".csv") for name in found)
    assert {"LICENSE", "entry_points.txt"} <= listed
    assert "Provides-Extra: docs" in metadata
