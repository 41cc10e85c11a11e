"""The suites of the paper's tables, and of what controllers in the loop have to show."""
