"""Parts of the balance of forces: bodies, layers, pressures, contact, springs and users' own forms."""
