"""What robots among people are made of: bodies, scenes with robots, sensors' view, the environment."""
