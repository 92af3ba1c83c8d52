"""A bundle of format 3, which knew no map before the weights; it must load for ever.

Nothing here may be changed together with models/bundle/bundle.py: it stands for files on ships.
"""

from pathlib import Path

import numpy as np

from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes


def test_a_file_of_format_3_loads_and_is_the_same_model_in_this_format():
    """Written by the commit before format 4, with three classes and a distribution."""
    data = (Path(__file__).parent / "bundle_of_format_3.zip").read_bytes()

    old = bundle_from_bytes(data, "old.tokt")
    new = bundle_from_bytes(bundle_bytes(old.content), "new.tokt")

    assert (old.label, old.sha256[:12]) == ("yesterday/5", "dc80d33fbcf3")
    assert old.model.map is None and new.model.map is None
    assert old.distribution.summary() == new.distribution.summary()
    assert old.sha256 != new.sha256
    np.testing.assert_array_equal(old.model.weights, new.model.weights)
    golden, again = old.content.golden.decision_values, new.content.golden.decision_values
    np.testing.assert_array_equal(golden, again)
