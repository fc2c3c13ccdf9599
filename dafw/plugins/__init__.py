"""The built-in plugins: they come in through the same door as anybody's, the entry-point group ``dafw``."""

from __future__ import annotations

from dafw.core.hookspecs import PluginSpec, hookimpl

_HERE = "dafw.plugins"


@hookimpl
def dafw_plugins() -> list[PluginSpec]:
    """Return the built-in plugins."""
    dispersion = f"{_HERE}.models.dispersion.model"
    return [
        PluginSpec("model", "ad", f"{dispersion}:AdvectionDiffusion", "a gas in a given uniform wind"),
        PluginSpec("model", "ad_ins", f"{dispersion}_ins:AdvectionDiffusionINS", "a gas in a steady wind among buildings"),
        PluginSpec("observer", "drone", f"{_HERE}.observers.drone:Drone", "reads the nodes a vehicle passes"),
        PluginSpec("observer", "stations", f"{_HERE}.observers.stations:Stations", "reads fixed places"),
        PluginSpec("observer", "composite", f"{_HERE}.observers.composite:Composite", "several observers at once"),
        PluginSpec("policy", "enie2d", f"{_HERE}.policies.enie2d:EnIE2D", "towards spread and concentration"),
        PluginSpec("policy", "stationary", f"{_HERE}.policies.stationary:Stationary", "every vehicle hovers"),
        PluginSpec("filter", "etkf", f"{_HERE}.filters.etkf:ETKF", "ensemble transform Kalman filter"),
        PluginSpec("filter", "none", f"{_HERE}.filters.none:NoFilter", "the forecast is the analysis"),
    ]
