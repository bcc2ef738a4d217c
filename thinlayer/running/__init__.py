"""Command line, catalogue of studies, records of runs."""
