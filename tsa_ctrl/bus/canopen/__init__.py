"""The standards as tables and bytes: CiA 301, 402, emergencies, objects, PDOs, EDS. No bus, no clock."""
