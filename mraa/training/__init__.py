"""Training of the renderer, and what every training stage shares."""
