"""Files that runs write: tables, folders, progress; C sources with what they include."""
