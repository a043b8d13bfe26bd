"""The web page and the service: one queue of videos behind both."""
