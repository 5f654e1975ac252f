"""Gymnasium environments on sand. None is registered yet; the folder installs as a subpackage."""
