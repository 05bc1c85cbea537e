"""Tables, figures and pages of runs, and pictures of single runs.

A report is made in four steps:

* runs: ``runs`` reads them as one table, ``cells`` summarises those that differ only in the seed;
* content: ``overview`` puts together the sections (``document``), whose text, tables (``tables``)
  and figures as data (``figures``) are those of ``answer``, ``held_out`` and ``chosen``,
  ``curves``, ``motions`` and ``growth``; ``looks`` has names, colours and printed numbers;
* charts: ``charts`` declares a figure in Vega-Lite;
* files: ``files`` writes tables, charts and the ``page``.

Of a single run, ``pictures`` and ``recordings`` make figures, which ``paper`` draws by Matplotlib,
and ``animation`` its motion.
"""
