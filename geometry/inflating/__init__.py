"""Layers with a thickness: S opened into bands of cells, and the bodies moved apart."""
