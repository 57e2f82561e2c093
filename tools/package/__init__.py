"""Build and check the distribution, and record the licences of its dependencies."""
