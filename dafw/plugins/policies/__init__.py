"""Built-in policies, one a file."""
