"""The command line, the catalogue of the studies that it runs, and the folders with their results."""
