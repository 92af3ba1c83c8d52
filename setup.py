"""The wheel's tag, the links of the package's page, and a check of the links in src/tokt."""

import os
import re
import sys
from pathlib import Path
from sysconfig import get_config_var

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel

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


def check_links() -> None:
    """Stop if git wrote the links in src/tokt as text files, as it does by default on Windows."""
    for path in Path(__file__).parent.glob("src/tokt/*"):
        if path.is_file() and not path.suffix:
            sys.exit(
                f"tokt: error: {path} is a text file, not a link to ../../{path.name}: allow links "
                "(on Windows in Developer Mode), then run `git config core.symlinks true` and "
                "`git checkout -- src/tokt`"
            )


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


check_links()
setup(
    cmdclass={"bdist_wheel": Wheel},
    long_description=page(),
    long_description_content_type="text/markdown",
    project_urls=addresses(),
)
