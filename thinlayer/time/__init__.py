"""Marching in time."""
