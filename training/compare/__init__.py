"""Comparing models on frames that none of them learnt from.

`candidates` finds the models, `held_out` and `on_mission` let them judge the same patches,
`bootstrap`, `permutation` and `pairs` say which differences are real, `learning` whether more
labels would help, and `report` puts it all on one page.
"""
