"""Maps the top-level folders `envs/` and `models/` into the package `mjgranular`.

Everything else is in pyproject.toml. A folder cannot be found as `mjgranular.models` from TOML
alone without listing every subpackage by hand, and a forgotten one would be missing from the wheel
only.
"""

from setuptools import find_packages, setup

MAPPED = {"mjgranular.envs": "envs", "mjgranular.models": "models"}

packages = find_packages(include=["mjgranular", "mjgranular.*"])
for name, folder in MAPPED.items():
    packages += [name, *(f"{name}.{sub}" for sub in find_packages(folder))]

setup(packages=packages, package_dir=MAPPED)
