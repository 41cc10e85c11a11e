"""Many evaluations at once: processes, Ray, journals."""
