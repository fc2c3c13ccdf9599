"""README, CONTRIBUTING and docs: every block of a page is run, in order, in an empty folder.

The language of a block says what is done with it:

    sh                    commands; they are run as printed, or as changed by REDUCED
    python                a program; it is run
    ANY title="FILE"      a file; it is written
    toml, yaml, json      a part of a file; it is parsed
    text                  the output of the commands above, or a drawing; compared with the actual output if all
                          commands ran as printed
"""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from fresh import ROOT, environment, prepared
from overpass import standing_in

from dafw.testing import CHECKS

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

MESH = "model.mesh.wall_size=60 model.mesh.far_size=90 model.mesh.across=1"
COARSE = f"cycles=1 members=3 pictures=false {MESH}"
BASIS = "model.wind.basis.directions=4 model.wind.basis.levels=1 model.wind.basis.modes=6 model.wind.basis.tolerance=1"
AHEAD = "forecast.every=1 forecast.horizon=2 'forecast.lead_times=[0,1,2]'"
FLAGSHIP = r"^dafw run(?!.*--cfg)(?!.*experiment=(?!enie2d|leak))(?!.*~experiment).*$"
BENCHMARKS = f"PYTHONPATH={ROOT} python -m benchmarks"
REDUCED = {
    r"^sh setup\.sh (?=dafw )": ("", "the clone is set up already; tests/test_setup_script.py does it anew"),
    r"^sh setup\.sh( test| COMMAND\.\.\.)?$": (f"sh {ROOT}/setup.sh --help", "the same, and no tests within tests"),
    r"^python3 dafw/": (f"python {ROOT}/dafw/", "the clone is elsewhere"),
    r"^mpirun -n \d+ (/usr/bin/time -v )?": (
        "",
        "tests/plugins/models/dispersion/test_mpi.py starts several processes",
    ),
    r"^(dafw plot .*)--times 30,60": (r"\1--times 0,1", "the run has one cycle"),
    r"executor\.workers=4": ("executor.workers=2", "CI has two cores"),
    r"^dafw run -m (?=hydra/launcher=cores hydra\.launcher\.n_jobs=4)": (
        "dafw run --cfg job ",
        "composed and shown: the command before it is the same with as many jobs as there are cores",
    ),
    r"^taskset -c \d+ ": ("", "a machine may have one core, or no taskset"),
    r"^dafw run -m (?=.*launcher=slurm)": ("dafw run --cfg all ", "no SLURM here: composed and shown"),
    r"(?<=--cfg (?:all|job))(.*)'seed=range.*'$": (r"\1", "what is only shown has no sweep"),
    r"^dafw run (?=.*executor\.address=)": ("dafw run --cfg job ", "no scheduler there: composed and shown"),
    r"policy\.theta=0\.0,0\.2,0\.3": ("policy.theta=0.0,0.2", "two values instead of three"),
    r"'seed=range\((\d+,)?\d{2,}\)'": ("seed=0,1", "two seeds instead of ten and more"),
    r"^dafw check --all$": ("dafw check enkf", "tests/authoring/test_built_in.py checks every plugin"),
    r"^dafw study tiny$": (
        "dafw study tiny cycles=5 --seeds 0-1",
        "two seeds instead of ten, five cycles instead of 40",
    ),
    r"^dafw study literal$": (
        f"dafw study literal {COARSE} {BASIS} --seeds 0 --configurations '*=0.2'",
        "one run with some 300 nodes, three members, one cycle, a basis of four winds",
    ),
    r"^dafw study recommended.*": (
        f"dafw study recommended {COARSE} {BASIS} members=4 --seeds 0 --configurations recommended",
        "one run with some 300 nodes, three members, one cycle, a basis of four winds",
    ),
    r"^dafw study filters$": (
        f"dafw study filters {COARSE} {BASIS} members=4 --seeds 300 --configurations true_wind,policy=route",
        "one run as above",
    ),
    r"^dafw study mismatch.*": (
        f"dafw study mismatch {COARSE} {BASIS} members=4 --seeds 200 --configurations amount_off",
        "one run and its floor as above",
    ),
    r"^dafw study ablation$": (
        f"dafw study ablation {COARSE} {BASIS} members=4 --seeds 400 --configurations horizon_12",
        "one run as above",
    ),
    r"^dafw study leak.*": (
        f"dafw study leak {COARSE} {BASIS} members=4 --seeds 0 --configurations place_known",
        "one run with some 300 nodes, four members, one cycle, a basis of four winds",
    ),
    r"^dafw study mine .*$": (rf"\g<0> {COARSE} {BASIS} --seeds 0", "one seed, and as above"),
    r"^dafw run .*experiment=mine .*$": (rf"\g<0> {COARSE} {BASIS}", "a coarse mesh, three members, one cycle"),
    r"^dafw study forecast( --seeds 600-619 .*)?$": (
        f"dafw study forecast {COARSE} {BASIS} {AHEAD} --seeds 600 --configurations drawn",
        "one run with some 300 nodes, three members, one cycle, one forecast of two seconds",
    ),
    r"^dafw run experiment=evacuation.*$": (
        rf"\g<0> {COARSE} {BASIS} {AHEAD}",
        "some 300 nodes, three members, one cycle, one forecast of two seconds",
    ),
    r"^dafw run forecast\.every=.*$": (
        rf"\g<0> {AHEAD}",
        "one forecast of two seconds; the mesh and the basis as in other studies",
    ),
    r"^dafw run experiment=leak.*$": (rf"\g<0> {BASIS}", "a basis of four winds"),
    r"^dafw study tiny --seeds .*": (
        r"dafw study tiny cycles=5 --seeds 0-1 --configurations 'etkf*'",
        "the folder has runs of five cycles",
    ),
    r"^dafw study (?!tiny cycles=5 --seeds 0-1$)(?!--list).*": (
        r"\g<0> --no-pictures --workers 1",
        "the first study draws them, and has two workers",
    ),
    r"^dafw run.* model\.wind\.solver=reduced.*$": (rf"\g<0> {BASIS}", "a basis of four winds"),
    r"^dafw run(?!.*--cfg)(?!.*experiment=)(?!.*~experiment)(?!.*solver=reduced).*$": (
        rf"\g<0> {BASIS}",
        "the default study: a basis of four winds",
    ),
    r"^dafw run (?=experiment=chilbolton)": ("dafw run --cfg job ", "the data are not shipped: composed and shown"),
    r"^dafw run (?=experiment=drone_log .*/data/)": ("dafw run --cfg job ", "the data are not shipped"),
    r"^dafw run experiment=drone_log (?!.*/data/).*$": (
        r"\g<0> model.moments=6 filter.sweeps=1 pictures=false",
        "few moments, few moves",
    ),
    r"python -m benchmarks\.chilbolton.*$": (f"{BENCHMARKS}.chilbolton --help", "the data are not shipped"),
    r"^dafw run (?=experiment=live .*source=mqtt)": ("dafw run --cfg job ", "no broker: composed and shown"),
    r"^(dafw simulate experiment=live .*) (\| dafw run experiment=live .*)$": (
        rf"\1 {COARSE} {BASIS} \2 {COARSE} {BASIS}",
        "some 300 nodes, three members, one cycle, a basis of four winds",
    ),
    r"^dafw run experiment=live (?!.*source=mqtt).*$": (rf"\g<0> {COARSE} {BASIS}", "the same"),
    r"^dafw run experiment=recorded.*$": (rf"\g<0> {COARSE} {BASIS}", "some 300 nodes, three members, one cycle"),
    FLAGSHIP: (rf"\g<0> {COARSE}", "some 300 nodes, three members, one cycle"),
    r"python -m benchmarks (?!.*(over_dapper|from_py))": (
        f"{BENCHMARKS} --list ",
        "the tests of the benchmarks run them in their short form; those of other sizes are the same code",
    ),
    r"python -m benchmarks\.kills.*$": (f"{BENCHMARKS}.kills --kills 1", "tests/test_kills.py kills more"),
    r"python -m benchmarks\.live_kills.*$": (f"{BENCHMARKS}.live_kills --kills 1", "tests/studies kill more"),
    r"python -m benchmarks\.live_memory$": (f"{BENCHMARKS}.live_memory --readings 2000", "a million take a minute"),
    r"(OMP_NUM_THREADS=1 )?python -m benchmarks\.live_load.*$": (
        f"{BENCHMARKS}.live_load --help",
        "needs a broker",
    ),
    r"(OMP_NUM_THREADS=1 )?python -m benchmarks\.live_err.*$": (f"{BENCHMARKS}.live_err --help", "takes minutes"),
    r"python -m benchmarks\.fuzz.*$": (f"{BENCHMARKS}.fuzz --cases 8", "tests/test_fuzz.py has more"),
    r"python -m benchmarks\.mismatch.*$": (
        f"{BENCHMARKS}.mismatch cycles=2 members=3 {MESH} {BASIS} --truths amount_off --seeds 1000",
        "one truth, one seed, two cycles, the mesh and the basis above",
    ),
    r"python -m benchmarks(?=\.curves)": (f"{BENCHMARKS}", "the benchmarks are in the clone"),
    r"--seeds 0 1 2 3 4": (f"--seeds 0 --cycles 1 {MESH} {BASIS}", "one seed, one cycle, the mesh and the basis above"),
    r"python -m benchmarks(?=\.growth)": (f"{BENCHMARKS}", "the benchmarks are in the clone"),
    r"--nodes 2\.5k .* --cycles 3": ("--nodes 2.5k --members 2 3 --cycles 1", "one mesh, small ensembles"),
    r"(?<=benchmarks\.growth).*$": (rf"\g<0> {MESH} {BASIS}", "the mesh and the basis above"),
}
"""Commands that would take long or that a test cannot run: what is run instead, and why."""

