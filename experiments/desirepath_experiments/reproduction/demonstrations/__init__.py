"""Chapter 2 reproduced. Everything is simulated: those who demonstrate are the programmed demonstrators."""
