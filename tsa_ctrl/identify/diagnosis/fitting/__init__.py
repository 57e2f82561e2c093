"""Compare a hypothesis with the data: whitened residuals, bounded least squares, score test and noise model."""
