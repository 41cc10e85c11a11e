"""Physics backends: one file each. Files that begin with `_` are what they share."""
