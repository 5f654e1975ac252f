"""The plugin `mjgranular.sensor` by its words: its name, its keys, what it can measure."""

SENSOR = "mjgranular.sensor"
"""Of the plugin."""

SENSOR_KEYS = ("measure", "sand")
"""Of its configuration."""

MEASURES = {"force": 3, "moment": 3, "depth": 1, "power": 1, "speed": 1, "touch": 1}
"""The measures, with the number of their values."""
