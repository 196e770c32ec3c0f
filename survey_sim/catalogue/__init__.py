"""Catalogues: what the sky gives, described by cards, and the targets that the programmes of a run take from it."""

from survey_sim.catalogue.cards import Card, CardSettings, Columns, list_cards, load_card
from survey_sim.catalogue.commands import check_catalogue, make_catalogue
from survey_sim.catalogue.mock import MockRecipe, make_mock
from survey_sim.catalogue.reading import Catalogue, read_catalogue
from survey_sim.catalogue.settings import KEYS_OF_SCIENCE, PriorityBin, ProgrammeSettings
from survey_sim.catalogue.targets import Targets, make_targets
from survey_sim.region import Region

__all__ = [
    "KEYS_OF_SCIENCE",
    "Card",
    "CardSettings",
    "Catalogue",
    "Columns",
    "MockRecipe",
    "PriorityBin",
    "ProgrammeSettings",
    "Region",
    "Targets",
    "check_catalogue",
    "list_cards",
    "load_card",
    "make_catalogue",
    "make_mock",
    "make_targets",
    "read_catalogue",
]
