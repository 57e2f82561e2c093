"""The control loop: set-point, direction, estimate, feedforward law, limiter, and the cycle that joins them."""
