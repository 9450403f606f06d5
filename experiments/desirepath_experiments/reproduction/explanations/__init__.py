"""Chapter 8 reproduced: policy, scenarios, simulated rankers with and without access to the outlines."""
