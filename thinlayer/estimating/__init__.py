"""What dropping a layer's mesh costs: errors of the interface law of order 0, from a better law on the same mesh."""
