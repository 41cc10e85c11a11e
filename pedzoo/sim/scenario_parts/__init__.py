"""Parts of scenarios: layouts, lanes, ranges."""
