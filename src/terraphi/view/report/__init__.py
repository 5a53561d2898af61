"""Results of any kind in one HTML file that needs nothing else.

Each kind has a module that makes a :class:`~terraphi.view.report.parts.Section` of it; ``page``
puts sections into a page. Nothing a result says is trusted: texts are escaped, and no path in a
file leads out of its folder.
"""
