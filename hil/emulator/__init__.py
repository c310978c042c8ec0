"""A Universal Robots controller on its real ports, moved by a simulated arm."""
