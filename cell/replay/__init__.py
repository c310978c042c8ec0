"""Recorded decisions taken again: the same inputs through today's supervisor."""
