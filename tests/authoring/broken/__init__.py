"""Plugins with exactly one fault each, found by the check under which they are registered."""

from broken import executors, filters, models, observers, policies, readings, smoothers, weights
from broken.registry import BROKEN

__all__ = ["BROKEN", "executors", "filters", "models", "observers", "policies", "readings", "smoothers", "weights"]
