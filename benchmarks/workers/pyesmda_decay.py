"""ES-MDA by pyESMDA on a decay; run by the interpreter of pyESMDA's own environment.

``python pyesmda_decay.py FILE`` reads a file of NumPy (``priors`` (S, N, 2), ``values`` (m,), ``variance``, ``alpha``
(n_steps,)), and prints one JSON list: mean and covariance of the parameters after ES-MDA from each of the S priors, in
one row each.
"""

import json
import sys

import numpy as np
from covmats import CovViaDiagonal
from pyesmda import ESMDA


def decay(parameters, n_cycles):
    """Return the amounts (N, n_cycles) of decays with parameters (N, 2): the amount at the start and the rate."""
    times = np.arange(1, n_cycles + 1)
    return parameters[:, :1] * np.exp(-parameters[:, 1:] * times)


def main(file):
    """Run all priors, print."""
    given = np.load(file)
    values, alpha = given["values"], given["alpha"].tolist()
    rows = []
    for seed, prior in enumerate(given["priors"]):
        solver = ESMDA(
            obs=values,
            m_init=prior.T,
            cov_obs=CovViaDiagonal(np.full(len(values), float(given["variance"]))),
            forward_model=lambda parameters: decay(parameters.T, len(values)).T,
            n_assimilations=len(alpha),
            cov_obs_inflation_factors=alpha,
            inversion_type="cholesky",
            truncation=1.0,
            is_forecast_for_last_assimilation=False,
            is_parallel_analyse_step=False,
            random_state=np.random.default_rng([seed, 1]),
        )
        solver.solve()
        posterior = solver.m_posterior
        rows.append([*posterior.mean(axis=1).tolist(), *np.cov(posterior).ravel().tolist()])
    print(json.dumps(rows))


if __name__ == "__main__":
    main(sys.argv[1])