OMITTED = {
    r"^dafw simulate .* &$": "needs a broker, which tests/plugins/readings/test_live_mqtt.py has",
    r"^dafw site preview .* --serve$": "serves until Ctrl-C; tests/views/test_site_preview.py does it",
    r"^pip wheel |^pip install dist/": "tests/fresh.py does this without a registry",
    r"^uv pip compile ": "asks a package registry, and would write the lock file",
    r"l96\.etkf_over_dapper": "downloads DAPPER into an environment of its own",
    r"esmda\.difference_from_pyesmda": "downloads pyESMDA into an environment of its own",
}
"""Commands that are not run at all, and why."""

PROGRAMS = {
    "sys.argv[1:]": ('("60", "90", "0")', "its arguments: a coarse mesh, no draws"),
    "(0.0, 0.03, 5.0, 10.0, 17.0, 21.0, 25.0)": ("(0.0, 5.0)", "winds that are soon solved"),
    '"cycles=20"]': (f'*"{COARSE} {BASIS}".split()]', "the flagship, as above"),
}
"""What is run instead of parts of programs, and why."""

BLOCK = re.compile(r'^```(\w*)(?: title="([^"\n]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4,}(?:[A-Z_]+=\S+ )*(?:dafw|python3?|mpirun|taskset|uv|pip|pytest|sh) .*$", re.MULTILINE)
INLINE = re.compile(r"`(dafw run(?: [^`]*)?)`")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    line: int
    language: str
    title: str
    content: str


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(text.count("\n", 0, found.start()) + 1, *map(str, found.groups(""))) for found in BLOCK.finditer(text)
    ]


