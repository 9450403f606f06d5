"""Chapter 7 computed anew: three views, one reward model and one policy per view."""
