"""What a predictor is worth."""
