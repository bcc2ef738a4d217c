"""Solving the balance of forces: equations, finders, linear solvers and their options."""
