"""The simulated person: body, poses, behaviour."""
