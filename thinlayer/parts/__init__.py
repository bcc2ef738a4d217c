"""Parts of the balance of forces: bodies, layers, pressures, contact, and what is added to a model."""
