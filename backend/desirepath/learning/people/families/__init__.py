"""The families, one file each: parameters as the card has them, and who is drawn from them."""
