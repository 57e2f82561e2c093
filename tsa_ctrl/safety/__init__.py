"""What keeps the torque safe, whatever law asks for it. Imports the bus only: what a model predicts is handed in."""
