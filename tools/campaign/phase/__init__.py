"""Run the fault campaign in virtual time: every fault, in every phase, at twenty moments of the cycle."""
