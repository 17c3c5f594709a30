"""Whole workflows as functions: what the commands and a notebook call. Nothing here prints."""
