"""Xu & Wang's model: MLS-MPM in plane strain, APIC transfers at every step, a rigid leg.

Read in this order: ``bed`` (what there is), ``transfer``, ``plasticity``, ``contact`` (one piece of
physics each), ``model`` (the constants), ``scalar`` (a step).
"""
