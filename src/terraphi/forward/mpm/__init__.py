"""Material point method in three dimensions: quadratic splines, APIC, Lagrangian phases.

Read in this order: ``lattice`` (the grid and its planes of symmetry), ``contact`` and
``plasticity`` (a piece of physics each), ``bed`` (what there is at first), ``transfer`` (particles
and grid between two phases), ``nodes`` (a step of the grid), ``plain`` (strain and force), and
``solver``, which puts them together. ``packing`` and ``lanes`` do what ``plain`` does for many
particles at a time. The driver in ``forward`` keeps checkpoints, progress and the history.
"""
