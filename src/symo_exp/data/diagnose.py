"""Diagnosis of recordings before training: inputs, noise, time step and scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symo_exp.data.explained import explained_in_degrees, explained_power, spring_slopes
from symo_exp.data.sensors import blur_of, encoder_of, noise_of
from symo_exp.data.weak import Motion, quasi_coordinates
from symo_exp.mechanics.types import Coordinates

POOR, NOISY, COARSE = 0.5, 0.5, 0.7
"""Share of explained power below which no model can succeed; noise over curvature, and change of an
angle in a step [rad], above which the time step does not suit."""
SUSPECT = 0.3
"""Share of the unexplained power below which angles are suspected to be in degrees."""
HELP = 0.1
"""Share of the unexplained power that meaningful inputs explain at least."""


@dataclass(frozen=True)
class Diagnosis:
    """Properties of recordings that are known before training.

    Attributes:
        coordinates: Those of the system.
        time_step: Distance of the nodes [s].
        driven: Whether any input is not zero.
        explained: Share of the accelerations' power that configurations, velocities, friction and
            inputs explain, ``None`` with too few nodes.
        free: The same without the inputs.
        degrees: The same, with the inputs, if the numbers of the angles are degrees; ``None``
            without angles.
        sprung: Whether springs explain accelerations that gravity does not.
        noise: Standard deviation of the noise of each coordinate's samples [rad, m].
        encoder: Step of each coordinate's encoder [rad, m], 0 where none is seen.
        turn: Largest change of each coordinate in a time step [rad, m].
        blur: Noise of the nodes over curvature, the root mean square of ``h² q̈``, the largest.
    """

    coordinates: Coordinates
    time_step: float
    driven: bool
    explained: float | None
    free: float | None
    degrees: float | None
    sprung: bool
    noise: np.ndarray
    encoder: np.ndarray
    turn: np.ndarray
    blur: float

    @property
    def fixes_scale(self) -> bool:
        """True if inputs determine the inertia, not only its ratio to the forces."""
        if not self.driven or self.explained is None or self.free is None:
            return self.driven
        return self.explained - self.free >= HELP * (1 - self.free)

    def lines(self) -> list[str]:
        """Return lines for the log: inputs, units, noise, time step, scale and springs."""
        springs = "springs: they explain accelerations that gravity does not (springs=linear)"
        found = [self._inputs(), *self._unit(), self._noise(), self._step(), self._scale()]
        return [*found, springs] if self.sprung else found

    def _inputs(self) -> str:
        if self.explained is None:
            return "inputs: too little motion to tell what they explain"
        poor = self.explained < POOR
        hint = "; something else moves the machine, or a sensor fails" if poor else ""
        share = f"{100 * self.explained:.3g} % of the accelerations' power"
        if self.driven:
            without = 100 * (self.free or 0.0)
            return f"inputs: {share} is explained with them, {without:.3g} % without{hint}"
        if poor:
            return f"inputs: none, and configurations and velocities explain only {share}{hint}"
        return "inputs: none; accelerations follow from configurations and velocities"

    def _unit(self) -> list[str]:
        if self.explained is None or self.degrees is None:
            return []
        if 1 - self.degrees > SUSPECT * (1 - self.explained):
            return []
        return [
            f"angles: {100 * self.degrees:.3g} % is explained if they are in degrees, "
            f"{100 * self.explained:.3g} % in radians; data.degrees=true converts"
        ]

    def _noise(self) -> str:
        each = zip(self.coordinates.names, self.noise, self.encoder, strict=True)
        return "noise: " + ", ".join(
            f"{name} {noise:.1e}" + (f" (encoder step {step:.2g})" if step else "")
            for name, noise, step in each
        )

    def _step(self) -> str:
        h, names = f"{self.time_step:g}", self.coordinates.names
        moves = ", ".join(f"{n} at most {x:.2g}" for n, x in zip(names, self.turn, strict=True))
        angles = self.turn[np.array(self.coordinates.turning)]
        verdict = "suits"
        if angles.size and angles.max() > COARSE:
            verdict = "is coarse: a smaller one sees more, or data.leave_out skips what is fast"
        elif self.blur > NOISY:
            verdict = "is fine: noise hides the curvature, a larger one shows it"
        return (
            f"time step: {h} s {verdict} ({moves} a step, noise {self.blur:.1g} of the curvature)"
        )

    def _scale(self) -> str:
        if not self.driven:
            return "scale: no inputs, so the Lagrangian and friction are known up to a factor"
        if self.explained is None:
            return "scale: too little motion to tell whether the inputs determine the inertia"
        if not self.fixes_scale:
            return "scale: the inputs explain next to nothing, so the inertia's scale is doubtful"
        return "scale: the inputs determine the scale of the inertia"


def diagnose(
    motions: Sequence[Motion],
    raw: Sequence[np.ndarray],
    coordinates: Coordinates,
    time_step: float,
    samples: float = 1.0,
) -> Diagnosis:
    """Return the diagnosis of recordings.

    Args:
        motions: Configurations (T, N) and inputs (T, m) of each recording, at the nodes.
        raw: Its configurations (T', N) as sampled.
        coordinates: Those of the system.
        time_step: Distance of the nodes [s].
        samples: Number of samples in a time step.
    """
    paths = [quasi_coordinates(q, coordinates) for q, _ in motions]
    columns = [*zip(*(quasi_coordinates(q, coordinates).T for q in raw), strict=True)]
    second = [np.diff(path, 2, axis=0) for path in paths]
    noise = np.array([*map(noise_of, columns)])
    blur = blur_of(noise, samples)
    of_noise = 6 * blur**2  # the power of its second differences
    power = np.mean(np.concatenate(second) ** 2, axis=0) - of_noise
    curvature = np.sqrt(np.maximum(power, 0.01 * blur**2))
    springs = spring_slopes(motions, coordinates, time_step)
    return Diagnosis(
        coordinates,
        time_step,
        driven=any(bool(u.any()) for _, u in motions),
        explained=explained_power(motions, coordinates, time_step, driven=True),
        free=explained_power(motions, coordinates, time_step, driven=False),
        degrees=explained_in_degrees(motions, coordinates, time_step),
        sprung=springs is not None,
        noise=noise,
        encoder=np.array([*map(encoder_of, columns)]),
        turn=np.max([np.abs(np.diff(path, axis=0)).max(0) for path in paths], axis=0),
        blur=float(np.max(blur / np.maximum(curvature, np.finfo(float).tiny))),
    )
