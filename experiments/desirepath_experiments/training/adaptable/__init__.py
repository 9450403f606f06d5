"""Chapter 5: training of policies for three weights at run time; driving them is the product's."""
