"""Node set-up before the loop starts: checks of each device, and the objects written to it and read back."""
