"""S as a mesh of its own, below all that asks what is there: norms, places, lines, pressures in excess."""
