"""The command line, one module per group of commands; `desirepath.cli.main` puts them together."""
