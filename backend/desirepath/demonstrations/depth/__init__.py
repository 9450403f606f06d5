"""Depth vision-based controllers (ch. 3): episodes with people who walk, recordings, states, TD3+BC on latents."""
