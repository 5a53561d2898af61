"""Package of type ament_python: ``colcon build`` in a workspace, with terraphi[robot] installed."""

from setuptools import setup

NAME = "terraphi_footfalls"
setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    entry_points={"console_scripts": [f"footfalls = {NAME}.node:main"]},
)
