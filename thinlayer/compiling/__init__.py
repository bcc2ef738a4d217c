"""Compilation of C sources and of the code of laws, once for all ranks and processes."""
