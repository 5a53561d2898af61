"""Plan, run, resume and store simulations: an Executor in, a Library out."""
