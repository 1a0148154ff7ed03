"""Data sets: labelled frames in shards, for learning and for tests of estimators."""
