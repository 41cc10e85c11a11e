"""Results as one page that needs nothing else: tables, replays from above, distributions and curves."""
