"""Build and check the distribution, and list the licences of its dependencies."""
