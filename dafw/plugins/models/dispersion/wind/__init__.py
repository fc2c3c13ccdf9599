"""The steady wind around buildings, from the full Navier-Stokes equations."""
