"""Forecasts that a decision can rest on: the belief run ahead, what it says of places and areas, and its files."""
