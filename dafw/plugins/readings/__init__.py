"""Built-in sources of readings, one a file."""
