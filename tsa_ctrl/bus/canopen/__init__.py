"""CANopen standards as tables and bytes: CiA 301, CiA 402, EMCY, objects, PDOs and EDS. Uses no bus and no clock."""
