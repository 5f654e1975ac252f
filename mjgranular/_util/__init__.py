"""Checks, parsing, files and other things that all packages use."""
