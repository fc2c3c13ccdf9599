"""The built-in plugins. They are registered like those of other packages, by the entry-point group ``dafw``."""

from __future__ import annotations

from dafw.core.hookspecs import PluginSpec, hookimpl

_HERE = "dafw.plugins"


@hookimpl
def dafw_plugins() -> list[PluginSpec]:
    """Return the built-in plugins."""
    dispersion = f"{_HERE}.models.dispersion.model"
    return [
        PluginSpec("model", "ad", f"{dispersion}:AdvectionDiffusion", "a gas in a given uniform wind"),
        PluginSpec("model", "ad_ins", f"{dispersion}_ins:AdvectionDiffusionINS", "a gas in the wind among buildings"),
        PluginSpec("model", "lorenz96", f"{_HERE}.models.lorenz96:Lorenz96", "chaotic variables on a circle"),
        PluginSpec("model", "linear_advection", f"{_HERE}.models.linear_advection:LinearAdvection", "waves on a ring"),
        PluginSpec("model", "puffs", f"{_HERE}.models.puffs.model:Puffs", "a leak's puffs in a measured wind"),
        PluginSpec(
            "model", "puffs_track", f"{_HERE}.models.puffs.model_track:PuffsTrack", "the same, read by a moving sensor"
        ),
        PluginSpec("observer", "drone", f"{_HERE}.observers.drone:Drone", "reads the nodes a vehicle passes"),
        PluginSpec("observer", "stations", f"{_HERE}.observers.stations:Stations", "reads at fixed positions"),
        PluginSpec("observer", "grid", f"{_HERE}.observers.grid:Grid", "reads fixed entries of a variable"),
        PluginSpec("observer", "path", f"{_HERE}.observers.path:Path", "reads means along lines"),
        PluginSpec("observer", "composite", f"{_HERE}.observers.composite:Composite", "several observers at once"),
        PluginSpec("observer", "none", f"{_HERE}.observers.none:NoObserver", "reads nothing"),
        PluginSpec("policy", "enie2d", f"{_HERE}.policies.enie2d:EnIE2D", "towards spread and concentration"),
        PluginSpec("policy", "look_ahead", f"{_HERE}.policies.look_ahead:LookAhead", "to where members will disagree"),
        PluginSpec("policy", "route", f"{_HERE}.policies.route:ListedRoute", "along listed points, whatever is read"),
        PluginSpec("policy", "stationary", f"{_HERE}.policies.stationary:Stationary", "every vehicle hovers"),
        PluginSpec("filter", "etkf", f"{_HERE}.filters.etkf:ETKF", "ensemble transform Kalman filter"),
        PluginSpec("filter", "enkf", f"{_HERE}.filters.enkf:EnKF", "stochastic EnKF with perturbed observations"),
        PluginSpec("filter", "kalman", f"{_HERE}.filters.kalman:Kalman", "exact, for linear problems and N > n"),
        PluginSpec("filter", "none", f"{_HERE}.filters.none:NoFilter", "the forecast is the analysis"),
        PluginSpec("filter", "amis", f"{_HERE}.filters.amis:AMIS", "adaptive multiple importance sampling, re-runs"),
        PluginSpec("filter", "smc", f"{_HERE}.filters.smc:SMC", "tempered sequential Monte Carlo, re-runs"),
        PluginSpec("filter", "local", f"{_HERE}.filters.local:Local", "another filter, corrected near the readings"),
        PluginSpec(
            "filter",
            "coarse_search",
            f"{_HERE}.filters.coarse_search:CoarseSearch",
            "another filter, on a coarser version of the model",
        ),
        PluginSpec("filter", "enks", f"{_HERE}.filters.enks:EnKS", "ensemble Kalman smoother, fixed lag or interval"),
        PluginSpec(
            "filter", "esmda", f"{_HERE}.filters.esmda:ESMDA", "ES-MDA: small stochastic updates, re-runs between"
        ),
        PluginSpec(
            "filter", "ienks", f"{_HERE}.filters.ienks:IEnKS", "iterative ensemble Kalman smoother, Gauss-Newton"
        ),
        PluginSpec("filter", "restart_enkf", f"{_HERE}.filters.restart_enkf:RestartEnKF", "one update, then a re-run"),
        PluginSpec("readings", "twin", f"{_HERE}.readings.twin:Twin", "what the observer reads of a truth, with noise"),
        PluginSpec("readings", "listed", f"{_HERE}.readings.listed:Listed", "a list of readings with their times"),
        PluginSpec("readings", "recorded", f"{_HERE}.readings.recorded:Recorded", "a file: CSV, netCDF, GeoJSON"),
        PluginSpec("readings", "live", f"{_HERE}.readings.live:Live", "a feed: standard input, a file, a broker"),
        PluginSpec("executor", "serial", "dafw.core.executors.serial:Serial", "steps members in this process"),
        PluginSpec(
            "executor", "processes", "dafw.core.executors.processes:Processes", "steps members in worker processes"
        ),
        PluginSpec("executor", "dask", "dafw.core.executors.dask_cluster:Dask", "steps members on a dask cluster"),
    ]
