"""A hypothesis against the data: whitened residuals, bounded least squares, the score test, the noise that is left."""
