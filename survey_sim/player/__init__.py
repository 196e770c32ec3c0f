"""The field player: routed visits as one HTML page that needs no network and no other file.

`page.html`, `player.css` and the scripts are put together by `make_page`: `motion.js` (where robots are, the physics of
`survey_sim.motion`), `draw.js` (plate and strip), `player.js` (controls).
"""

from survey_sim.player.page import PlayerRun, make_page

__all__ = ["PlayerRun", "make_page"]
