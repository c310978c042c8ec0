"""Decides: perception, belief, policy, motion; identical on every backend."""

import os

# Before numpy is loaded: the matrices here are small, and OpenBLAS's second thread would spin on a
# core that the other process needs.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
