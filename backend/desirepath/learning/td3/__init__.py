"""TD3 and what is trained with it: base policy, ensemble, conditioned policy."""
