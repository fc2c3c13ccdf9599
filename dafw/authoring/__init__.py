"""Tools for plugin authors: conformance kit (public as ``dafw.testing``), templates, models of functions and programs.

Importing this package loads none of its modules.
"""
