"""Drop-in folder: one file is one dataset."""
