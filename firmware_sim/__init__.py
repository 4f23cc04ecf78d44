"""Simulated instrument: firmware, sensors, coil and tissue behind the serial protocol."""
