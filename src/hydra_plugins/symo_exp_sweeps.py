"""The sweeps that ship, where Hydra looks for files."""

from __future__ import annotations

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin


class SymoExpSweeps(SearchPathPlugin):
    """Search path of the commands of this package; that of other programs is left alone."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the folder of the sweeps."""
        from symo_exp.shipped import CONF, SWEEPS

        if any(str(CONF) in source.path for source in search_path.get_path()):
            search_path.append("symo_exp", f"file://{SWEEPS}")
