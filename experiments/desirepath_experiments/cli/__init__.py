"""Commands that the laboratory adds to `desirepath`: entry points of its distribution."""
