"""`python -m survey_sim`."""

from survey_sim.cli import main

main()
