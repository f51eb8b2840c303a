"""Processes that compute, and how the station talks to them."""
