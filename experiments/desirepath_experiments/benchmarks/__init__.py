"""How fast and how well: one module per benchmark, each behind `desirepath benchmark`."""
