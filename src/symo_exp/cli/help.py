"""The help text, read from the files of the configuration without Hydra, which takes seconds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import takewhile
from pathlib import Path

import yaml

from symo_exp.process.terminal import fitted_lines
from symo_exp.shell import python_command
from symo_exp.shipped import CONF, SWEEPS

EXAMPLES = {
    ("-cn", "machine", "data.path=mine.csv", "budget=10min"): "Learn a machine from its log:",
    ("model=symo", "system=acrobot"): "One run:",
    ("model=symo", "-m", "data.n_traj=8,16"): "A sweep, one run per value:",
    ("-cn", "smoke"): "A sweep kept in a file:",
    ("record", "Swimmer-v5", "--out", "F.csv"): "Record motions of a Gymnasium environment:",
}
SETTINGS = {
    "data.n_traj": "training trajectories",
    "data.noise_std": "noise [m, rad; m/s, rad/s]",
    "trainer.max_epochs": "epochs of training",
    "seed": "of data, initial weights and order of batches",
    "experiment": "the group of the run in MLflow and in the output folder",
}
"""Settings that people change, besides choices of files."""
NOTES = """\
--cfg job              shows every setting and its value; set any of them: data.noise_std=1e-3
-m                     runs every combination of values given with commas: seed=0,1,2
hydra/launcher=joblib  runs the jobs of a sweep in parallel, one process per core;
                       submitit_slurm_cpu, on a cluster (docs/clusters.md)
--config-dir FOLDER    adds your own system/NAME.yaml, data/NAME.yaml and so on to these
--hydra-help           shows the options of Hydra itself
SYMO_EXP_DEBUG=1       in the environment shows where an error came from
"""


def help_text(folders: Sequence[Path] = ()) -> str:
    """Return examples, common settings, every group of choices with its default, and options.

    Args:
        folders: The user's own configuration (``--config-dir``), listed with ours.
    """
    roots, defaults = [CONF, *folders], dict(_defaults())
    examples = [f"{s}\n  {python_command('symo_exp', *words)}" for words, s in EXAMPLES.items()]
    settings = "".join(f"  {f'{name}={defaults[name]}':23}  {s}\n" for name, s in SETTINGS.items())
    groups = sorted({file.parent.name for root in roots for file in root.glob("*/*.yaml")})
    choices = [f"{g}={defaults.get(g, '')}\n{_choices([r / g for r in roots])}" for g in groups]
    sweeps = f"-cn (a sweep)\n{_choices([SWEEPS, *folders])}"
    said = "Learn the dynamics of a mechanical system from trajectories.\n"
    parts = [said, *examples, f"\nsettings\n{settings}", *choices, sweeps, NOTES]
    return "\n".join([*fitted_lines("\n".join(parts).splitlines()), ""])


def _defaults() -> Iterator[tuple[str, object]]:
    """Yield the settings of the files that are chosen by default."""
    own = yaml.safe_load((CONF / "config.yaml").read_text(encoding="utf-8"))
    yield from own.items()
    for choice in own["defaults"]:
        for group, name in choice.items() if isinstance(choice, dict) else ():
            yield group, name
            file = CONF / group / f"{name}.yaml"
            if file.is_file():
                values = yaml.safe_load(file.read_text(encoding="utf-8")) or {}
                yield from ((f"{group}.{key}", value) for key, value in values.items())


def _choices(folders: Sequence[Path]) -> str:
    files = {f.stem: f for folder in folders for f in sorted(folder.glob("*.yaml"))}
    width = max((len(name) for name in files), default=0)
    return "".join(f"  {name:{width}}  {summary(file)}\n" for name, file in files.items())


def summary(file: Path) -> str:
    """Return the first comment of a configuration file, ``# @package`` directives left out."""
    lines = file.read_text(encoding="utf-8").splitlines()
    comments = (line.lstrip("# ").strip() for line in takewhile(lambda x: x.startswith("#"), lines))
    return next((text for text in comments if text and not text.startswith("@package")), "")
