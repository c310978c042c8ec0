"""Beliefs over a partner's hidden type, from its observed actions."""
