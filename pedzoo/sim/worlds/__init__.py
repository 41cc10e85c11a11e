"""What physics backends share: their base class, compiled loops, contacts, cameras and pybullet scenes."""
