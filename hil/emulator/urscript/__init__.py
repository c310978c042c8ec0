"""Script programs that the emulated controller knows how to run."""
