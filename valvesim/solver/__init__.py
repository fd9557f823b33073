"""The integrator and the compilation of the equations for it."""
