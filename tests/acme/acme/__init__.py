"""What Acme brings to dafw."""

from dafw import PluginSpec, hookimpl


@hookimpl
def dafw_plugins():
    """Return Acme's plugins."""
    return [
        PluginSpec("model", "acme_rod", "acme.rod:Rod", "heat in a rod"),
        PluginSpec("model", "acme_cooling", "acme.cooling:Cooling", "a plain function"),
        PluginSpec("model", "acme_solver", "acme.external:Solver", "an external program"),
        PluginSpec("observer", "acme_probe", "acme.probe:Probe", "thermometers at equal distances"),
        PluginSpec("policy", "acme_patrol", "acme.patrol:Patrol", "to and fro"),
        PluginSpec("policy", "acme_lookout", "acme.lookout:Lookout", "where the members will disagree"),
        PluginSpec("filter", "acme_esmda", "acme.esmda:ESMDA", "runs the model again from the first guess"),
        PluginSpec("filter", "acme_lag", "acme.lag:Lag", "fixed-lag smoother"),
        PluginSpec("filter", "acme_nudging", "acme.nudging:Nudging", "pulls every member towards the readings"),
    ]
