"""Infrastructure of runs: agreement of ranks, files, tables, compiled code and its cache, descriptions of runs."""
