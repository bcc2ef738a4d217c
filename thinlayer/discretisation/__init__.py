"""Discretisation: function spaces, weak forms and states from joints, laws and loads."""
