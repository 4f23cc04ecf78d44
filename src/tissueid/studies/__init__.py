"""Studies: statistics over the tests of many subjects, sites and conditions.

The statistics work on a table with one row per test (``study_table``), a pandas data frame. They need the extra
``tissueid[study]``: pandas, statsmodels and scikit-learn.
"""
