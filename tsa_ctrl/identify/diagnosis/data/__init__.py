"""Prepare the logs for a diagnosis: denoise, reduce and audit them, and hold out a part of the data."""
