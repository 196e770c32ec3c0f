"""The field player: one safe file, the same physics as the package, and all its controls in a real browser."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from survey_sim.errors import InputError
from survey_sim.exchange import RoutedVisit
from survey_sim.player import PlayerRun, make_page
from survey_sim.schema import PATHS
from survey_sim.survey.field import allocate_field, route_field, standing_at, view_field, view_page, visits_of_run
from survey_sim.survey.field.view import tile_targets
from tests.test_field import make_targets

N_VISIT = 2
HOSTILE = "</script><img src=x onerror='window.pwned=1'>&amp;\u2606"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One field of 15 robots (two of them guides), routed by two routers."""
    folder = tmp_path_factory.mktemp("player")
    instrument = folder / "small.toml"
    instrument.write_text(
        "n_science = 13\nplate_radius_mm = 60.0\npatrol_radius_mm = 30.0\nguides = 'centroids'\n"
        "guide_places_mm = [[26.4, 20.0], [-26.0, -20.0]]\n"
    )
    make_targets().write_csv(folder / "targets.csv")
    made = {}
    for router in ("simple-vector", "coordinated"):
        made[router] = folder / router
        allocate_field(
            folder / "targets.csv", made[router], instrument=instrument, algorithm="cda-basic", visits=N_VISIT, dead=(4,)
        )
        route_field([made[router]], router=router)
    return made


@pytest.fixture(scope="module")
def visit(runs: dict[str, Path]) -> RoutedVisit:
    return visits_of_run(runs["coordinated"], "field", 0)[1]


class TestPage:
    def test_is_one_file_that_asks_for_nothing(self, runs: dict[str, Path]) -> None:
        page = view_page([runs["coordinated"]])
        assert not re.search(r"https?://|src=|@import|url\(|fetch\(|XMLHttpRequest|import\(", page)
        assert "default-src 'none'" in page

    def test_holds_all_visits_and_targets(self, runs: dict[str, Path]) -> None:
        data = data_of(view_page([runs["coordinated"]]))
        assert [visit["label"] for visit in data["runs"][0]["visits"]] == [
            "field, tile 0, visit 0",
            "field, tile 0, visit 1",
        ]
        assert len(data["runs"][0]["targets"]["id"]) == 110
        assert len(data["plates"]) == 1

    def test_visits_and_files_can_be_chosen(self, runs: dict[str, Path], tmp_path: Path) -> None:
        run = runs["coordinated"]
        assert len(data_of(view_page([run], visit_ids=[1]))["runs"][0]["visits"]) == 1
        router = run / "xml" / "router_0001.xml"
        from_file, from_tables = data_of(view_page([router])), data_of(view_page([run], visit_ids=[1]))
        assert len(from_file["runs"][0]["targets"]["id"]) == 110
        one, other = (data["runs"][0]["visits"][0]["legs"] for data in (from_file, from_tables))
        for path in PATHS:
            for column in one[path]:
                np.testing.assert_allclose(one[path][column], other[path][column], atol=2e-6)
        assert view_field([router], tmp_path / "page.html").read_text() == view_page([router])

    def test_what_is_not_there_is_refused(self, runs: dict[str, Path], tmp_path: Path) -> None:
        run = runs["coordinated"]
        for choice, match in (
            ({"tile_id": 7}, "has no visit there"),
            ({"visit_ids": [9]}, "no such visit"),
            ({"survey": "x"}, "no visit"),
        ):
            with pytest.raises(InputError, match=match):
                view_page([run], **choice)
        with pytest.raises(InputError, match="no such file"):
            view_page([tmp_path / "nothing.xml"])

    def test_hostile_text_is_escaped(self, runs: dict[str, Path], visit: RoutedVisit) -> None:
        page = hostile_page(runs, visit)
        assert "<img" not in page
        assert page.count("</script>") == 2
        assert data_of(page)["runs"][0]["name"] == HOSTILE


