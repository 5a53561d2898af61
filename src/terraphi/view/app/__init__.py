"""The report's pages served on this machine: drop measured forces or a log, see φ and verdict.

Each dropped file is read by a separate process with limits on time and memory, in a temporary
folder that is removed afterwards; the server itself never parses it.
"""
