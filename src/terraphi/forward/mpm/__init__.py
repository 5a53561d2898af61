"""Material point method in plane strain: MLS-MPM with APIC transfers and a rigid leg.

Read in this order: ``bed`` (what there is), ``transfer``, ``plasticity``, ``contact``, ``relief``
(one piece of physics each), ``scalar`` (a step), ``solver`` (all steps).
"""
