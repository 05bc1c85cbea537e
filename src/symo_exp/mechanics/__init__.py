"""Lagrangian and discrete mechanics: torch only, no networks, no configuration.

Conventions that hold everywhere:

* Tensors are batch-first: configurations and velocities ``(B, n)``, controls ``(B, m)``.
* Controls act through a constant input matrix, ``F = B u`` with ``B`` of shape ``(n, m)``, and vary
  linearly between two nodes (first-order hold): ``u(t_k + c h) = (1 - c) u_k + c u_{k+1}``.
"""
