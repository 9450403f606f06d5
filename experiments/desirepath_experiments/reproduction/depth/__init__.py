"""Chapter 3 computed anew: encoder, predictor, six configurations, how they do among people and what they follow."""
