"""The TAD paper (Yan, Liu, Ma 2019) recomputed."""
