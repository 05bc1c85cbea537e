"""Objects that a configuration describes, whose classes may be a user's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate


def instance_of(node: Mapping[str, Any], **given: Any) -> Any:
    """Return the object of a part of a configuration; its lists and mappings are plain ones.

    Args:
        node: The part, whose ``_target_`` is the class.
        given: Arguments that are no configuration.

    Raises:
        Exception: Any that a constructor raises, without Hydra's own around it.
    """
    try:
        # given afterwards: Hydra would take a system, a dataclass, for configuration
        return instantiate(node, _partial_=True, _convert_="all")(**given)
    except InstantiationException as error:
        if error.__cause__ is None:
            raise
        raise error.__cause__ from None


def arguments_of(system: Any) -> dict[str, Any]:
    """Return the arguments that every model takes from its system."""
    names = "coordinates", "input_matrix", "time_step"
    return {name: getattr(system, name) for name in names}
