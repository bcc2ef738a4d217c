"""Estimated errors of interface laws: how results change if a layer's mesh is dropped."""
