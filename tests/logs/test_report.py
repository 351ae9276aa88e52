"""The report: one page that says what happened, loads nothing, and keeps text text."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

import logs
from logs.errors import LogError
from logs.records import ApKpi, Kpi, RobotKpi
from logs.report import report_html, write_report
from logs.report_data import tell
from logs.report_words import duration, per_cent
from tests.logs.browser import CHROMIUM, chromium
from tests.logs.good_logs import POST_WORLD, heedless_plan, log_of
from tests.logs.tamper import forge, records

NASTY = '<script>alert(1)</script>" onload="x'
NASTY_WORLD = (
    POST_WORLD.replace('"r1"', "'" + NASTY + "'")
    .replace('"corner"', "'<img src=x onerror=alert(2)>'")
    .replace('name = "post"\nstory', "name = '</title><b>post'\nstory", 1)
)
VOID = {"meta", "link", "img"}


class Elements(HTMLParser):
    """Counts tags and keeps texts; complains where tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def page():
    """The report of the tutorial's run."""
    return report_html(logs.read(log_of()))


def test_it_is_one_page_that_loads_nothing(page):
    """Every picture is inside; there is no script, no link and no address of the network."""
    found = Elements(page)
    assert "script" not in found.tags
    addresses = [value for name, value in found.attributes if name in {"src", "href"}]
    assert len(addresses) >= 2
    assert all(value.startswith("data:") for value in addresses)
    assert not re.search(r"https?://|@import|url\((?!#)", page)
    assert "default-src 'none'" in page


def test_it_tells_what_the_key_figures_tell(page):
    """Arrivals, handovers and loads in the page are those of the records (page 5)."""
    text = " ".join(" ".join(Elements(page).text).split())
    told = records(log_of())
    kpi = [r for r in told if isinstance(r, Kpi)][-1]
    assert f"All {kpi.robots} robots reached their goals" in text
    assert f"There were {kpi.handovers} handovers" in text
    for record in told:
        if isinstance(record, ApKpi):
            assert (
                f"{record.ap} {record.capacity} {record.mean_load:.1f} {record.peak_load}" in text
            )
        if isinstance(record, RobotKpi):
            assert record.robot in text


def test_lost_time_in_the_bars_is_that_of_the_key_figures():
    """The spans without connection add up to each robot's outage_s."""
    run = logs.read(log_of(world=POST_WORLD))
    robots = tell(run).robots
    assert sum(r.kpi.outage_s for r in robots) > 0
    for robot in robots:
        lost = sum(span.end_s - span.begin_s for span in robot.lost)
        assert lost == pytest.approx(robot.kpi.outage_s, abs=0.45), robot.name
        assert all(a.end_s <= b.begin_s for a, b in zip(robot.spans, robot.spans[1:], strict=False))


def test_loads_in_the_chart_are_those_of_the_records():
    """The area of an AP's chart is its load over time, the dashed line its capacity."""
    from logs.charts import load_chart

    story = tell(logs.read(log_of()))
    for k, ap in enumerate(story.aps):
        chart = load_chart(ap, k, story.end.t_s, 5)
        boxes = re.findall(r"M(\S+) (\S+) V(\S+) H(\S+) V\S+ Z", chart.area)
        per_robot = (chart.bottom - chart.top) / (5 * 1.05)
        per_second = (chart.right - chart.left) / story.end.t_s
        drawn = sum((float(b) - float(a)) * (float(y) - float(t)) for a, y, t, b in boxes)
        ends = [t for t, *_ in ap.loads[1:]] + [story.end.t_s]
        real = sum((u - t) * load for (t, load, _), u in zip(ap.loads, ends, strict=True))
        assert drawn / per_robot / per_second == pytest.approx(real, rel=0.02)
        assert chart.over == ""


def test_overloads_collisions_and_failed_runs_are_told():
    """A run that failed says so on top, with what was hit and which AP was overloaded."""
    options = (("radio.ap_capacity", 1), ("run.interruption", 900.0))
    text = report_html(logs.read(log_of(options, heedless_plan)))
    plain = " ".join("".join(Elements(text).text).split())
    assert "✗ Failed" in plain
    assert "Access points served more robots than they can" in plain
    assert "access point overloaded" in plain
    assert "url(#over" in text


def test_names_stay_text():
    """A robot, an AP and a world named as HTML are shown as they are called, never obeyed."""
    run = logs.read(log_of(world=NASTY_WORLD))
    assert NASTY in run.problem.robot_ids
    page = report_html(run)
    found = Elements(page)
    assert "script" not in found.tags
    assert "b" not in found.tags
    assert not [name for name, _ in found.attributes if name.startswith("on")]
    assert any(NASTY in text for text in found.text)


def test_same_log_gives_the_same_page(page, tmp_path):
    """No date and no path of this machine enters."""
    write_report(logs.read(log_of()), tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == page


def test_a_log_without_its_end_is_refused(tmp_path):
    """Records that do not tell how the run ended make no report, and one sentence says so."""
    cut = forge(log_of(), tmp_path / "f.mcap", record=lambda r: None if isinstance(r, Kpi) else r)
    with pytest.raises(LogError, match="does not tell how its run ended"):
        write_report(logs.read(cut), tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_figures_that_are_no_numbers_are_told_as_a_dash(tmp_path):
    """NaN and infinity in a forged log do not break the page."""

    def worse(record):
        if isinstance(record, RobotKpi):
            return replace(record, outage_s=float("nan"), worst_outage_s=float("inf"))
        return replace(record, peak_load_share=float("nan")) if isinstance(record, Kpi) else record

    Elements(report_html(logs.read(forge(log_of(), tmp_path / "f.mcap", record=worse))))


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.0, "0 s"),
        (3.25, "3.2 s"),
        (99.0, "99 s"),
        (250.0, "4 min 10 s"),
        (3900.0, "1 h 05 min"),
        (None, "–"),
        (float("nan"), "–"),
    ],
)
def test_durations_read_as_people_say_them(seconds, words):
    """Seconds, minutes, hours."""
    assert duration(seconds) == words


def test_shares_are_never_rounded_to_all_or_nothing():
    """99.99 % is not 100 %, and a little is not nothing."""
    assert [per_cent(s) for s in (1.0, 0.99999, 0.5, 0.00001, 0.0)] == [
        "100.0 %",
        "99.9 %",
        "50.0 %",
        "0.1 %",
        "0.0 %",
    ]


def test_a_browser_shows_it_without_errors_or_requests(tmp_path):
    """No console message, no request but the file itself, no scrolling sideways at 1280 px."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    path = tmp_path / "run.html"
    write_report(logs.read(log_of(world=NASTY_WORLD)), path)
    with chromium(1280) as page:
        page.open(path)
        assert page.console == []
        assert [r for r in page.requests if not r.startswith("data:")] == [path.as_uri()]
        assert page.value("document.documentElement.scrollWidth") <= 1280
        assert page.value("[...document.images].every(i => i.naturalWidth > 100)")
        assert page.value("document.scripts.length") == 0
