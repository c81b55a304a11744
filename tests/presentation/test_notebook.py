"""What a notebook shows: pages that are whole, of every part; and what `print` shows, in ten lines."""

import base64
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.definitions.value import COLUMNS, LINES, Printed
from holdfast.scenario.files import scenario_names

FEW = ("berth-kernel", "ch6-corridor", "ferry-tacks", "inspection", "late-propellers", "ch4-car")


class Page(HTMLParser):
    """The tags of a page, each of which is closed, and its text."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text, self.images, self.texts = [], [], "", [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        self.texts.append(data)


def printed(scenario):
    return [scenario, *(p for p in vars(scenario).values() if isinstance(p, Printed))]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.few(*FEW)
@pytest.mark.parametrize("name", scenario_names())
def test_every_part_of_a_scenario_is_printed_in_ten_lines_and_has_a_page(name):
    for part in printed(hf.load_scenario(name)):
        lines = str(part).splitlines()
        assert 1 <= len(lines) <= LINES
        assert max(map(len, lines[1:]), default=0) <= COLUMNS + 2
        page = Page(part._repr_html_())
        assert part.name in page.text


def test_a_page_of_a_system_has_its_equations_its_sets_and_its_parameters():
    system = hf.systems.marine_vehicle()
    page = Page(system._repr_html_())
    assert page.tags.count("math") == 2 * len(system.states) + len(system.parameters)
    assert "|(Vx, Vy)| <= current_limit m/s" in page.text
    assert all(q.description in page.text for q in system.parameters)
    assert str(system).splitlines()[1] == "  x' = Vx + u*cos(psi) - v*sin(psi)"


def test_pages_of_laws_and_regions_have_their_expressions():
    scenario = hf.load_scenario("ferry-tacks")
    page = Page(scenario.law._repr_html_())
    assert "as soon as" in page.text
    assert all(f"mode {name}" in page.texts for name in ("left", "right"))
    region = Page(scenario.region._repr_html_())
    assert region.text.count("\u2264") == len(scenario.region.inequalities)


def test_a_formula_that_nobody_reads_is_text():
    x = hf.symbol("x")
    states = (hf.Quantity("x", "rad"),)
    law = hf.Law("long", states, {"u": sp.Add(*(sp.sin(k * x) for k in range(1, 60)))})
    assert "<code" in law._repr_html_()
    assert "<code" not in replace(law, outputs={"u": sp.sin(x)})._repr_html_()
    assert "..." in str(law)


def test_names_and_texts_are_no_tags():
    states = (hf.Quantity("x", "m"),)
    law = hf.Law("a <b> & c", states, {"<u>": hf.symbol("x")}, description="<script>")
    wall = hf.Inequality("<i>", hf.symbol("x"), "<b>")
    page = Page(hf.Region("r", states, (wall,), empirical="no unit")._repr_html_())
    assert {"<i>", "<b>"} <= {text.strip() for text in page.texts}
    assert not {"i", "b"} & set(page.tags[2:])
    page = Page(law._repr_html_())
    assert "a <b> & c" in page.text
    assert "script" not in page.tags


def picture(page):
    (image,) = page.images
    kind, _, data = image["src"].partition(",")
    assert kind == "data:image/png;base64"
    assert base64.b64decode(data).startswith(b"\x89PNG")
    return image["alt"]


def test_pages_of_runs_and_of_a_kernel_have_a_figure():
    runs = hf.load_scenario("ch2-unicycle", ["starts.random=3"]).run()
    page = Page(runs._repr_html_())
    assert picture(page) == "paths of the runs, by their outcome"
    assert "reached goal" in page.text
    kernel = hf.load_scenario("berth-kernel", ["grid.nodes=41"]).run()
    page = Page(kernel._repr_html_())
    assert picture(page) == "slices of the set"
    assert "41 x 41" in page.text


def test_runs_without_a_plane_are_shown_as_text():
    x, states = hf.symbol("q"), (hf.Quantity("q", "m"),)
    system = hf.System(
        "line", states, (hf.Quantity("u", "m/s"),), {"q": hf.symbol("u")},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    runs = hf.simulate(system, hf.Law("home", states, {"u": -1.0 * x}), starts=[[1.0]], horizon=1.0)
    page = Page(runs._repr_html_())
    assert page.images == []
    assert "line" in page.text
