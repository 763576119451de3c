"""The wheel holds a program: it is bound to a platform, not to a version of Python."""
import re
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel

HERE = Path(__file__).parent
MANIFEST = (HERE / "../Cargo.toml").read_text(encoding="utf-8")


class ProgramWheel(bdist_wheel):
    def get_tag(self):
        return "py3", "none", super().get_tag()[2]


class ProgramDistribution(Distribution):
    def has_ext_modules(self):
        return True


setup(
    version=re.search(r'^version = "(.+)"', MANIFEST, re.M).group(1),
    cmdclass={"bdist_wheel": ProgramWheel},
    distclass=ProgramDistribution,
)
