"""Marching in time and along equilibrium paths."""
