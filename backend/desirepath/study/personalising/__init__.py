"""What a session's answers teach: which query comes next, training, what was learnt so far."""
