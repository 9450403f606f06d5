"""`python -m desirepath` is the `desirepath` command."""

from desirepath.cli.main import main

if __name__ == "__main__":
    main()
