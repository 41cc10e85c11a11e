"""Suites: each file says on which cases policies are evaluated, and which of their numbers are shown."""
