"""A running session: joining, its state machine, watching, answering, leaving."""
