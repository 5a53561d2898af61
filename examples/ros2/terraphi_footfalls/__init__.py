"""A node for ROS 2 that publishes φ under the footfalls of a walking robot."""
