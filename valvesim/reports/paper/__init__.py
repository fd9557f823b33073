"""The page on the paper: published beside computed, with the reasons, a file a subject."""
