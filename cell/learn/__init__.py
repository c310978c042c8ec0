"""The learner: the sorting domain, beliefs, TB-DecAIRL and its baselines; it knows no robot."""
