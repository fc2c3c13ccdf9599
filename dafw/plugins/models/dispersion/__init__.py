"""Gas dispersion among buildings: site, mesh, wind, transport and the two models made of them."""
