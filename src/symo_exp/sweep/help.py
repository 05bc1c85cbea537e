"""What ``-h`` prints: every group of the configuration and a line for each of its choices.

Read from the comments at the top of the files, without Hydra, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from symo_exp.shipped import CONF, SWEEPS

USAGE = """\
Learn the dynamics of a mechanical system from trajectories.

python -m symo_exp model=e2e_symo system=acrobot                       one run
python -m symo_exp model=e2e_symo system=acrobot -m data.n_traj=8,16   a sweep, one run for each
python -m symo_exp -cn smoke                                           a sweep kept in a file
python -m symo_exp record Swimmer-v5 --out mine.parquet                motions of an environment
"""

NOTES = """\
--cfg job              shows every setting and its value; set any of them: data.noise_std=1e-3
hydra/launcher=joblib  runs the jobs of a sweep side by side, one process a core;
                       submitit_slurm_cpu, on a cluster (docs/clusters.md)
--config-dir FOLDER    adds your own system/NAME.yaml, data/NAME.yaml and so on to these
--hydra-help           the options of Hydra itself
SYMO_EXP_DEBUG=1       in the environment shows where an error came from
"""


def help_text(folders: Sequence[Path] = ()) -> str:
    """The help, with the groups of ``folders`` (``--config-dir``) besides those that ship."""
    roots = [CONF, *folders]
    groups = sorted({group for root in roots for group in _groups(root)})
    blocks = [f"{g}=\n" + _choices([root / g for root in roots]) for g in groups]
    sweeps = "-cn (a sweep)\n" + _choices([SWEEPS])
    return "\n".join([USAGE, *blocks, sweeps, NOTES])


def _groups(root: Path) -> set[str]:
    return {file.parent.name for file in root.glob("*/*.yaml")}


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
