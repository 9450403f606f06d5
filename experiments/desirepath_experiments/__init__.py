"""Benchmarks, studies of asking, reproduction of chapters, shipping: may import everything; only commands import it."""
