"""The triangle mesh of a site: made by gmsh, kept in a cache, read into DOLFINx, divided among ranks."""
