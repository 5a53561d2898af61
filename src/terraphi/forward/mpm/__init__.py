"""Material point method in three dimensions: quadratic splines, APIC, Lagrangian phases.

Read in this order: ``lattice`` (the grid and its planes of symmetry), ``contact`` and
``plasticity`` (a piece of physics each), ``bed`` (what there is at first), ``transfer`` (particles
and grid between two phases), ``nodes`` (a step of the grid), ``packing`` and ``lanes`` (strain and
force of many particles at a time; ``verification/plain.py`` takes one after the other), and
``solver``, which puts them together. The driver in ``forward`` keeps checkpoints, progress and the
history.
"""
