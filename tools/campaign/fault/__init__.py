"""The faults of the campaign, the processes they meet, and the verdict."""
