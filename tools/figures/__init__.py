"""Pictures of the manual."""
