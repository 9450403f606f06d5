"""Chapter 5: one policy for demonstration, distance and efficiency, weighed while it drives (PD-MORL, D-REX)."""
