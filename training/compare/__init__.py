"""Comparing models on frames that none of them learnt from.

`held_out_predictions` and `mission_predictions` have the models judge the same patches,
`bootstrap`, `permutation_test` and `pairs` say which differences are real, `learning` whether more
labels would help, and `report` puts it all on one page.
"""
