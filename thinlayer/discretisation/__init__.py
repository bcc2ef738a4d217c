"""From joints, laws and loads to spaces, weak forms and states."""
