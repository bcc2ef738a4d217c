"""What is read off states: comparisons, profiles along S, files for ParaView, pictures."""
