"""Decides: perception, belief, policy, motion; identical on every backend."""

__version__ = "0.1.0"
