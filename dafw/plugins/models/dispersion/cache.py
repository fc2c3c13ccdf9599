"""The folder in which meshes and reduced bases are kept from one run to the next."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_dir


def cache_folder() -> Path:
    """Return the environment variable ``DAFW_CACHE`` where it is set, otherwise the user's cache folder for dafw."""
    return Path(os.environ.get("DAFW_CACHE") or user_cache_dir("dafw"))