def commands(block: Block) -> list[str]:
    """Return the commands of a block, without comments, each on one line."""
    joined = re.sub(r"\\\n\s*", "", block.content)
    return [re.sub(r"(^|\s+)#\s.*$", "", line) for line in joined.splitlines() if line.strip()]


def reduced(command: str) -> str | None:
    """Return the command that is run instead of a command; None if none is."""
    if any(re.search(pattern, command) for pattern in OMITTED):
        return None
    for pattern, (instead, _) in REDUCED.items():
        command = re.sub(pattern, instead, command)
    return command


def reduced_program(program: str) -> str:
    """Return the program that is run instead of a program."""
    for part, (instead, _) in PROGRAMS.items():
        program = program.replace(part, instead)
    return program


@pytest.fixture(scope="module")
def variables(tmp_path_factory):
    """Yield the environment variables for all pages: one cache, so that a mesh is made once; no screen, no network."""
    with standing_in() as overpass:
        cache = str(tmp_path_factory.mktemp("cache"))
        yield {"DAFW_CACHE": cache, "MPLBACKEND": "Agg", "DAFW_OVERPASS": overpass.address}


def try_page(page: Path, folder: Path, variables: dict[str, str]) -> int:
    """Run the blocks of a page in an empty folder; return how many commands and programs there were.

    They are copies of a process that has imported the libraries (prepared.py); tests/test_acme.py and tests/commands
    start processes of their own, as users do.
    """
    programs = prepared()
    printed, count, literal = "", 0, True
    for number, block in enumerate(blocks(page)):
        place = f"{page.relative_to(ROOT)}, line {block.line}"
        words: list[str] = []
        size = 1
        if block.title:
            (folder / block.title).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.title).write_text(block.content)
        elif block.language == "sh":
            asked = commands(block)
            run = [instead for command in asked if (instead := reduced(command)) is not None]
            literal = literal and run == asked
            count += len(asked)
            words, size = ["sh", "-e", "-c", "\n".join(run)], len(run)
        elif block.language == "python":
            count += 1
            (folder / f"block_{number}.py").write_text(reduced_program(block.content))
            words = ["python", f"block_{number}.py"]
        elif block.language == "toml":
            tomllib.loads(block.content)
        elif block.language in ("yaml", "json"):
            yaml.safe_load(block.content)
        elif block.language != "text":
            raise AssertionError(f"{place}: nobody knows how to try a block of '{block.language}'")
        elif literal and printed:
            shown = [" ".join(line.split()) for line in printed.splitlines()]
            assert [line for line in block.content.splitlines() if " ".join(line.split()) not in shown] == [], place
        if words:
            done = environment().run(*words, cwd=folder, programs=programs, commands=size, **variables)
            assert done.returncode == 0, f"{place}\n{words[-1]}\n{done.stdout}\n{done.stderr}"
            printed += done.stdout
    return count


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_does_what_it_says(page, tmp_path, variables):
    try_page(page, tmp_path, variables)


