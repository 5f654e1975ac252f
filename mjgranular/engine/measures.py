"""What a sensor of the plugin can measure."""

MEASURES = {"force": 3, "moment": 3, "depth": 1, "power": 1, "speed": 1}
"""The measures, with the number of their values."""
