"""Where the speaker is: faces, tracks, the square around the upper body."""
