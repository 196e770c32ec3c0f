"""The whole survey: composes the stages, runs them in parallel, and keeps what is done."""
