"""Results from states: stresses at points, fields and tables on S, comparisons, files for ParaView, pictures."""
