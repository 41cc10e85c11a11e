"""Parts of robots among people: scenes with robots, their sensors' view, rewards, the environment."""
