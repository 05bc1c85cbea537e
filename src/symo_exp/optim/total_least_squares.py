"""Total least squares along noisy trajectories, in stages."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.mechanics.types import Trajectory
from symo_exp.nets.roles import is_coefficient, is_late, start
from symo_exp.optim.banded import Chain
from symo_exp.optim.base import EpochOptimizer, Equations, Problem
from symo_exp.optim.evidence import FLAT
from symo_exp.optim.smoothing import SmoothingObjective, smoothing_step
from symo_exp.optim.splines import smoothed

log = logging.getLogger(__name__)

RATE = 1e-2
"""Initial rate of Adam, large enough to leave a basin."""
DRIVEN, FREE = 30.0, 1e-2
"""Initial damping where inputs act, and where none do. Friction starts from almost nothing, and
without it residuals are smallest where inertias are so large that inputs do not matter: a long
first step goes there."""
HANDICAP = 1.5
"""Factor of the held-out loss of a start: smoothing biases it, which few held-out data may hide."""
MOST_STARTS = 1000
"""Starts, each of which is listed with its epochs, that a training can have."""


class Stage(NamedTuple):
    """Epochs at one ``ε``; with ``None`` the smoothed nodes are held."""

    epsilon: float | None
    late: bool = False
    """True if the late parameters move as well."""
    start: int = 0
    """Index of the start: 0 from the initial parameters, 1 after steps of Adam, others after steps
    of Adam from newly drawn parameters."""

    def __str__(self) -> str:
        name = f"start {self.start + 1}" if self.epsilon is None else f"epsilon {self.epsilon}"
        return f"stage {name}{' with late parameters' if self.late else ''}"


class TotalLeastSquares(EpochOptimizer):
    """``min Σ|x − y|²/σ² + Σ|r|²/(ε σ)² + Σ_g α_g |θ_g|²`` over the nodes ``x`` and parameters.

    ``y`` are the measured nodes of all trajectories, ``r(x; θ)`` the residuals of the model on
    three consecutive ones: the noise in the data is estimated with the model instead of being
    learned (errors in variables, a weak constraint). With an ``input_weight`` the inputs are also
    unknown, with the additional term ``Σ|u − u_measured|²/σ_u²``. See ``smoothing`` for a step.

    The nodes are smoothed first and held for ``start`` epochs from each of several starts: the
    initial parameters, these after steps of Adam, and newly drawn ones after steps of Adam. The
    start with the smallest residuals continues with each ε of ``epsilons``. Before the first start,
    residuals are forces for ``force_epochs``, where inputs act (see ``LevenbergMarquardt``). Late
    parameters are zero so far and join in a second round, with each ``ε ≤ late_from``. The
    parameters that are best on held-out data are kept, or the last ones within ``tolerance`` of
    them: a few noisy motions do not distinguish models, and if the equations can be learned exactly
    the smaller ε is the better one.

    Args:
        params: The parameters, float64.
        epsilons: Values of ``ε``.
        starts: Number of starts; 0: parameters are trained ones and all move in each stage.
        start: Epochs of a start.
        force_epochs: Epochs before the first start in which residuals are forces.
        epochs: Epochs of an ``ε``.
        late_from: Largest ``ε`` with late parameters.
        warm_up: Steps of Adam, its rate along a half cosine.
        damping: Initial damping; if left out, it is large where inputs act, for short first steps.
        velocity_weight: Noise of velocities over that of configurations [1/s].
        input_weight: Noise of inputs over that of configurations [N/m, N m/rad], in units of the
            coordinates if these are others; 0: inputs are exact.
        tolerance: See ``EpochOptimizer``.
        seed: Seed of drawn parameters and mini batches.
    """

    reads_trajectories = True
    processor_only = True  # banded systems are solved by LAPACK

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        epsilons: Sequence[float] = (1.0, 0.3, 0.1, 0.03),
        starts: int = 2,
        start: int = 40,
        force_epochs: int = 0,
        epochs: int = 20,
        late_from: float = 0.3,
        warm_up: int = 300,
        damping: float | None = None,
        velocity_weight: float = 1.0,
        input_weight: float = 0.0,
        tolerance: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__(params, patience=10**9, tolerance=tolerance)
        self.require_normal_equations()
        whole_number("optimizer.starts", starts, low=0, high=MOST_STARTS)
        for name, value in (("start", start), ("epochs", epochs)):
            whole_number(f"optimizer.{name}", value)
        self.force_epochs = whole_number("optimizer.force_epochs", force_epochs, low=0)
        sizes = (
            ("damping", FREE if damping is None else damping),
            ("velocity_weight", velocity_weight),
        )
        for name, size in (*sizes, *(("epsilons", e) for e in epsilons)):
            real(f"optimizer.{name}", size, above=0)
        real("optimizer.input_weight", input_weight, low=0)
        real("optimizer.late_from", late_from, above=0)
        self.start, self.epochs, self.damping = start, epochs, damping
        self.warm_up = whole_number("optimizer.warm_up", warm_up, low=0)
        self.seed = whole_number("optimizer.seed", seed, low=0, high=2**32 - 1)
        self.velocity_weight, self.input_weight = velocity_weight, input_weight
        late = starts > 0 and any(map(is_late, self.parameters))
        begins = [Stage(None, start=i) for i in range(starts)]
        rounds = [Stage(e, late=starts == 0) for e in epsilons]
        again = [Stage(e, late=True) for e in epsilons if e <= late_from] if late else []
        self.stages = [*begins, *rounds, *again]
        self._starts = starts
        self.memory |= self._untrained() | {
            "epoch": 0,
            "held": 0.0,
            "nodes": None,
            "initial": None,
            "rival": None,
            "ended": None,
            "kept": None,
        }

    @property
    def total_epochs(self) -> int:
        """Number of epochs of all stages."""
        begins = self.force_epochs + self.start * self._starts
        return begins + self.epochs * (len(self.stages) - self._starts)

    def stage(self, epoch: int) -> Stage:
        """Return the stage of an epoch; the first epoch is 0."""
        epoch = max(0, epoch - self.force_epochs)
        beyond = epoch - self.start * self._starts
        return self.stages[
            epoch // self.start if beyond < 0 else self._starts + beyond // self.epochs
        ]

    def epoch(self, model: Problem, batches: Sequence[Any]) -> dict[str, Tensor]:
        """Take one accepted step; ``batches`` are whole trajectories."""
        trajectories: Sequence[Trajectory] = batches
        memory = self.memory
        chain = Chain.of(
            trajectories, velocities=model.reads_velocity, inputs=self.input_weight > 0
        )
        epoch, damping = memory["epoch"], self._first_damping(trajectories)
        stage = self.stage(epoch)
        before = self.stage(epoch - 1) if epoch else None
        if before is None:
            x = smoothed(trajectories, model.reads_velocity)
            memory["nodes"] = torch.cat((x, chain.x[:, chain.known :]), dim=1)
            first = chain._replace(centre=chain.centre[:1])
            with torch.no_grad():
                window = model.residuals(first.windows(*first.stencil(memory["nodes"])))
            self.require_memory(len(chain.centre) * window.shape[1], copies=4)
            memory["damping"] = damping
            if self._starts:
                self._set_late(to_start=False)
            memory["initial"] = self._snapshot(0.0)
        elif before != stage:
            if before.epsilon is None:
                rival, here = memory["rival"], self._snapshot(memory["loss"])
                memory["rival"] = rival if rival and rival["loss"] < here["loss"] else here
                self._restore(memory["rival" if stage.epsilon else "initial"])
                if stage.epsilon is None:
                    self._warm(model, chain, stage.start)
            elif stage.late and not before.late:
                self._set_late(to_start=True)
            memory["damping"], memory["held"] = min(memory["damping"], damping), 0.0
            memory["ended"] = None
        if before is not None and epoch == self.force_epochs:
            memory |= self._untrained() | {"damping": damping, "ended": None}
        memory["epoch"] = epoch + 1
        if memory["ended"] is None:
            weight = chain.weights(model.sizes, self.velocity_weight, self.input_weight)
            equations: Equations = model
            if epoch < self.force_epochs:
                windows = chain.windows(*chain.stencil(memory["nodes"]))
                equations = model.as_forces(windows) or model
            objective = SmoothingObjective(
                self, equations, chain, weight, stage.epsilon, late=stage.late
            )
            if before is None and not self._starts:
                memory["noise"] = objective.noise(memory["nodes"])
            metrics, ended = smoothing_step(objective)
            memory["loss"] = metrics["train_loss"]
            if ended:
                memory["ended"] = metrics
                log.warning("%s: no step lowers the objective; the best so far is kept", stage)
        else:  # the remaining epochs only pass, so that validation keeps its schedule
            metrics = memory["ended"]
        self.finished = memory["epoch"] >= self.total_epochs
        return {name: torch.tensor(x, dtype=torch.float64) for name, x in metrics.items()}

    @override
    def validated(self, loss: Tensor) -> None:
        before, stage = self.memory["weights"], self.stage(max(0, self.memory["epoch"] - 1))
        start = stage.epsilon is None and self.stages[-1].epsilon is not None
        super().validated(HANDICAP * loss if start else loss)
        if self.memory["weights"] is not before:
            self.memory["kept"] = self._weighting(stage)

    @override
    def estimate(self) -> dict[str, Any] | None:
        """Return ``ε`` and priors of the parameters that are kept; their scatter depends on them.

        Those of a start have none where the nodes are smoothed for others: they are biased.
        """
        kept = self.memory["kept"] or self._weighting(self.stages[-1])
        if kept["epsilon"] is None and self.stages[-1].epsilon is not None:
            log.info("no posterior: the parameters that are kept were learned from smoothed nodes")
            return None
        sizes = torch.tensor([p.numel() for p in self.parameters])
        flat = torch.tensor([is_coefficient(p) for p in self.parameters])
        precision = torch.where(flat, 0.0, kept["precision"])
        return {
            "epsilon": kept["epsilon"],
            "velocity_weight": self.velocity_weight,
            "input_weight": self.input_weight,
            "precision": torch.repeat_interleave(precision, sizes),
        }

    def _first_damping(self, trajectories: Sequence[Trajectory]) -> float:
        if self.damping is not None:
            return self.damping
        if not self._starts:
            return FREE
        return DRIVEN if any(bool(one.u.any()) for one in trajectories) else FREE

    def _untrained(self) -> dict[str, Any]:
        """Return the initial noise and priors."""
        precision = [FLAT if is_coefficient(p) else 1.0 for p in self.parameters]
        return {
            "noise": 1.0,
            "precision": torch.tensor(precision, dtype=torch.float64),
        }

    def _weighting(self, stage: Stage) -> dict[str, Any]:
        return {"epsilon": stage.epsilon, "precision": self.memory["precision"].clone()}

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        super().load_state_dict(state_dict)
        self.finished = self.memory["epoch"] >= self.total_epochs

    def _snapshot(self, loss: float) -> dict[str, Any]:
        """Return the parameters with their damping and priors; a loss that is NaN is the worst."""
        loss = math.inf if math.isnan(loss) else loss
        kept = {name: self.memory[name] for name in ("damping", "noise", "precision")}
        return {"loss": loss, "parameters": self.flat().clone(), **kept}

    def _restore(self, snapshot: dict[str, Any]) -> None:
        self.place(snapshot["parameters"])
        self.memory |= {name: snapshot[name] for name in ("damping", "noise", "precision")}

    @torch.no_grad()
    def _set_late(self, *, to_start: bool) -> None:
        """Set late parameters to their start, or to zero."""
        for p in filter(is_late, self.parameters):
            p.copy_(start(p) if to_start else torch.zeros_like(p))

    def _warm(self, model: Problem, chain: Chain, start: int) -> None:
        """Take steps of Adam on the smoothed nodes."""
        generator = torch.Generator().manual_seed(self.seed + 1000 * (start - 1))
        if start > 1:
            self._draw(generator)
        samples = chain.windows(*chain.stencil(self.memory["nodes"]))
        early = [p for p in self.parameters if not is_late(p)]
        adam = torch.optim.Adam(early, lr=RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, self.warm_up)
        for _ in range(self.warm_up):
            rows = torch.randint(0, len(samples.q), (256,), generator=generator)
            model.loss_and_gradients(samples.rows(rows))
            if all(p.grad is None or bool(p.grad.isfinite().all()) for p in early):
                adam.step()
                schedule.step()

    @torch.no_grad()
    def _draw(self, generator: torch.Generator) -> None:
        """Draw new weights as large as the initial ones."""
        for p in self.parameters:
            if p.ndim > 1 and not is_late(p):
                p.normal_(0.0, float(p.std(unbiased=False)), generator=generator)
