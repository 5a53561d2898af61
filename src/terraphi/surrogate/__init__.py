"""Forces between the simulations of a library: Gaussian processes over its parameters."""
