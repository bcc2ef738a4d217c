"""Files that runs write: tables, folders, progress."""
