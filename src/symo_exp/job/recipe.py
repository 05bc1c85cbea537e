"""The stages of a run: training, measuring, saving."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from symo_exp.checks import instance
from symo_exp.errors import ConfigError, first_line, with_place
from symo_exp.evaluation.evaluate import Evaluation, evaluate
from symo_exp.evaluation.forces import unlearned_forces
from symo_exp.evaluation.intervals import Predicted
from symo_exp.evaluation.parameters import physical_parameters
from symo_exp.evaluation.study import Finding, afresh
from symo_exp.evaluation.uncertainty import posterior_of
from symo_exp.job.parts import Parts, default_dtype, make
from symo_exp.optim.base import EpochOptimizer
from symo_exp.process import phases, stopping
from symo_exp.runs.folder import CHECKPOINTS, PICTURES, ROLLOUTS, WINDOWS, About, RunFolder
from symo_exp.runs.load import divided_recordings, from_folder
from symo_exp.tracking.store import is_away
from symo_exp.training import resuming

log = logging.getLogger(__name__)


def perform(
    parts: Parts,
    settings: Mapping[str, Any],
    folder: RunFolder,
    about: About,
    *,
    trained: bool = False,
) -> None:
    """Do a run from the last checkpoint on.

    Args:
        parts: The result of ``build``.
        settings: The resolved settings.
        folder: Where all files go.
        about: Name and parameters of the run.
        trained: Do only what a trained run lacks: measures, pictures, studies.
    """
    measured = trained and folder.is_measured(settings.get("reference"))
    measured = measured or not settings["measures"]
    folder.write_config(settings)
    folder.describe(about)
    phases.say(f"{about.name}: opening the store")
    _announce(parts.tracker, folder)
    phases.say(f"{about.name}: making the data")
    with default_dtype(settings["dtype"]):
        if not trained:
            for line in unlearned_forces(parts.model, parts.system):
                log.warning(line)
        _train(parts, folder / CHECKPOINTS)
        drawn = not settings["pictures"] or ((folder / PICTURES).exists() and measured)
        if not measured or not drawn:
            phases.say(f"{about.name}: measuring")
            _keep_parameters(parts, folder)
            evaluation = evaluate(parts.model.cpu(), parts.system, parts.data, parts.reference)
            rollouts = evaluation.rollouts.columns()
            folder.write_table(ROLLOUTS, {name: x.numpy() for name, x in rollouts.items()})
            if evaluation.recorded is not None:
                folder.write_table(WINDOWS, evaluation.recorded.columns())
            if not drawn:
                phases.say(f"{about.name}: drawing pictures")
                _draw(parts, evaluation, about, folder / PICTURES)
            folder.write_measures(evaluation.measures)
        _study(settings, folder, parts)


def _announce(tracker: Any, folder: RunFolder) -> None:
    """Open the run in the store, or log that the store is unavailable."""
    try:
        tracker.publish(folder)
    except Exception as error:
        if not is_away(error):
            raise
        log.warning("the run starts without its tracking store: %s", first_line(error))


def _train(parts: Parts, folder: Path) -> None:
    """Train from the last sound checkpoint in ``folder`` on, if there is one."""
    learner = parts.learner
    saved = None if learner is None else resuming.latest(folder, parts.run, learner)
    if learner is None or (saved is not None and saved.complete):
        parts.data.prepare_data()
        parts.data.setup()
        if saved is not None:
            learner.load_state_dict(saved.state["state_dict"])
        return
    if saved is not None:
        log.info("resuming after epoch %d", saved.state["epoch"] + 1)
    path = None if saved is None else str(saved.path)
    parts.trainer.fit(learner, datamodule=parts.data, ckpt_path=path)
    stopping.raise_if_requested()


def _keep_parameters(parts: Parts, folder: RunFolder) -> None:
    """Find the posterior of the parameters, and keep it with the physical parameters."""
    learner, model, data = parts.learner, parts.model.cpu(), parts.data
    if learner is None:
        return
    optimizer = learner.configure_optimizers()[0][0]
    saved = resuming.latest(folder / CHECKPOINTS, parts.run, learner)
    if isinstance(optimizer, EpochOptimizer) and saved is not None:
        optimizer.load_state_dict(saved.state["optimizer_states"][0])
        estimate = optimizer.estimate() if learner.objective.consecutive else None
        model.posterior = posterior_of(
            model,
            learner.residuals,
            estimate,
            data.trajectories("train"),
            _predicted(parts, folder),
        )
    found = model.posterior
    if found is not None:
        folder.write_posterior(found.state())
    rows = physical_parameters(
        model.lagrangian,
        model.coordinates,
        list(model.parameters()),
        None if found is None else found.parameters,
        driven=model.input_matrix.shape[1] > 0,
        inputs=getattr(model.flow, "inputs", None),
    )
    folder.write_parameters([row._asdict() for row in rows])


def _predicted(parts: Parts, folder: RunFolder) -> list[Predicted]:
    """Return the recordings whose errors widen intervals, and the models that predict them.

    Those of a cross-validation are each predicted by the model that was not trained on it. Else
    they are the training and the validation recordings: few are held out, and how much recordings
    differ shows in many.
    """
    if folds := folder.folds():
        return [
            Predicted(from_folder(fold.path).for_evaluation(), divided_recordings(fold).test)
            for fold in folds
        ]
    held_out = parts.data.trajectories("val") if parts.data.recorded else []
    every = [*parts.data.trajectories("train"), *held_out] if held_out else []
    return [Predicted(None, every)]


def _draw(parts: Parts, evaluation: Evaluation, about: About, folder: Path) -> None:
    """Draw the pictures of a run; a failure is logged and loses nothing else."""
    from symo_exp.report.pictures import draw_run

    folder.mkdir(parents=True, exist_ok=True)
    model, method = parts.model.for_evaluation(), str(about.parameters["model"])
    try:
        draw_run(model, parts.system, evaluation, method=method, title=about.name, folder=folder)
    except Exception:
        log.warning("the pictures could not be drawn", exc_info=True)


def _study(settings: Mapping[str, Any], folder: RunFolder, parts: Parts) -> None:
    """Do the studies that are asked for and not done."""
    asked = settings["study"]
    cache = getattr(parts.data, "cache", None)  # recorded data have none
    remember = afresh if cache is None else cache.get
    for name in folder.missing_studies(asked):
        phases.say(f"study {name}")
        parts.data.setup()  # once
        study = make(asked, name)
        try:
            found = study(parts.model, parts.system, parts.data, remember=remember)
            instance("its result", found, Finding)
            others = folder.measures(other for other in asked if other != name)
            if taken := sorted(found.measures.keys() & others.keys()):
                raise ConfigError(
                    f"another measure of the run is named {taken[0]}; rename this one"
                )
        except ConfigError as error:
            raise ConfigError(f"study={name}: {error}") from error
        except Exception as error:  # it may be a user's
            raise RuntimeError(f"study={name} fails: {with_place(error)}") from error
        columns = {key: x.numpy() for key, x in found.columns.items()}
        folder.write_study(name, asked[name], found.measures, columns)
