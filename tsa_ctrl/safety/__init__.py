"""Keep the torque safe under any control law. Import only the bus; receive model predictions as arguments."""
