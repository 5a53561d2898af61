"""A posterior in; parameters of simulators and maps of slopes out."""
