"""Descriptions of what a run is made from, the same in every process."""
