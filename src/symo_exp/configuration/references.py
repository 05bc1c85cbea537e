"""What a value of a configuration file may refer to: a setting, or one of two values by a third.

``${if:${data.noise_std},1e-4,1e-3}`` is 1e-4 where there is noise and 1e-3 where there is none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import InterpolationResolutionError

OmegaConf.register_new_resolver(
    "if", lambda condition, then, otherwise: then if condition else otherwise, replace=True
)


def followed(values: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """The values with their references followed; those that ``settings`` (dotted names) lacks
    something for are left out."""
    references = {n: x for n, x in values.items() if isinstance(x, str) and "${" in x}
    config = OmegaConf.create()
    for name, value in settings.items():
        if any(name in reference for reference in references.values()):
            OmegaConf.update(config, name, value)
    config["references"] = references
    known = {name: value for name, value in values.items() if name not in references}
    for name in references:
        try:
            known[name] = config["references"][name]
        except InterpolationResolutionError:
            continue
    return known
