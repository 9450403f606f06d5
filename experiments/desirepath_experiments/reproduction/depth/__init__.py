"""Chapter 3 reproduced: encoder, predictor, six configurations, how they do among people and what they follow."""
