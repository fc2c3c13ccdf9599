"""Cheaper solvers of the same wind, from a reduced basis that is made once for a mesh and kept in the cache."""
