"""Batch simulator for whole surveys with Starbug fibre robots."""

__version__ = "0.1.0"
