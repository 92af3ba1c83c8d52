"""The packages, found in their folders; the wheel's tag; the links of the package's page."""

import os
import re
from pathlib import Path
from sysconfig import get_config_var

from setuptools import find_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel

TOP_LEVEL = ("features", "labels", "training", "models", "inference")
REPOSITORY = os.environ.get("TOKT_REPOSITORY", "").rstrip("/")
LINK = re.compile(r"(!?)(\[[^]]*\])\((?![a-z]+:|#)([^)]+)\)")


class Wheel(bdist_wheel):
    """One wheel for all Pythons of a platform; without a compiler one for all platforms."""

    def finalize_options(self) -> None:
        """Ask for the stable interface of Python, but where there is none."""
        if not get_config_var("Py_GIL_DISABLED"):
            self.py_limited_api = "cp311"
        super().finalize_options()

    def run(self) -> None:
        """Pack what was built: slower kernels never get a platform's tag."""
        built = [Path(path) for path in self.get_finalized_command("build_ext").get_outputs()]
        for path in built:
            path.unlink(missing_ok=True)  # of an older build
        self.run_command("build")
        if not all(path.exists() for path in built):
            self.distribution.ext_modules = None
            self.root_is_pure = True
            self.warn("no compiler: the wheel has numpy's kernels alone, slower, as py3-none-any")
        super().run()


def page() -> str:
    """README, with links that work away from the repository once it has an address."""
    text = Path(__file__).with_name("README.md").read_text("utf-8")
    if not REPOSITORY:
        return text
    kind = {"": "blob", "!": "raw"}
    return LINK.sub(lambda m: f"{m[1]}{m[2]}({REPOSITORY}/{kind[m[1]]}/HEAD/{m[3]})", text)


def addresses() -> dict[str, str]:
    """Where the package's page leads to."""
    changes = f"{REPOSITORY}/blob/HEAD/CHANGELOG.md"
    named = {"Source": REPOSITORY, "Issues": f"{REPOSITORY}/issues", "Changelog": changes}
    return named if REPOSITORY else {}


setup(
    packages=[
        *find_packages("src"),
        *(f"tokt.{part}" for part in TOP_LEVEL),
        *(f"tokt.{part}.{name}" for part in TOP_LEVEL for name in find_packages(part)),
    ],
    cmdclass={"bdist_wheel": Wheel},
    long_description=page(),
    long_description_content_type="text/markdown",
    project_urls=addresses(),
)