def test_a_study_without_a_truth_is_a_short_script():
    (script,) = [block.content for block in blocks(ROOT / "docs" / "python.md") if "Listed(" in block.content]
    assert "arrives" in script and "truth" not in script
    assert len(script.splitlines()) <= 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_stand_in_blocks(page):
    fenced = BLOCK.sub("", page.read_text(encoding="utf-8"))
    assert "```" not in fenced and INDENTED.findall(fenced) == []


def test_every_exception_is_needed():
    asked = [
        command for page in PAGES for block in blocks(page) if block.language == "sh" for command in commands(block)
    ]
    programs = [block.content for page in PAGES for block in blocks(page) if block.language == "python"]
    assert all(any(part in program for program in programs) for part in PROGRAMS)
    for pattern in OMITTED:
        assert any(re.search(pattern, command) for command in asked), pattern
    left = [command for command in asked if reduced(command) is not None]
    for pattern, (instead, _) in REDUCED.items():
        assert any(re.search(pattern, command) for command in left), pattern
        left = [re.sub(pattern, instead, command) for command in left]


CHECK = """
import json
from itertools import islice
from dafw.core.composition import compose, single_runs, study_part
from dafw.core.experiment import study_from

for words in json.load(open("given.json")):
    for job in islice(single_runs(words), 3):
        study_from(study_part(compose(job)))
"""


def test_commands_in_sentences_are_right(tmp_path):
    found = [shlex.split(command)[2:] for page in PAGES for command in INLINE.findall(page.read_text(encoding="utf-8"))]
    whole = [
        words for words in found if words and not any(re.search(r"\.\.\.|[A-Z]{3,}|^-(?!m$)", word) for word in words)
    ]
    assert len(whole) > 3
    given = [[word for word in words if word != "-m"] for words in whole]
    (tmp_path / "check.py").write_text(CHECK)
    (tmp_path / "given.json").write_text(json.dumps(given))
    done = environment().run("python", "check.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_links_between_the_pages_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert target.startswith("https://") or (page.parent / target).exists(), f"{page}: {target}"


def test_the_page_on_conformance_has_every_check_with_its_reason():
    page = (ROOT / "docs" / "conformance.md").read_text()
    sections = re.findall(r"^### (\w+): (\w+)\n\n(.+)$", page, re.MULTILINE)
    expected = [(kind, name, check.reason) for kind, checks in CHECKS.items() for name, check in checks.items()]
    assert sections == expected
