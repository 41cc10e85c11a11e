"""The environment and the controller: kernel, physics, scenarios, policies and teams."""
