"""What a checkout has and a wheel has not: zoo, benchmarks, the paper's tables, and pages."""
