"""Truth of a vehicle on a road; see `bridge.studies.alignment_truth`."""

from bridge.studies.alignment_truth import drive, fixes, merged, road, stops, ticks, times

__all__ = ["drive", "fixes", "merged", "road", "stops", "ticks", "times"]
