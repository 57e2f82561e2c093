"""Control an axis: set-point, direction, estimate, feedforward law, limiter, and the cycle that combines them."""
