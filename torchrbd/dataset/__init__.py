"""Recordings as data of regressions: rows through one filter, moments of blocks of time, columns of candidates."""
