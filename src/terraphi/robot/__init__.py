"""From a robot's log to foot forces and stances."""
