"""A file that names sweeps, to be run one after another: a product cannot say them all."""

from __future__ import annotations

import argparse
from pathlib import Path

import yaml

from symo_exp.configuration import SWEEPS
from symo_exp.errors import ConfigError


def sweeps_of(args: argparse.Namespace) -> list[str]:
    """The sweeps that ``-cn NAME`` stands for; none if it is a configuration itself."""
    if args.config_name is None:
        return []
    file = Path(args.config_dir or SWEEPS) / f"{args.config_name}.yaml"
    if not file.is_file():
        return []
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{file} cannot be read: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or set(content) != {"sweeps"}:
        return []
    names = content["sweeps"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{file}: sweeps is to be a list of names")
    for name in names:
        other = file.with_name(f"{name}.yaml")
        if name == args.config_name or not other.is_file():
            raise ConfigError(f"{file} names the sweep {name}, which is not in {file.parent}")
    return names
