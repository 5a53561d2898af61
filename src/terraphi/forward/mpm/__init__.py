"""Material point method in space: quadratic splines, APIC, Lagrangian phases and a rigid body.

Read in this order: ``lattice`` (the grid and its symmetry planes), ``bed`` (what there is),
``plasticity`` and ``contact`` (a piece of physics each), ``transfer`` (particles and grid between
two phases), ``nodes`` (a step of the grid), ``plain`` (strain and force of the reference),
``phase`` (many steps). Then strain and force made fast: ``packing`` (how particles lie), ``lanes``
(what happens to a packet of them), ``packets`` (from the grid's velocities to its forces).
``solver`` gives all of it to the driver in ``mpm``, which keeps checkpoints, progress and the
history.
"""
