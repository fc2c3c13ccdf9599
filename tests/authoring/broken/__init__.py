"""Plugins that are right but for one thing, each caught by the check that it is registered under."""

from broken import executors, filters, models, observers, policies, readings, smoothers, weights
from broken.registry import BROKEN

__all__ = ["BROKEN", "executors", "filters", "models", "observers", "policies", "readings", "smoothers", "weights"]
