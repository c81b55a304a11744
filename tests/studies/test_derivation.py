"""`holdfast explain`: the whole derivation, for the catalogue and for a user's TOML file."""

import re

import pytest

import holdfast as hf
from holdfast.maths.catalogue.signature import example
from holdfast.scenario.files import load_system
from tests.command_line import called


def run(*arguments, cwd="."):
    return called("explain", *arguments, cwd=cwd)


SYSTEMS = [
    *(example(f) for f in hf.systems.ALL),
    hf.systems.tractor_trailer(2),
    hf.systems.chained_form(7),
]


EXPLAINED = {}


def explained(system):
    """The derivation of one of these systems, which is made once."""
    if id(system) not in EXPLAINED:
        EXPLAINED[id(system)] = hf.explain(system)
    return EXPLAINED[id(system)]


@pytest.mark.few(
    "unicycle-like marine vehicle in a current, kinematics only",
    "wheeled robot whose wheels slip along and across themselves, and in turns",
    "Brockett's nonholonomic double integrator",
    "wheeled robot that follows another, seen from the leader",
)
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.description)
def test_every_system_of_the_catalogue_is_explained_in_nine_steps(system):
    derived = explained(system)
    text, latex, page = derived.text(), derived.latex(), derived.markdown()
    assert derived.steps[0].title == "The constraint"
    assert text.count("\n") > 50
    assert max(len(line) for line in text.splitlines()) < 130
    assert len(re.findall(r"^## \d\. ", page, re.M)) == len(derived.steps) == 9
    assert latex.count("\\begin{equation*}") == latex.count("\\end{equation*}") > 5
    assert latex.endswith("\\end{document}")
    for formula in re.findall(r"^\$\$ (.*) \$\$$", page, re.M):
        assert formula.count("{") == formula.count("}")
        assert formula.count("\\left") == formula.count("\\right")
        assert "1.0e-60" not in formula


@pytest.mark.few(
    "unicycle-Use the law `follow_field`: it is global.",
    "chained_form-Use the law `steer_by_chained_form`.",
    "nonholonomic_integrator-steer_integrator, follow_integrator",
)
@pytest.mark.parametrize(
    ("system", "advice"),
    [
        (hf.systems.unicycle(), "Use the law `follow_field`: it is global."),
        (hf.systems.car(), "Use the law `steer_by_chained_form`."),
        (hf.systems.chained_form(3), "Use the law `steer_by_chained_form`."),
        (hf.systems.front_axle_car(), "Use the law `steer_by_chained_form`."),
        (hf.systems.tractor_trailer(1, hitch_1=0.2), "Use the law `steer_by_chained_form`."),
        (hf.systems.tractor_trailer(2, hitch_1=0.2), "No law is derived"),
        (hf.systems.nonholonomic_integrator(), "steer_integrator, follow_integrator"),
        (hf.systems.marine_vehicle(), "dock_marine, project_marine"),
    ],
    ids=lambda v: v.name if isinstance(v, hf.System) else None,
)
def test_advice_names_a_law_that_can_be_used(system, advice):
    assert advice in " ".join(hf.explain(system).text().split())


@pytest.mark.few(
    "car-like robot, by the middle of its rear axle",
    "wheeled robot that follows another, seen from the leader",
    "wheeled robots in a row; each sees the one before it",
)
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.description)
def test_laws_that_are_named_can_be_simulated(system):
    text = " ".join(explained(system).text().split())
    listed = re.search(r"made for this system: ([\w, ]+)\.", text)
    named = re.findall(r"Use the law `(\w+)`", text) + (listed[1].split(", ") if listed else [])
    for name in named:
        law = getattr(hf.laws, name)(system)
        if set(law.output_names) != set(system.input_names):
            law = hf.track_velocity(system, law, dict.fromkeys(law.output_names, 5.0))
        start = [[0.9] * len(system.states)]
        result = hf.simulate(system, law, starts=start, horizon=0.1, record_every=0.1)
        assert result.outcomes["stayed"] == 1
    assert "face_target" not in text or {"u", "r"} <= {*system.state_names, *system.input_names}


def test_description_from_a_file_cannot_command_tex(tmp_path):
    path = tmp_path / "sled.toml"
    path.write_text(
        ROWS_ALONE.replace("[system]", '[system]\ndescription = "\\\\input{/etc/x} $x$ ~"')
    )
    shown = hf.explain(load_system(str(path))).latex()
    assert "\\textbackslash{}input\\{/etc/x\\} \\$x\\$ \\textasciitilde{}" in shown


def test_letters_of_the_derivation_avoid_those_of_the_system(tmp_path):
    path = tmp_path / "chain.toml"
    path.write_text(
        "[system]\nstates = { z1 = {}, z2 = {}, w3 = {} }\ninputs = { v1 = {}, v2 = {} }\n"
        'rates = { z1 = "v1", z2 = "v2", w3 = "z2*v1" }\n'
    )
    text = " ".join(hf.explain(load_system(str(path))).text().split())
    assert "zeta1' = nu1" in text
    assert "zeta1 = z1" in text


def test_relative_degree_counts_how_often_an_output_is_differentiated():
    text = hf.explain(hf.systems.tractor_trailer(2)).text()
    assert "h_1: 2, h_2: 2, h_3: 1" in text
    assert "h_1: 1, h_2: 2" in hf.explain(hf.systems.chained_form(4)).text()


