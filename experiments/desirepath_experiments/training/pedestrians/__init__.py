"""Chapter 4: training by reward, and planners that are compared and imitated."""
