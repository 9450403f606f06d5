"""Training through the simulation: a rollout's measures are differentiated with respect to the policy itself."""
