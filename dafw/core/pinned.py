"""A study whose models use exactly what an earlier run of it used, where the configuration leaves that open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dafw.core.errors import RunError
from dafw.core.options import merged
from dafw.core.registry import registry
from dafw.core.study import Study


def pinned_study(study: Study, pinned: Mapping[str, Mapping[str, Any]]) -> Study:
    """Return the study with the ``pinned`` options of its models, by role (``Model.pinned_options``).

    Its configuration stays as it was. Raises RunError for pinned options of a model that cannot be made again, and
    ConfigurationError if what they name is no longer there.
    """
    made: dict[str, Any] = {}
    for role, options in pinned.items():
        recipe = registry().recipe(study.models[role]) if role in study.models else None
        if recipe is None:
            raise RunError(f"the run pinned options of its {role} ({options}), and the study has no such model")
        made[role] = registry().create("model", merged(recipe, options))
    return replace(study, **made) if made else study
