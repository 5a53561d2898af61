"""Answers and other results on a terminal, in pictures, in a page, and in a local app."""
