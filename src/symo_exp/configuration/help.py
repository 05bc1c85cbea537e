"""What ``-h`` prints: every group of the configuration and a line for each of its choices.

Read from the comments at the top of the files, without Hydra, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from symo_exp.configuration import CONF, SWEEPS

USAGE = """\
Learn the dynamics of a mechanical system from trajectories.

python -m symo_exp model=e2e_symo system=acrobot                       one run
python -m symo_exp model=e2e_symo system=acrobot -m data.n_traj=8,16   a sweep, one run for each
python -m symo_exp -cn smoke                                           a sweep kept in a file
"""

NOTES = """\
--cfg job    shows every setting with its value; any of them can be set: data.noise_std=1e-3
--config-dir FOLDER    adds your own system/NAME.yaml, data/NAME.yaml, ... to these
--hydra-help           the options of Hydra itself
A message too terse? SYMO_EXP_DEBUG=1 shows where an error came from.
"""


def help_text(folders: Sequence[Path] = ()) -> str:
    """The help, with the groups of ``folders`` (``--config-dir``) besides those that ship."""
    roots = [CONF, *folders]
    groups = sorted({g for root in roots for g in _groups(root)}, key=_order)
    blocks = [f"{g}=\n" + _choices([root / g for root in roots]) for g in groups]
    sweeps = "-cn\n" + _choices([SWEEPS])
    return "\n".join([USAGE, *blocks, sweeps, NOTES])


def _groups(root: Path) -> set[str]:
    return {str(f.parent.relative_to(root)) for f in root.glob("*/**/*.yaml")}


def _order(group: str) -> tuple[bool, str]:
    return group.startswith("hydra/"), group


def _choices(folders: Sequence[Path]) -> str:
    files = {f.stem: f for folder in folders for f in sorted(folder.glob("*.yaml"))}
    width = max((len(name) for name in files), default=0)
    return "".join(f"  {name:{width}}  {description(file)}\n" for name, file in files.items())


def description(file: Path) -> str:
    """The first comment of a configuration file that is no ``# @package`` directive."""
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        text = line.lstrip("# ").strip()
        if text and not text.startswith("@package"):
            return text
    return ""
