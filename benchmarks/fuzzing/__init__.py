"""Broken input for all readers: how it is made, and what reads it. ``benchmarks/fuzz.py`` is the command."""
