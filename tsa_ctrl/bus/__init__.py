"""Raw frames in, SI out: the CANopen master. The only package that knows device units and object numbers."""
