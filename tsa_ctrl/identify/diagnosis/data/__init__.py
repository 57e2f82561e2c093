"""What a diagnosis sees of the logs: denoised and reduced, audited, split into learned from and held out."""
