"""Parameter estimation with confidence intervals, and optimal choice of further measurements."""
