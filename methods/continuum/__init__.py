"""Twins as continua: few global parameters of a body of finite elements, fitted to recordings."""
