"""Finds where the cameras are and how they draw, from views of a board that the arm holds."""