def data_of(page: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def hostile_page(runs: dict[str, Path], visit: RoutedVisit) -> str:
    hostile = replace(visit, params={**visit.params, "survey": HOSTILE}, reasons={PATHS[0]: [HOSTILE] * visit.plate.n_robot})
    targets = tile_targets(runs["coordinated"], visit.plate, "field", 0)
    return make_page([PlayerRun(HOSTILE, [hostile], targets)], HOSTILE)


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Headless Chromium of the system."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    is_needed = os.environ.get("SURVEY_SIM_REQUIRE_BROWSER") == "1"
    if chromium is None or driver is None:
        if is_needed:
            pytest.fail("chromium and chromedriver are not installed (apt-get install chromium chromium-driver)")
        pytest.skip("chromium is not installed")
    webdriver = pytest.importorskip("selenium.webdriver") if not is_needed else __import__("selenium.webdriver").webdriver
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1400,950"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield opened
    opened.quit()


class TestInBrowser:
    @pytest.fixture
    def page(self, browser, runs: dict[str, Path], tmp_path: Path) -> Iterator:
        """The player opened from disk; whatever it did, the console is clean."""
        browser.get(view_field([runs["coordinated"]], tmp_path / "page.html").as_uri())
        yield browser
        assert browser.get_log("browser") == []

    def keys(self, browser, *keys: str) -> None:
        from selenium.webdriver import ActionChains

        ActionChains(browser).send_keys(*keys).perform()

    def wait(self, browser, script: str) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(browser, 30).until(lambda page: page.execute_script(f"return {script}"), script)

    def positions(self, browser) -> np.ndarray:
        sample = "const s = player.panes[0].route.at(player.time); return [[...s.x], [...s.y], [...s.theta]]"
        return np.array(browser.execute_script(sample))

    def test_play_moves_robots_to_where_the_tables_say(self, page, visit: RoutedVisit) -> None:
        from selenium.webdriver.common.by import By
        from selenium.webdriver.support.ui import Select

        Select(page.find_element(By.ID, "visit")).select_by_index(1)
        Select(page.find_element(By.ID, "speed")).select_by_value("16")
        begun = self.positions(page)
        np.testing.assert_allclose(begun[:2].T, visit.begin("start_to_target").position_mm, atol=2e-6)
        page.find_element(By.ID, "play").click()
        self.wait(page, "player.playing")
        self.wait(page, "!player.playing && player.time === player.duration")
        end = visit.end("start_to_target")
        np.testing.assert_allclose(self.positions(page)[:2].T, end.position_mm, atol=2e-6)
        np.testing.assert_allclose(np.cos(np.radians(self.positions(page)[2] - end.theta_deg)), 1.0, atol=1e-9)
        assert page.find_element(By.CSS_SELECTOR, "[data-figure='at rest']").text == str(visit.plate.n_robot)

    @pytest.mark.parametrize("path", PATHS)
    def test_the_physics_is_the_packages(self, page, visit: RoutedVisit, path: str) -> None:
        page.execute_script(f"player.setVisit(1); player.setPath('{path}')")
        duration = page.execute_script("return player.duration")
        for time_s in np.linspace(0.0, duration, 23):
            page.execute_script("player.seek(arguments[0])", float(time_s))
            expected = standing_at(visit, path, time_s)
            x, y, theta = self.positions(page)
            np.testing.assert_allclose(np.column_stack([x, y]), expected.position_mm, atol=5e-6)
            np.testing.assert_allclose(np.cos(np.radians(theta - expected.theta_deg)), 1.0, atol=1e-9)

    def test_keys(self, page) -> None:
        from selenium.webdriver.common.keys import Keys

        self.keys(page, "n")
        assert page.execute_script("return player.visit") == 1
        self.keys(page, "2")
        assert page.execute_script("return player.path") == "start_to_park"
        ticks = page.execute_script("return player.panes[0].route.ticks")
        self.keys(page, Keys.ARROW_RIGHT)
        assert page.execute_script("return player.time") == ticks[1]
        self.keys(page, Keys.END)
        assert page.execute_script("return player.time === player.duration")
        self.keys(page, Keys.HOME, Keys.SPACE)
        assert page.execute_script("return player.playing")
        self.keys(page, Keys.SPACE, "+")
        assert page.execute_script("return [player.playing, player.speed]") == [False, 2]
        self.keys(page, "p", "?")
        assert page.execute_script("return [player.visit, player.$('help').open]") == [0, True]

    def test_a_click_shows_the_robot(self, page, visit: RoutedVisit) -> None:
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By

        page.execute_script("player.setVisit(1)")
        self.wait(page, "!player.dirty")
        robot = 2
        place = page.execute_script(
            "const v = player.panes[0].view, b = v.canvas.getBoundingClientRect(), s = v.route.sample, r = devicePixelRatio;"
            f"return [v.toX(s.x[{robot}]) / r - b.width / 2, v.toY(s.y[{robot}]) / r - b.height / 2]"
        )
        canvas = page.find_element(By.CSS_SELECTOR, "canvas.plate")
        ActionChains(page).move_to_element_with_offset(canvas, *(round(value) for value in place)).click().perform()
        shown = page.find_element(By.ID, "robot").text
        assert f"{visit.plate.robot_id[robot]}, science, live" in shown
        assert str(visit.held["target_id"][robot]) in shown
        n_leg = int((visit.legs["start_to_target"].robot == robot).sum())
        assert len(page.find_elements(By.CSS_SELECTOR, "#robot tr")) == n_leg + 1
        page.execute_script("player.select(3)")
        assert "dead" in page.find_element(By.ID, "robot").text

    def test_strip_scrub_and_layers(self, page) -> None:
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By
        from selenium.webdriver.support.ui import Select

        page.execute_script("player.setVisit(1)")
        ActionChains(page).move_to_element(page.find_element(By.CSS_SELECTOR, "canvas.strip")).click().perform()
        assert 0.2 < page.execute_script("return player.time / player.duration") < 0.8
        assert page.execute_script("return player.selected") >= 0
        for value in ("totals", "when"):
            Select(page.find_element(By.CSS_SELECTOR, "[data-look=strip]")).select_by_value(value)
        Select(page.find_element(By.CSS_SELECTOR, "[data-look=sort]")).select_by_value("time")
        Select(page.find_element(By.CSS_SELECTOR, "[data-look=palette]")).select_by_value("safe")
        for box in page.find_elements(By.CSS_SELECTOR, "[data-layer]"):
            box.click()
        self.wait(page, "!player.dirty")
        slider = page.find_element(By.ID, "scrub")
        page.execute_script("arguments[0].value = 500; arguments[0].oninput()", slider)
        assert page.execute_script("return player.time / player.duration") == pytest.approx(0.5)

    def test_drawn_pixels_move(self, page) -> None:
        shot = "return player.panes[0].view.canvas.toDataURL()"
        page.execute_script("player.setVisit(1)")
        self.wait(page, "!player.dirty")
        before = page.execute_script(shot)
        page.execute_script("player.seek(player.duration)")
        self.wait(page, "!player.dirty")
        assert page.execute_script(shot) != before

    def test_two_routers_side_by_side(self, browser, runs: dict[str, Path], tmp_path: Path) -> None:
        browser.get(view_field(list(runs.values()), tmp_path / "two.html").as_uri())
        browser.execute_script("player.setVisit(1); player.seek(player.duration)")
        self.wait(browser, "!player.dirty")
        durations = browser.execute_script("return player.panes.map((pane) => pane.route.duration)")
        assert browser.execute_script("return player.duration") == max(durations)
        titles = browser.execute_script("return [...document.querySelectorAll('.pane h2')].map((h) => h.textContent)")
        assert titles == ["simple-vector (simple-vector)", "coordinated (coordinated)"]
        assert browser.get_log("browser") == []

    def test_hostile_text_stays_text(self, browser, runs: dict[str, Path], visit: RoutedVisit, tmp_path: Path) -> None:
        (tmp_path / "hostile.html").write_text(hostile_page(runs, visit), encoding="utf-8")
        browser.get((tmp_path / "hostile.html").as_uri())
        browser.execute_script("player.select(1)")
        assert browser.title == HOSTILE
        assert HOSTILE in browser.execute_script("return document.getElementById('robot').textContent")
        assert browser.execute_script("return window.pwned") is None
        assert browser.get_log("browser") == []
