"""The valve itself: laws, oils, parameters, effects and the equations that they enter."""
