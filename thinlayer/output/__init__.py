"""Results from states: comparisons, profiles along S, files for ParaView, pictures."""
