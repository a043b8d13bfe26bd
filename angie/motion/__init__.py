"""Region motion as generators see it: channels, statistics, windows, drift."""
