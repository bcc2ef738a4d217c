"""From the balance of forces to its equilibrium."""
