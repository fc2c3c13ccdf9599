"""What plugin authors use: conformance kit (public as ``dafw.testing``), templates, bases for functions and programs.

Importing this package loads none of it.
"""
