"""Checks, parsing, files and other helpers for all packages."""
