"""Tells Hydra where Acme's configuration is."""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin


class AcmeSearchPath(SearchPathPlugin):
    """Appends the configuration that ships with acme."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append it after dafw's own."""
        search_path.append("acme", "pkg://acme.conf")
