"""The command line, the catalogue of studies, and the folders of results of their runs."""
