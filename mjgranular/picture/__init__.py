"""What people look at: figures and films. Loads matplotlib and mediapy only when used."""
