"""What `survey-sim check` prints: the faults that the independent checker found, or what it proved."""

from __future__ import annotations
