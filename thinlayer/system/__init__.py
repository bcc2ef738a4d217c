"""Infrastructure: agreement of MPI ranks, files, tables, compiled code and its cache, hashes that identify runs."""
