"""Make docs/thesis.md from a finished run: ``python docs/make_thesis_page.py OUT``.

OUT is the folder of ``tokt reproduce MISSION -o OUT``, whose results.json has every figure of it.
"""

import json
import sys
from pathlib import Path

from tokt_studies.thesis.page import write_thesis_page

results = json.loads((Path(sys.argv[1]) / "results.json").read_text(encoding="utf-8"))
write_thesis_page(results, Path(__file__).parent / "thesis.md")
