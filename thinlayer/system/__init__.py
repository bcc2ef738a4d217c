"""What runs stand on: ranks that agree, files, tables, compiled code and its cache, what a run is made from."""
