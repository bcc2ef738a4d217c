"""Descriptions of a structure with a thin layer, in a file or in words of the command line."""
