"""The step of a trained model as a file that runs without this package."""

from __future__ import annotations

import copy
import importlib.util
import io
import logging
import os
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from symo_exp.checks import path_text, whole_number
from symo_exp.compile.inductor import simplify, stand_ins, trace
from symo_exp.compile.newton import iterate_branch_free
from symo_exp.errors import ConfigError, shortened
from symo_exp.files import write_bytes, write_whole
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import MomentumMatching
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import Flow, VariationalFlow
from symo_exp.models.inference import leaves_inference_mode
from symo_exp.shell import python_command
from symo_exp.tracking.load import model_of
from symo_exp.use.mjcf import write_bodies

ARGUMENTS = ("q", "v", "u", "u_next")
RESULTS = ("q_next", "v_next", "converged")
BATCH = "batch"
"""The name of the free dimension."""


class FixedStep(nn.Module):
    """A step as a fixed sequence of operations, which tells for each row if its root was found.

    Args:
        flow: The flow of a model.
        iterations: Undamped steps of Newton's method, of a variational flow.
    """

    def __init__(self, flow: Flow, iterations: int) -> None:
        super().__init__()
        self.flow, self.iterations = copy.deepcopy(flow).requires_grad_(False), iterations

    def forward(
        self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return ``(q_next, v_next, converged)``."""
        flow = self.flow
        q, v, u, u_next = (x.to(flow.input_matrix.dtype) for x in (q, v, u, u_next))
        if not isinstance(flow, VariationalFlow):
            return flow.step(q, v, u, u_next)[:3]
        forces, h = flow.forces(u, u_next), flow.time_step
        discrete = flow.rollout_discrete
        before, after = discrete.impulses(forces)
        problem = MomentumMatching(discrete, q, flow.encode(q, v) + before, forces)
        given = flow.rollout_root
        root = Newton(tolerance=given.tolerance)  # row by row, whatever the rollout's
        root.sizes, root.accuracy = given.sizes, given.accuracy
        at = iterate_branch_free(problem, root, problem.start(flow.space.retract(q, h * v)))
        for _ in range(self.iterations):
            at = iterate_branch_free(problem, root, at.next, at)
        q_next = flow.space.point(q, at.x[:, : v.shape[1]])
        return q_next, flow.decode(q_next, at.expansion.values.d2 + after), at.found


@leaves_inference_mode
def export(
    run: DynamicsModel | str | os.PathLike[str], path: str | Path, *, iterations: int = 5
) -> Path:
    """Write the step of a model to a file that runs without this package.

    ``*.pt2`` and ``*.onnx`` map ``(q, v, u, u_next)`` to ``(q_next, v_next, converged)``, in SI
    units: ``q`` is (batch, N), ``v`` (batch, n), ``u``, ``u_next`` (batch, m), ``converged``
    (batch,); N is n, or more by six for each rotation, whose matrix has nine entries. The batch has
    any size; a single state is a batch of one. Arguments of a ``*.pt2`` may be float32 or float64,
    those of a ``*.onnx`` have the precision of the model; results have it in both. The control goes
    linearly from ``u`` to ``u_next``. ``*.pt2`` is read by ``torch.export.load(path).module()``,
    ``*.onnx`` by any ONNX runtime.

    ``*.xml`` is the model itself as MJCF, ``*.urdf`` as URDF, where it consists of rigid bodies
    (``symo_exp.use.mjcf.write_bodies``).

    Args:
        run: A model, a run, its folder or the id of an MLflow run.
        path: The file to write; its folder is made if there is none.
        iterations: Newton iterations of a variational step.

    Returns:
        The path.

    Raises:
        ConfigError: If the suffix is unknown, the file cannot be written, the step has operations
            that the format lacks, or ``run`` is none of the above.
    """
    model = model_of(run, "export")
    path = Path(path_text("path", path, "the name of a file, such as model.pt2")).expanduser()
    if path.is_dir():
        raise ConfigError(f"{path} is a folder; give the name of a file, such as model.pt2")
    if path.suffix in (".xml", ".urdf"):
        try:
            return write_bodies(model, path)
        except OSError as error:
            reason = f"{path} cannot be written ({error.strerror}); give another one"
            raise ConfigError(reason) from error
    if path.suffix not in (".pt2", ".onnx"):
        raise ConfigError(f"{path}: expected a name that ends in .pt2, .onnx, .xml or .urdf")
    iterations = whole_number("iterations", iterations)
    if path.suffix == ".onnx" and (missing := [x for x in ONNX if not importlib.util.find_spec(x)]):
        raise ConfigError(
            f"ONNX needs packages that are missing: {python_command('pip', 'install', *missing)}"
        )
    step = FixedStep(model.flow, iterations).eval()
    try:
        program = _program(step, model, exact=path.suffix == ".onnx")
        (_onnx if path.suffix == ".onnx" else _pt2)(program, path, model)
    except Exception as error:  # PyTorch has many
        if isinstance(error, ConfigError):
            raise
        reason = shortened(error, 200)
        raise ConfigError(f"this step cannot be written to {path.name}: {reason}") from error
    return path


ONNX = ("onnx", "onnxscript")


def _program(step: FixedStep, model: DynamicsModel, *, exact: bool) -> Any:
    """Return the step as a graph, which converts arguments to its precision unless ``exact``."""
    (n, m), like, rows = model.input_matrix.shape, model.input_matrix, 3
    if not exact:  # a conversion is part of the graph if there is one to do
        like = like.to(torch.float32 if like.dtype == torch.float64 else torch.float64)
    q, v, u = (like.new_full((rows, size), 0.1) for size in (n, n, m))
    example = (model.flow.space.of_vector(q), v, u, u.clone())
    with torch.no_grad():
        step(*example)  # constants that functions keep would have no data if a trace made them
        # Derivatives that the step takes become operations here; ``torch.export`` loses them.
        graph = trace(step, stand_ins((), example, rows), {})
        for node, name in zip(graph.graph.find_nodes(op="placeholder"), ARGUMENTS, strict=True):
            node.target = name  # as the arguments are called in the file
        simplify(graph)
        batch = torch.export.Dim(BATCH, min=1)
        return torch.export.export(graph, example, dynamic_shapes=({0: batch},) * 4, strict=False)


def _pt2(program: Any, path: Path, model: DynamicsModel) -> None:
    stored, names = (", ".join(x) for x in (model.coordinates.stored, model.coordinates.names))
    about = (
        f"{ARGUMENTS} -> {RESULTS}; a row for each state, a single state is a batch of one; "
        f"columns of q: {stored}; of v: {names}; time step {model.time_step} s\n"
    )
    file = io.BytesIO()
    with warnings.catch_warnings():
        # of buffers that are views of one tensor, each of which is written as it is
        warnings.filterwarnings("ignore", "No complete tensor found", UserWarning)
        torch.export.save(program, file, extra_files={"symo_exp.txt": about})
    write_bytes(path, file.getvalue())


def _onnx(program: Any, path: Path, model: DynamicsModel) -> None:
    if any("solve" in str(node.target) for node in program.graph.nodes):
        raise ConfigError("ONNX cannot solve linear equations, as this step does; .pt2 can")

    def save(new: Path) -> None:
        torch.onnx.export(
            program, f=new, dynamo=True, verbose=False,
            external_data=False,  # weights in the file too
            input_names=ARGUMENTS, output_names=RESULTS,
            dynamic_shapes=({0: BATCH},) * len(ARGUMENTS),  # else the name that the graph gives it
        )  # fmt: skip

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        write_whole(path, save)
