"""Twins as continua: a few global parameters of a body of finite elements, in an embedded grid, fitted to recordings."""
