"""Solution of the balance of forces: equations, solvers of a step, linear solvers and their options."""
