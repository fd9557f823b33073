"""From a scenario to its result."""
