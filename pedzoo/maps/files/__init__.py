"""Floor plans in files: images, ROS, iGibson."""
