"""The models with flux-corrected transport: nothing below zero, the account of the gas, the conformance kit."""

import numpy as np
import pytest

from dafw import ConfigurationError
from dafw.core.options import build
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.testing import check_model

MODELS = pytest.mark.parametrize("cls", [AdvectionDiffusion, AdvectionDiffusionINS])
RIMS = pytest.mark.parametrize("outflow", ["zero", "open"])


@MODELS
@RIMS
def test_gas_inside_and_gas_gone_add_up_over_a_run(small_model, cls, outflow):
    transport = {"scheme": "fct", "outflow": outflow}
    wind = {"wind_speed": 8.0}
    options = {key: value for key, value in small_model.items() if key in cls.__dataclass_fields__}
    model = build(cls, options | wind | {"transport": transport, "estimate": ["diffusion"]}, "model 'test'")
    streams = Streams(4)
    state = model.first_guess(3, streams.members("initial", 0))
    gas = model.space.slice("concentration")
    start = state.ensemble.members[:, gas].copy()
    account, inside = np.zeros(3), []
    for cycle in range(10):
        state = model.forecast(state.ensemble, state.memory, streams.members("error", cycle))
        found = state.diagnostics
        assert found["gas"].units == found["gas_gone"].units == "m2"
        account += found["gas_gone"].values
        inside.append(found["gas"].values + account)
        assert state.ensemble.members[:, gas].min() >= 0.0
        assert (state.ensemble.members[:, gas].max(axis=1) <= start.max(axis=1)).all()
    np.testing.assert_allclose(inside, np.broadcast_to(inside[0], (10, 3)), rtol=1e-12)
    assert account.max() > 0.1 * inside[0][0]  # much has left with the fastest wind


def test_without_flux_correction_there_is_no_account(small_model):
    model = build(AdvectionDiffusionINS, small_model, "model 'test'")
    state = model.first_guess(1, Streams(4).members("initial", 0))
    assert "gas" not in model.forecast(state.ensemble, state.memory, Streams(4).members("error", 0)).diagnostics


@MODELS
def test_the_model_conforms_with_flux_correction(cls):
    def make():
        transport = {"scheme": "fct", "outflow": "open"}
        return build(cls, {**cls.check_options(), "transport": transport}, "model 'test'")

    assert all(outcome.status == "passed" for outcome in check_model(make))


@pytest.mark.parametrize("transport", [{"scheme": "fct"}, {"outflow": "open"}])
@MODELS
def test_a_mesh_divided_among_processes_is_refused(small_model, cls, transport):
    model = build(cls, {"transport": transport}, "model 'test'")
    name, value = next(iter(transport.items()))
    with pytest.raises(ConfigurationError, match=f"transport: {name} '{value}' works in one process"):
        model.distribute(object())
