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
        PluginSpec("filter", "acme_nudging", "acme.nudging:Nudging", "pulls every member towards the readings"),
    ]
