"""What the simulation gets wrong in measured records, and why."""
