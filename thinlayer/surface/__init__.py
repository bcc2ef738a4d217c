"""S as a separate mesh: integrals, points, lines, and the excess pressure of interface laws."""
