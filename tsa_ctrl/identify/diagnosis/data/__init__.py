"""Prepare the logs for a diagnosis: denoised and reduced, audited, split into learned from and held out."""
