"""From a robot's log to foot forces, stances and touch-downs."""
