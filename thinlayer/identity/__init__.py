"""Descriptions of the data and code of a run, equal in every process."""
