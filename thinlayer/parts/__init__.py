"""Parts of the balance of forces: bodies, layers, pressures, contact, springs and user-defined forms."""
