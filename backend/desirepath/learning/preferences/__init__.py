"""What people prefer: the objectives, what a trajectory measures of them, answers, the posterior, oracles."""
