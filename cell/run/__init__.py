"""Runs a round: connects the pure supervisor to the wire, measures, judges and reports."""
