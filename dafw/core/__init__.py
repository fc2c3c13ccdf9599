"""The core: what the numbers mean, the four interfaces, the registry, the one time loop and its record."""
