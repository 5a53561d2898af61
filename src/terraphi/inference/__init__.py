"""From records and a library to the friction angle, its interval and a verdict.

Read in this order: ``emulator`` (curves between the library's cases), ``records`` (what was
measured), ``soils`` (how real soils differ from the model), ``likelihood`` (named terms),
``sampling`` (the posterior), ``checks`` (what looks wrong), ``answer``, ``inversion`` (all of it in
one call).
"""
