"""S as a mesh of its own, below all that asks what is there: ranges, tractions, norms, places, lines."""
