"""What finds equilibria under contact laws, beside plain Newton."""
