"""LightningModules and callbacks: how the models of the zoo are trained."""
