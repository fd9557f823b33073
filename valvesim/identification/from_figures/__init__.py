"""A valve identified from the figures of a catalogue or of its acceptance test."""
