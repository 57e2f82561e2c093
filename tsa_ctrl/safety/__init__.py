"""Keep the torque safe, whatever law requests it. Imports the bus only: predictions of a model are arguments."""
