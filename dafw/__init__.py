"""dafw: a laboratory for data-assimilation studies."""
