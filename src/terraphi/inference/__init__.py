"""From records and a library to the friction angle, its interval and a verdict.

Read in this order: ``emulator`` (curves between the library's cases), ``records`` (what was measured),
``checks`` (what looks wrong with it), ``soils`` (how real soils differ from the model), ``likelihood``
(named terms, and the posterior), ``answer``, ``inversion`` (all of it in one call).
"""
