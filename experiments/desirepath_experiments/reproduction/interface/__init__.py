"""Chapter 7 reproduced: three views, one reward model and one policy per view."""
