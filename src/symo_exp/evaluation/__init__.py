"""Rollouts and measures, written once for every method.

``evaluate`` computes the measures of a run: by ``rollouts`` on simulated motions, by ``recordings``
in windows of measured ones (``horizon``), beside ``references``. After training, ``uncertainty``
finds the posterior, from which ``intervals`` and the table of ``parameters`` follow. ``verdict``
says it in words. Further measures are each a ``study``: ``learned`` and ``motion``.
"""
