"""Benchmarks of speed: the project's training steps, evaluation and rollouts beside two baselines.

`python -m benchmarks.run` compares, `python -m benchmarks.scaling` measures how cost grows. The
baselines compute the same numbers from the same weights and data; that is checked before timing.
"""

import symo_exp  # noqa: F401 (SYMO_EXP_AVX512 takes effect before torch is imported)
