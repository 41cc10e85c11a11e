"""CrowdNav's simulation of a robot among people who cross a circle, all test cases at once."""
