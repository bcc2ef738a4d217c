"""Compiling C and the code of laws, once for all ranks and processes."""
