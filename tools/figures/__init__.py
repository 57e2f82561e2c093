"""Draw the pictures of the manual."""
