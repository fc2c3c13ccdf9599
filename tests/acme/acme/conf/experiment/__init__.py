"""Configuration of Acme."""
