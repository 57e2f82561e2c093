"""Use operating system services: real-time scheduling, timers, processes, shared memory and torque-off outputs."""
