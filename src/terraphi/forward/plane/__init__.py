"""Material point method in plane strain: MLS-MPM with APIC transfers and a rigid leg.

Read in this order: ``bed`` (what there is), ``transfer``, ``plasticity``, ``contact``, ``relief``
(one piece of physics each), ``scalar`` (a step), ``phases`` (steps for which the grid keeps its
velocities), ``solver`` (all steps). Then the same steps made fast: ``compiled`` (how, and where the
machine code is kept), ``packing`` (how particles lie), ``lanes`` (what happens to a packet of
them), ``rows`` (the grid), ``sweep`` (from grid to grid), ``packets`` and ``packet_phases`` (a
block of steps of either kind). Around the solver: ``state`` (all there is between two blocks),
``checkpoint`` (the same in a file), ``breakdown`` (why a solution failed), ``fields`` (frames for
ParaView).
"""
