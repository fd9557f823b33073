"""The scenarios stand once, in the top folder; a wheel has them as `valvesim/scenarios`. All else: pyproject.toml."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["valvesim", "valvesim.*"]), "valvesim.scenarios"],
    package_dir={"valvesim.scenarios": "scenarios"},
)
