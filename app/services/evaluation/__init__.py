"""Accuracy on public data sets: one file per data set, each with its protocol."""
