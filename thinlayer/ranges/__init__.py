"""Whether a model and its results lie in the range of its interface laws."""
