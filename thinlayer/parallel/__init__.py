"""Agreement of the ranks, and data that travels between them."""
