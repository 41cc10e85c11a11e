"""What scenarios are made of: layouts, lanes, ranges."""
