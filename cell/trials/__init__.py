"""The published experiment in simulation: campaigns of rounds, their figures, statistics and report."""
