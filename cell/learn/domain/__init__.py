"""The onion-sorting task as a TB-DecMDP: vectorised, seedable, with an exact solution."""
