"""Names of the plugin `mjgranular.sensor`: its name, its keys, and its measures."""

SENSOR = "mjgranular.sensor"
"""Name of the plugin."""

SENSOR_KEYS = ("measure", "sand")
"""Keys of its configuration."""

MEASURES = {"force": 3, "moment": 3, "depth": 1, "power": 1, "speed": 1, "touch": 1}
"""The measures, with the number of their values."""
