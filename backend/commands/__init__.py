"""The command line, one module per group of commands; `backend.cli` puts them together."""
