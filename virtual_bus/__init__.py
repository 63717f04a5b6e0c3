"""The simulated bench: truth, sensors, faults, and virtual devices that put real frames on a bus."""
