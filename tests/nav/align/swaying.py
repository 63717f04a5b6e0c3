"""Truth of an IMU on a swaying base; see `bridge.studies.alignment_truth`."""

from bridge.studies.alignment_truth import DEG_PER_H, HEIGHT, LAT, LON, Base, G, misalignment, sensed

__all__ = ["DEG_PER_H", "HEIGHT", "LAT", "LON", "Base", "G", "misalignment", "sensed"]
