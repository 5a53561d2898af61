"""The report's pages served on this machine: drop measured forces or a log, see φ and verdict.

Whatever is dropped is read by a process of its own, with bounds on time and memory, in a temporary
folder that goes with it; the server itself never opens it.
"""
