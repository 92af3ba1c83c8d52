"""A bundle of format 2, which knew no training distribution; it must load for ever.

Nothing here may be changed together with models/bundle/bundle.py: it stands for files on ships.
"""

from pathlib import Path

import numpy as np

from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.operating_point import MofNRule, OperatingPoint


def test_a_file_of_format_2_loads_and_is_the_same_model_in_this_format():
    """Written by the commit before format 3, with three classes and a frame rule."""
    data = (Path(__file__).parent / "bundle_of_format_2.zip").read_bytes()

    old = bundle_from_bytes(data, "old.tokt")
    new = bundle_from_bytes(bundle_bytes(old.content), "new.tokt")

    assert (old.label, old.sha256[:12]) == ("lastweek/4", "15f15496898d")
    assert old.distribution is None and new.distribution is None and old.signature is None
    rule = MofNRule(0.25, 2, 1, 3)
    assert old.operating_point == new.operating_point == OperatingPoint(rule, {"target_rate": 1e-4})
    assert old.model.classes == new.model.classes == ("ocean", "sand", "other")
    assert old.model.obstacle == new.model.obstacle == (False, True, True)
    assert old.sha256 != new.sha256
    np.testing.assert_array_equal(old.model.weights, new.model.weights)
    np.testing.assert_array_equal(old.content.trained_on, new.content.trained_on)
    golden, again = old.content.golden.decision_values, new.content.golden.decision_values
    np.testing.assert_array_equal(golden, again)
