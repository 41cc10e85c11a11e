"""Parts of the pybullet backend: scenes, walls, robots from URDF files, pictures, and the client."""
