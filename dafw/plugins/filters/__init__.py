"""Built-in filters, one a file."""
