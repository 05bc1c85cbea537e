"""What ``-h`` and ``--help`` print: what people change, on a screen; every choice with a line.

Read from the files of the configuration, without Hydra, so that help comes at once.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

from symo_exp.shell import python_command
from symo_exp.shipped import CONF, SWEEPS

USAGE = "Learn the dynamics of a mechanical system from trajectories.\n"
EXAMPLES = {
    ("model=symo", "system=acrobot"): "One run:",
    ("model=symo", "-m", "data.n_traj=8,16"): "A sweep, a run for each value:",
    ("-cn", "smoke"): "A sweep kept in a file:",
    ("record", "Swimmer-v5", "--out", "F.csv"): "Motions of a Gymnasium environment as recordings:",
}
CHANGED = {
    "model": "", "system": "", "data": "", "integrator": "", "preset": "",
    "data.n_traj": "training trajectories", "data.noise_std": "noise [m, rad; m/s, rad/s]",
    "trainer.max_epochs": "epochs of training", "seed": "data, first weights, order of batches",
    "experiment": "what MLflow and the output folder group by",
}  # fmt: skip
"""The ten settings that people change, and what there is to say of those that are no choice of
files."""
MORE = """\
--help                every choice with a line
--cfg job             every setting with its value
-m                    a sweep: every combination of values given with commas
hydra/launcher=joblib on all cores; submitit_slurm_cpu: on a cluster
--config-dir FOLDER   your own system/NAME.yaml, data/NAME.yaml besides these
"""
NOTES = """\
--cfg job              shows every setting and its value; set any of them: data.noise_std=1e-3
hydra/launcher=joblib  runs the jobs of a sweep side by side, one process a core;
                       submitit_slurm_cpu, on a cluster (docs/clusters.md)
--config-dir FOLDER    adds your own system/NAME.yaml, data/NAME.yaml and so on to these
--hydra-help           the options of Hydra itself
SYMO_EXP_DEBUG=1       in the environment shows where an error came from
"""


def screen(folders: Sequence[Path] = ()) -> str:
    """The ten settings that people change with their defaults and choices, in 80 columns."""
    roots, defaults = [CONF, *folders], dict(_defaults())
    rows = []
    for name, said in CHANGED.items():
        choices = ", ".join(_files([root / name for root in roots]))
        rows += [(f"{name}={defaults[name]}", said or choices)]
    width = max(len(setting) for setting, _ in rows)
    lines = [
        textwrap.fill(said, 78, initial_indent=f"{setting:{width}}  ",
                      subsequent_indent=" " * (width + 2))
        for setting, said in rows
    ]  # fmt: skip
    others = sorted({g for root in roots for g in _groups(root)} - set(CHANGED))
    sweeps = ", ".join(_files([SWEEPS]))
    rest = {"other choices": ", ".join(others), "-cn": sweeps}
    lines += [""] + [
        textwrap.fill(f"{key}: {value}", 78, subsequent_indent="  ") for key, value in rest.items()
    ]
    return "\n".join([_usage(), *lines, "", MORE])


def help_text(folders: Sequence[Path] = ()) -> str:
    """Every group with its choices, those of ``folders`` (``--config-dir``) besides ours."""
    roots = [CONF, *folders]
    groups = sorted({group for root in roots for group in _groups(root)})
    blocks = [f"{g}=\n" + _choices([root / g for root in roots]) for g in groups]
    sweeps = "-cn (a sweep)\n" + _choices([SWEEPS])
    return "\n".join([_usage(), *blocks, sweeps, NOTES])


def _usage() -> str:
    lines = [f"{said}\n  {python_command('symo_exp', *words)}" for words, said in EXAMPLES.items()]
    return "\n".join([USAGE, *lines, ""])


def _defaults() -> Iterator[tuple[str, object]]:
    """What a command without the setting has: of the files that are chosen, and in them."""
    own = yaml.safe_load((CONF / "config.yaml").read_text(encoding="utf-8"))
    yield from own.items()
    for choice in own["defaults"]:
        for group, name in choice.items() if isinstance(choice, dict) else ():
            yield group, name
            file = CONF / group / f"{name}.yaml"
            if file.is_file():
                values = yaml.safe_load(file.read_text(encoding="utf-8")) or {}
                yield from ((f"{group}.{key}", value) for key, value in values.items())


def _groups(root: Path) -> set[str]:
    return {file.parent.name for file in root.glob("*/*.yaml")}


def _files(folders: Sequence[Path]) -> dict[str, Path]:
    return {f.stem: f for folder in folders for f in sorted(folder.glob("*.yaml"))}


def _choices(folders: Sequence[Path]) -> str:
    files = _files(folders)
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
