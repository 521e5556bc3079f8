"""MAZES: point, ant and spider on the physics of Gymnasium-Robotics."""
