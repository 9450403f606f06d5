"""Chapter 8 made anew: policy, scenarios, simulated rankers with and without access to the outlines."""
