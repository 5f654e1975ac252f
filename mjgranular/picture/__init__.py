"""Figures and films. Loads matplotlib and mediapy only when used."""
