"""A study around the tank of conftest.py."""

from dafw.core.experiment import study_from

CERTAIN = {"wind_speed_sd": 0.0, "wind_direction_sd": 0.0, "noise": 0.0}


def small_study(model, truth, executor, **changes):
    """Return a study whose belief is ``model`` with noise; truth and free run are the same without unknowns."""
    return study_from(
        {
            "model": {"name": "ad_ins", **model, "noise": 0.1},
            "truth": {**CERTAIN, **truth},
            "free": CERTAIN,
            "observer": {"name": "drone", "assumed_variance": 1e-3},
            "policy": {"name": "enie2d"},
            "filter": {"name": "etkf"},
            "vehicle": {"start": [[60.0, 10.0]]},
            "record": {"members": "all"},
            "pictures": False,
            "executor": executor,
            **changes,
        }
    )
