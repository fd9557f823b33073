"""What is measured of a valve, on the model or on records: responses, acceptance tests, linear models."""
