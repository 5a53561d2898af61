"""What was done: soil, leg, motion, scenario, force history and measured data; files and errors."""
