"""The TCP servers of the emulated controller, all on one thread with its cycle."""
