"""Measured sessions, predictions, and the fit of a valve to them."""
