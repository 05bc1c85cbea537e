"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from typing import Any, Literal

from symo_exp.models.objectives import RootError
from symo_exp.models.symo import SyMo


class E2ESyMo(SyMo):
    """A learned Lagrangian in a variational integrator, trained on the error of the root: that of
    the next configuration."""

    def __init__(
        self,
        *,
        guess: Literal["datum", "inertial"] = "datum",
        fallback: bool = True,
        **base: Any,
    ) -> None:
        """``guess`` and ``fallback`` are those of ``RootError``."""
        super().__init__(objective=RootError(guess=guess, fallback=fallback), **base)
