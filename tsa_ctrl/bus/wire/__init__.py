"""CAN frames on any kind of bus: the interface of a bus, its implementations, and the CAN links of the kernel."""