def test_choice_of_the_moment_is_reported_and_taken():
    ndi = hf.systems.nonholonomic_integrator()
    assert "The designer chooses p" in hf.explain(ndi).text()
    given = hf.explain(ndi, [0, 1, 0])
    assert "p is the one given" in given.text()
    assert given.structure.moment == (0, 1, 0)


UNICYCLE_IN_A_CURRENT = """
[system]
name = "boat"
states = { x = { unit = "m" }, y = { unit = "m" }, psi = { unit = "rad", angle = true } }
inputs = { u = { unit = "m/s" }, r = { unit = "rad/s" } }
disturbances = { Vx = { unit = "m/s", role = "current" }, Vy = { unit = "m/s", role = "current" } }
rates = { x = "u*cos(psi) + Vx", y = "u*sin(psi) + Vy", psi = "r" }
[[system.pfaffian]]
coefficients = { x = "-sin(psi)", y = "cos(psi)" }
rhs = "Vy*cos(psi) - Vx*sin(psi)"
"""

ROWS_ALONE = """
[system]
name = "sled"
states = { x = { unit = "m" }, y = { unit = "m" }, psi = { unit = "rad", angle = true } }
[[system.pfaffian]]
coefficients = { x = "-sin(psi)", y = "cos(psi)" }
"""


def test_system_written_in_toml_is_explained(tmp_path):
    path = tmp_path / "boat.toml"
    path.write_text(UNICYCLE_IN_A_CURRENT)
    answer = run(path)
    assert answer.returncode == 0, answer.stderr
    assert "Acatastatic" in answer.stdout
    assert "u = -Vx⋅cos(ψ) - Vy⋅sin(ψ)" in answer.stdout
    assert "moves the system across F" in " ".join(answer.stdout.split())


def test_constraint_alone_is_explained_and_steered(tmp_path):
    path = tmp_path / "sled.toml"
    path.write_text(ROWS_ALONE)
    assert "w1 = motion_along" in run(path).stdout
    path.write_text(
        ROWS_ALONE
        + '[scenario]\ntitle = "sled"\n[law]\nname = "follow_field"\n[goal]\nname = "near_origin"\n'
        "[starts]\nrandom = 40\nevery = [-1, 1]\n[run]\nhorizon = 20\n"
    )
    assert hf.load_scenario(str(path)).run().success_fraction == 1.0


def test_shipped_scenarios_with_a_constraint_are_explained():
    for name in ("wheeled_camera", "ch4-trailer", "inspection"):
        assert hf.explain(load_system(name)).steps


def test_page_is_written_whole_and_latex_is_printed(tmp_path):
    answer = run("car", "--markdown", tmp_path / "new" / "car.md", "--set", "wheelbase=0.3")
    assert answer.returncode == 0
    assert "written: " in answer.stdout
    assert (tmp_path / "new" / "car.md").read_text("utf-8").startswith("# car: ")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["car.md"]
    assert run("unicycle", "--latex").stdout.startswith("\\documentclass")


HOLONOMIC = ROWS_ALONE.replace('"-sin(psi)", y = "cos(psi)"', '"1 + x", y = "y"')


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["unicicle"], "did you mean 'unicycle'?"),
        (["missing.toml"], "missing.toml: cannot be read"),
        (["tractor_trailer", "--set", "trailers=7"], "expected a whole number from 1 to 3"),
        (["tractor_trailer", "--set", "wheels=7"], "'tractor_trailer' has no such parameter"),
        (["tractor_trailer", "--set", "nonsense"], "expected key=value"),
        (["nonholonomic_integrator", "--moment", "0,0,1"], "A(0) p = 0"),
        (["nonholonomic_integrator", "--moment", "a,b"], "expected numbers, such as 1,0,0"),
        (["nonholonomic_integrator", "--moment", "nan,0,0"], "moment p"),
        (["unicycle", "--moment", "1,0,0"], "3 components; expected 2"),
        (["tractor_trailer", "--set", "trailers=3", "--limit", "0.1"], "longer than 0.1 s; allow"),
        (["unicycle", "--limit", "-1"], "Invalid value"),
        (["unicycle", "--limit", "inf"], "Invalid value"),
        (["unicycle", "--limit", "nan"], "nan is not a number"),
        (["unicycle", "--markdown", "/proc/none/page.md"], "choose another with --markdown"),
        (["holonomic.toml"], "1 of its 1 constraints can be integrated (row 1 on its own)"),
        (["empty.toml"], "no table [system]"),
        (["free.toml"], "no Pfaffian constraint"),
    ],
)
def test_bad_questions_are_answered_with_the_reason(arguments, complaint, tmp_path):
    (tmp_path / "holonomic.toml").write_text(HOLONOMIC)
    (tmp_path / "empty.toml").write_text("[other]\n")
    (tmp_path / "free.toml").write_text(
        '[system]\nstates = { x = {} }\ninputs = { u = {} }\nrates = { x = "u" }\n'
    )
    answer = run(*arguments, cwd=tmp_path)
    assert answer.returncode == 2
    assert complaint in answer.stderr
    assert "Traceback" not in answer.stderr
    assert answer.stdout == ""
