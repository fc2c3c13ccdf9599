"""When forecasts are due, and which plans are refused."""

import pytest

from dafw import ConfigurationError, ForecastPlan
from dafw.core.options import build


def test_without_a_wish_there_is_no_forecast():
    plan = ForecastPlan()
    assert plan.every is None and not any(plan.is_due(done, 1.0) for done in range(200))


@pytest.mark.parametrize(("every", "dt", "due"), [(2.0, 1.0, [2, 4, 6]), (0.5, 0.25, [2, 4, 6]), (0.3, 0.1, [3, 6])])
def test_forecasts_are_due_every_so_many_seconds_and_not_at_the_start(every, dt, due):
    plan = ForecastPlan(every=every)
    assert [done for done in range(8) if plan.is_due(done, dt)] == due


def test_lead_times_and_probabilities_are_ordered_and_complete():
    plan = ForecastPlan(lead_times=[60.0, 30.0], thresholds=[2.0, 1.0], quantiles=[0.9, 0.1], contours=[0.9])
    assert plan.leads == [0.0, 30.0, 60.0]
    assert plan.limits == [1.0, 2.0]
    assert plan.shares == [0.1, 0.5, 0.9]
    assert plan.probabilities == [0.5, 0.9]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"every": 0.0}, "above 0"),
        ({"thresholds": []}, "thresholds"),
        ({"thresholds": [1.0, 1.0]}, "twice"),
        ({"lead_times": [130.0]}, "horizon of 120 s"),
        ({"lead_times": [-1.0]}, "at least 0"),
        ({"quantiles": [0.0]}, "above 0"),
        ({"contours": [1.5]}, "at most 1"),
        ({"areas": {"gate": [[0, 0], [1, 0]]}}, "area 'gate': expected three corners"),
        ({"areas": {"gate": [[0, 0], [1, 0], [1]]}}, "area 'gate': expected three corners"),
        ({"area_units": "feet"}, "metres, degrees"),
        ({"horizons": 3.0}, "did you mean 'horizon'"),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused_with_its_place(options, word):
    with pytest.raises(ConfigurationError, match=word) as raised:
        build(ForecastPlan, options, "study, forecast")
    assert str(raised.value).startswith("study, forecast: ")


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"every": 1.5}, "every"),
        ({"every": 1.0, "horizon": 60.5, "lead_times": []}, "horizon"),
        ({"every": 1.0, "lead_times": [0.2]}, "lead_times"),
    ],
)
def test_times_must_be_whole_steps_of_the_model(options, name):
    plan = ForecastPlan(**options)
    with pytest.raises(ConfigurationError, match=f"option '{name}' must be a whole number of time steps of 1 s"):
        plan.suit(1.0)
