"""TRMM's Mission Mode: rigid body, wheels, magnetic torquers, sensors and the on-board computer in one loop."""
