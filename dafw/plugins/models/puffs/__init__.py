"""A plume of puffs in a measured wind."""
