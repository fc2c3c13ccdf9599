"""A full covariance of the readings is factorised once in an analysis, by every filter."""

import numpy as np
import pytest

from dafw import FIELD, Ensemble, Observation, Selection, StateSpace, Variable
from dafw.core.rng import Streams
from dafw.plugins.filters.enkf import EnKF
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF

SPACE = StateSpace([Variable("x", 5, FIELD)])
R = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 3.0]])


@pytest.mark.parametrize(
    "filter_", [ETKF(), ETKF(rotation=True), EnKF(), EnKS()], ids=["etkf", "rotated", "enkf", "enks"]
)
def test_a_full_covariance_is_factorised_once(filter_, monkeypatch):
    rng = np.random.default_rng(0)
    belief = Ensemble(rng.standard_normal((8, 5)), SPACE)
    operator = Selection(indices=np.array([0, 2, 4]), covariance=R)
    observation = Observation(rng.standard_normal(3), operator)
    factorised = []
    cholesky = np.linalg.cholesky
    monkeypatch.setattr("numpy.linalg.cholesky", lambda matrix: factorised.append(matrix.shape) or cholesky(matrix))
    if isinstance(filter_, EnKS):
        filter_._transform(observation, belief)
    else:
        predicted = operator.apply(belief.members)
        filter_.update(belief, predicted, observation, None, Streams(0).generator("filter", 0))
    assert factorised.count(R.shape) == 1
