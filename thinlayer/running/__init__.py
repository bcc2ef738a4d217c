"""The command line, the catalogue of studies, and the records of their runs."""
