"""The phantom speaker: a procedural presenter whose joints, strokes, beats and words are known."""
