"""The simulator as an application: driven as a person would, and refusing what it must."""

import json
import multiprocessing
import socket
import threading
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from survey_sim.errors import InputError
from tests.test_field import field, instrument, xml  # noqa: F401 - fixtures
from tests.test_player import browser  # noqa: F401 - fixture

uvicorn = pytest.importorskip("uvicorn")
pytest.importorskip("multipart")

from survey_sim.survey.window.app import HOST, make_app  # noqa: E402
from survey_sim.survey.window.jobs import Wish  # noqa: E402


@pytest.fixture(scope="module")
def address(field: Path) -> Iterator[str]:  # noqa: F811 - the fixture
    """The window, offering a run folder."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    server = uvicorn.Server(uvicorn.Config(make_app([field]), host=HOST, port=port, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.02)
    yield f"http://{HOST}:{port}"
    server.should_exit = True
    thread.join(timeout=10)


def send(address: str, fields: dict[str, str], files: list[Path], headers: dict[str, str] | None = None) -> tuple[int, dict]:
    """Post the form as a browser does."""
    boundary = "----boundary"
    parts = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n'.encode() for k, v in fields.items()
    ]
    for path in files:
        head = f'--{boundary}\r\nContent-Disposition: form-data; name="files"; filename="{path.name}"\r\n\r\n'
        parts.append(head.encode() + path.read_bytes() + b"\r\n")
    body = b"".join(parts) + f"--{boundary}--\r\n".encode()
    content = {"Content-Type": f"multipart/form-data; boundary={boundary}", **(headers or {})}
    return ask(urllib.request.Request(f"{address}/jobs", body, content))


def ask(request: urllib.request.Request | str) -> tuple[int, dict]:
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as refusal:
        text = refusal.read()
        return refusal.code, json.loads(text) if text.startswith(b"{") else {}


def cancel(address: str, job: int, headers: dict[str, str] | None = None) -> tuple[int, dict]:
    return ask(urllib.request.Request(f"{address}/jobs/{job}/cancel", b"", headers or {}))


def finish(address: str, job: int) -> dict:
    for _ in range(1200):
        _, report = ask(f"{address}/jobs/{job}")
        if report["state"] in {"done", "failed", "cancelled"}:
            return report
        time.sleep(0.05)
    raise AssertionError(report)


class TestAnswers:
    def test_allocations_are_routed_and_played(self, address: str, field: Path) -> None:  # noqa: F811
        status, report = send(address, {"source": "allocation", "router": "simple-vector"}, xml(field, "allocation"))
        assert status == 200
        assert finish(address, report["job"]) | {"findings": []} == {**report, "state": "done", "stage": "done"}
        with urllib.request.urlopen(f"{address}/jobs/{report['job']}/run.zip") as answer:
            names = zipfile.ZipFile(BytesIO(answer.read())).namelist()
        assert {"run.json", "paths.csv", "xml/router_0002.xml", "legs/field-00000.parquet"} <= set(names)

    def test_speeds_count(self, address: str, field: Path) -> None:  # noqa: F811
        fields = {"source": "allocation", "router": "simple-vector", "coarse_speed_mm_s": "4"}
        _, report = send(address, fields, xml(field, "allocation")[:1])
        assert finish(address, report["job"])["state"] == "done"
        with urllib.request.urlopen(f"{address}/jobs/{report['job']}/run.zip") as answer:
            packed = zipfile.ZipFile(BytesIO(answer.read()))
        fast = pl.read_csv(packed.read("paths.csv")).filter(path="start_to_target")["configuration_time_s"][0]
        slow = pl.read_parquet(field / "paths.parquet").filter(path="start_to_target", visit_id=0)["configuration_time_s"][0]
        assert fast < 0.75 * slow

    def test_faults_of_files_are_told(self, address: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        bad = tmp_path / "router_0000.xml"
        bad.write_bytes(xml(field, "router")[0].read_bytes()[:4000])
        _, report = send(address, {"source": "router"}, [bad])
        done = finish(address, report["job"])
        assert done["state"] == "failed"
        assert done["error"].startswith("router_0000.xml")
        assert "not well-formed" in done["error"]

    @pytest.mark.parametrize(
        ("fields", "match"),
        [
            ({"source": "nonsense"}, "source"),
            ({"source": "router", "coarse_speed_mm_s": "fast"}, "coarse_speed_mm_s"),
            ({"source": "router", "coarse_speed_mm_s": "-1"}, "coarse_speed_mm_s"),
            ({"source": "router", "offered": "7"}, "no such choice"),
            ({"source": "router", "command": "x"}, "unknown key"),
            ({"source": "router"}, "no file chosen"),
        ],
    )
    def test_wishes_are_checked(self, address: str, fields: dict[str, str], match: str) -> None:
        status, report = send(address, fields, [])
        assert status == 400
        assert match in report["error"]

    def test_only_this_machine_and_this_page(self, address: str, field: Path) -> None:  # noqa: F811
        files = xml(field, "router")[:1]
        assert send(address, {"source": "router"}, files, {"Origin": "http://elsewhere.example"})[0] == 403
        assert send(address, {"source": "router"}, files, {"Host": "elsewhere.example"})[0] == 400
        assert ask(f"{address}/jobs/999")[0] == 404
        assert ask(f"{address}/jobs/999/player")[0] == 404
        assert ask(f"{address}/../../etc/passwd")[0] == 404

    def test_names_of_uploads_do_no_harm(self, address: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        boundary = "b"
        head = f'--{boundary}\r\nContent-Disposition: form-data; name="source"\r\n\r\nrouter\r\n--{boundary}\r\n'
        head += 'Content-Disposition: form-data; name="files"; filename="../../../../tmp/evil.xml"\r\n\r\n'
        body = head.encode() + xml(field, "router")[0].read_bytes() + f"\r\n--{boundary}--\r\n".encode()
        request = urllib.request.Request(
            f"{address}/jobs", body, {"Content-Type": f"multipart/form-data; boundary={boundary}"}
        )
        _, report = ask(request)
        assert finish(address, report["job"])["state"] == "done"
        assert not Path("/tmp/evil.xml").exists()

    def test_a_job_can_be_cancelled_and_the_next_one_runs(self, address: str, field: Path, tmp_path: Path) -> None:  # noqa: F811
        many = tmp_path / "targets.csv"
        place = np.random.default_rng(5).uniform(-110, 110, (4000, 2))
        pl.DataFrame({"target_id": np.arange(4000), "x_mm": place[:, 0], "y_mm": place[:, 1]}).write_csv(many)
        wish = {"source": "targets", "instrument": "taipan-300", "visits": "50"}
        jobs = [send(address, wish, [many])[1]["job"] for _ in range(2)]
        while ask(f"{address}/jobs/{jobs[0]}")[1]["state"] == "waiting":
            time.sleep(0.02)
        assert cancel(address, jobs[0], {"Origin": "http://elsewhere.example"})[0] == 403
        assert [cancel(address, job)[1]["state"] for job in jobs] == ["cancelled"] * 2
        assert cancel(address, 999)[0] == 404
        _, after = send(address, {"source": "router"}, xml(field, "router"))
        assert finish(address, after["job"])["state"] == "done"
        assert ask(f"{address}/jobs/{jobs[0]}")[1]["stage"] == "cancelled"
        assert ask(f"{address}/jobs/{jobs[0]}/player")[0] == 404
        assert cancel(address, after["job"])[1]["state"] == "done"

    def test_a_killed_job_is_told_and_the_next_one_runs(self, address: str, field: Path) -> None:  # noqa: F811
        wish = {"source": "allocation", "router": "coordinated"}
        _, killed = send(address, wish, xml(field, "allocation"))
        while ask(f"{address}/jobs/{killed['job']}")[1]["state"] == "waiting":
            time.sleep(0.01)
        while not (children := multiprocessing.active_children()):
            time.sleep(0.01)
        children[0].kill()
        report = finish(address, killed["job"])
        if report["state"] == "failed":  # else it was done before the kill
            assert "was ended" in report["error"]
        _, after = send(address, {"source": "router"}, xml(field, "router"))
        assert finish(address, after["job"])["state"] == "done"

    def test_sources_must_be_there(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such file or folder"):
            make_app([tmp_path / "nothing"])

    def test_centre_needs_both(self) -> None:
        assert Wish(source="targets", centre_ra_deg=1.0).centre_deg is None
        assert Wish(source="targets", centre_ra_deg=1.0, centre_dec_deg=2.0).centre_deg == (1.0, 2.0)


class TestInBrowser:
    def wait(self, page, condition: str) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(page, 180).until(lambda _: page.execute_script(f"return {condition}"), condition)

    def test_from_targets_to_the_player(self, browser, address: str, tmp_path: Path) -> None:  # noqa: F811
        from selenium.webdriver.common.by import By
        from selenium.webdriver.support.ui import Select

        rng = np.random.default_rng(2)
        radius, angle = 160 * np.sqrt(rng.random(300)), rng.uniform(0, 2 * np.pi, 300)
        targets = {"target_id": np.arange(300), "x_mm": radius * np.cos(angle), "y_mm": radius * np.sin(angle)}
        pl.DataFrame(targets).write_csv(tmp_path / "targets.csv")
        browser.get(address)

        def choose(name: str, text: str) -> None:
            Select(browser.find_element(By.NAME, name)).select_by_visible_text(text)

        browser.find_element(By.ID, "files").send_keys(str(tmp_path / "targets.csv"))
        choose("algorithm", "cda-basic")
        choose("router", "simple-vector")
        browser.find_element(By.NAME, "visits").clear()
        browser.find_element(By.NAME, "visits").send_keys("2")
        Select(browser.find_element(By.ID, "path")).select_by_value("park_to_target")
        browser.find_element(By.ID, "run").click()
        self.wait(browser, "!document.getElementById('player').hidden || !document.getElementById('error').hidden")
        assert browser.find_element(By.ID, "error").text == ""
        browser.switch_to.frame("player")
        self.wait(browser, "window.player !== undefined")
        assert browser.execute_script("return [player.path, player.data.runs[0].visits.length]") == ["park_to_target", 2]
        browser.execute_script("player.toggle()")
        self.wait(browser, "player.time > 0")
        browser.switch_to.default_content()
        assert browser.find_element(By.ID, "zip").get_attribute("href").endswith("/run.zip")
        assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []

    def test_cancel(self, browser, address: str, tmp_path: Path) -> None:  # noqa: F811
        from selenium.webdriver.common.by import By

        place = np.random.default_rng(5).uniform(-110, 110, (4000, 2))
        targets = {"target_id": np.arange(4000), "x_mm": place[:, 0], "y_mm": place[:, 1]}
        pl.DataFrame(targets).write_csv(tmp_path / "targets.csv")
        browser.get(address)
        browser.find_element(By.ID, "files").send_keys(str(tmp_path / "targets.csv"))
        browser.find_element(By.ID, "run").click()
        self.wait(browser, "!document.getElementById('cancel').hidden")
        assert not browser.find_element(By.ID, "run").is_displayed()
        browser.find_element(By.ID, "cancel").click()
        self.wait(browser, "!document.getElementById('run').hidden")
        assert browser.find_element(By.ID, "status").text == "cancelled"
        assert browser.find_element(By.ID, "player").get_attribute("hidden")

    def test_offered_router_files_and_clear_errors(self, browser, address: str, tmp_path: Path) -> None:  # noqa: F811
        from selenium.webdriver.common.by import By
        from selenium.webdriver.support.ui import Select

        browser.get(address)
        Select(browser.find_element(By.ID, "source")).select_by_value("router")
        assert not browser.find_element(By.NAME, "algorithm").is_displayed()
        Select(browser.find_element(By.ID, "offered")).select_by_index(1)
        browser.find_element(By.ID, "run").click()
        self.wait(browser, "!document.getElementById('player').hidden || !document.getElementById('error').hidden")
        assert browser.find_element(By.ID, "error").text == ""
        Select(browser.find_element(By.ID, "offered")).select_by_index(0)
        hostile = tmp_path / "<img src=x onerror=pwned=1>.xml"
        hostile.write_text("<VOTABLE><RESOURCE/></VOTABLE>")
        browser.find_element(By.ID, "files").send_keys(str(hostile))
        browser.find_element(By.ID, "run").click()
        self.wait(browser, "!document.getElementById('error').hidden")
        assert "no TABLE named 'initial_positions'" in browser.find_element(By.ID, "error").text
        assert browser.execute_script("return window.pwned") is None
