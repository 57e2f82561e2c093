"""The manual's generated parts."""
