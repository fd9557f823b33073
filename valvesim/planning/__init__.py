"""What a bench will show, planned before it is run: detection limits, isolability, parameters, the tests to run."""
