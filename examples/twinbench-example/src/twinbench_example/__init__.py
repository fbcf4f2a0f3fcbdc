"""A method, a metric, a data set and a term for twinbench."""
