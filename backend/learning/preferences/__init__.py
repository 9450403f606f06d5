"""What people want: objectives, what a trajectory measures of them, answers, the posterior, oracles."""
