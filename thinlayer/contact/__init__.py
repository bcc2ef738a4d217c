"""Contact on S: its nodes, its solvers, its report."""
