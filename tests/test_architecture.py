"""The rules of docs/architecture.md, checked on the source as it stands."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"

# From the ground up: a module imports only from its own room and from rooms earlier in this list.
ROOMS = [
    "experiment",
    "forward",
    "library",
    "surrogate",
    "inference",
    "robot",
    "terrain",
    "view",
    "cli",
    "terraphi_studies",
]
# Neighbours that stay strangers although the order of the list would let them meet.
STRANGERS = {
    "robot": {"forward", "library", "surrogate", "inference"},
    # A command finds the studies through their entry point.
    "terraphi_studies": {"cli"},
}
# The one module of a stranger's room that may know it: a footfall's φ needs a force law.
MAY_MEET = {"terraphi/robot/footfall_fit.py": {"forward"}}
# The public face and `python -m terraphi` may open every door; nobody may come in through them.
FACES = {"__init__", "__main__"}

MAX_FILE_LINES = 800
MAX_FUNCTION_LINES = 60
# "module.py:function": why it is better in one piece.
LONG_FUNCTIONS: dict[str, str] = {}

HEAVY = {"distributed", "emcee", "h5py", "matplotlib", "numba", "pandas", "scipy", "xarray"}

FILES = sorted(SOURCE.rglob("*.py"))
Function = ast.FunctionDef | ast.AsyncFunctionDef


def name_of(path: Path) -> str:
    return path.relative_to(SOURCE).as_posix()


def room_of(path: Path) -> str:
    package, *inside = path.relative_to(SOURCE).with_suffix("").parts
    return inside[0] if package == "terraphi" else package


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def is_module(dotted: str) -> bool:
    place = SOURCE.joinpath(*dotted.split("."))
    return place.is_dir() or place.with_suffix(".py").is_file()


def imported_rooms(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and room of every import of our own, wherever it stands; "" is the public face."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            dotted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            # `from terraphi import soil` enters a room; `from terraphi import Soil` the face.
            dotted = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in dotted:
            package, _, rest = name.partition(".")
            room = rest.partition(".")[0]
            if package == "terraphi":
                yield node.lineno, room if room and is_module(f"terraphi.{room}") else ""
            elif package == "terraphi_studies":
                yield node.lineno, package


def forbidden_imports(path: Path, tree: ast.AST) -> list[str]:
    room = room_of(path)
    if room in FACES:
        return []
    allowed = set(ROOMS[: ROOMS.index(room) + 1]) - STRANGERS.get(room, set())
    allowed |= MAY_MEET.get(name_of(path), set())
    return [
        f"{name_of(path)}:{line} imports {target or 'the public face'}"
        for line, target in imported_rooms(tree)
        if target not in allowed
    ]


def is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def arithmetic(tree: ast.AST) -> list[int]:
    """Lines that calculate; text joined with + and paths joined with / to a literal do not."""
    lines = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.BinOp | ast.AugAssign):
            continue
        if isinstance(node.op, ast.BitOr | ast.BitAnd | ast.BitXor):
            continue
        sides = [node.value] if isinstance(node, ast.AugAssign) else [node.left, node.right]
        joins = isinstance(node.op, ast.Add | ast.Div) and any(map(is_text, sides))
        if not joins:
            lines.append(node.lineno)
    return lines


def function_lines(node: Function) -> int:
    """Lines of a function less those of its docstring, which the house asks to be generous."""
    total = (node.end_lineno or node.lineno) - node.lineno + 1
    if ast.get_docstring(node, clean=False) is None:
        return total
    text = node.body[0]
    return total - ((text.end_lineno or text.lineno) - text.lineno + 1)


def long_functions() -> dict[str, int]:
    return {
        f"{name_of(path)}:{node.name}": function_lines(node)
        for path in FILES
        for node in ast.walk(parse(path))
        if isinstance(node, Function) and function_lines(node) > MAX_FUNCTION_LINES
    }


def test_every_module_lives_in_a_known_room() -> None:
    homeless = {room_of(path) for path in FILES} - set(ROOMS) - FACES
    assert not homeless, f"give {sorted(homeless)} a place in ROOMS and docs/architecture.md"


def test_every_room_is_in_the_picture() -> None:
    picture = (SOURCE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    absent = [room for room in ROOMS if f"  {room}/" not in picture and f"/{room}/" not in picture]
    assert not absent, f"docs/architecture.md does not show {absent}"


def test_every_module_is_in_the_picture() -> None:
    picture = (SOURCE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    names = {path.stem for path in FILES if path.name not in ("__init__.py", "__main__.py")}
    absent = sorted(name for name in names if name not in picture)
    assert not absent, f"docs/architecture.md does not name {absent}"


def at_import(body: list[ast.stmt]) -> Iterator[str]:
    """Modules that are imported when a module is: not inside functions, not for types alone."""
    for node in body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                dotted = f"{node.module}.{alias.name}"
                yield dotted if is_module(dotted) else node.module


def test_no_module_imports_itself_by_way_of_others() -> None:
    dotted = {".".join(p.relative_to(SOURCE).with_suffix("").parts): p for p in FILES}
    needs = {
        name.removesuffix(".__init__"): set(at_import(parse(path).body))
        for name, path in dotted.items()
    }
    graph = {name: found & needs.keys() - {name} for name, found in needs.items()}
    TopologicalSorter(graph).prepare()


def test_data_room_holds_no_code() -> None:
    for package in ("terraphi", "terraphi_studies"):
        assert not list((SOURCE / package / "data").rglob("*.py"))


def test_imports_only_from_rooms_above() -> None:
    assert [found for path in FILES for found in forbidden_imports(path, parse(path))] == []


def test_no_file_is_too_long() -> None:
    lines = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    too_long = {name: count for name, count in lines.items() if count > MAX_FILE_LINES}
    assert not too_long, f"over {MAX_FILE_LINES} lines, two ideas perhaps: {too_long}"


def test_functions_are_not_too_long() -> None:
    found = long_functions()
    too_long = {name: lines for name, lines in found.items() if name not in LONG_FUNCTIONS}
    assert not too_long, f"over {MAX_FUNCTION_LINES} lines: {too_long}"
    stale = set(LONG_FUNCTIONS) - set(found)
    assert not stale, f"no longer long, strike from LONG_FUNCTIONS: {sorted(stale)}"


def test_command_line_does_not_calculate() -> None:
    found = {
        name_of(path): lines
        for path in FILES
        if room_of(path) == "cli" and (lines := arithmetic(parse(path)))
    }
    assert not found, f"arithmetic on these lines belongs to a room above: {found}"


@pytest.mark.parametrize("module", ["terraphi", "terraphi.cli.main"])
def test_import_stays_light(module: str) -> None:
    code = f"import sys, {module}; print(*sorted({HEAVY!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize(
    ("words", "heavy"),
    [
        # Nothing that calculates, for what is asked of the command line itself.
        (["--help"], {*HEAVY, "numpy", "pydantic", "rich"}),
        (["study", "list"], HEAVY),
        # SciPy's splines bring its optimisers along; statistics and tables are nobody's business.
        (["invert", "li2013:yuma/straight"], {*HEAVY, "dask", "scipy.stats"} - {"h5py", "scipy"}),
    ],
    ids=["help", "study-list", "invert"],
)
def test_a_command_loads_only_what_it_needs(words: list[str], heavy: set[str]) -> None:
    code = (
        "import sys; from terraphi.cli.main import main\n"
        "try:\n    main()\n"
        f"finally:\n    print('loaded:', *sorted({heavy!r} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1].split() == ["loaded:"]


# The checks themselves, on small cases whose answer is known.


@pytest.mark.parametrize(
    ("file", "line", "fine"),
    [
        ("terraphi/forward/rft.py", "from terraphi.experiment.soil import Soil", True),
        ("terraphi/experiment/soil.py", "from terraphi.forward import rft", False),
        ("terraphi/forward/__init__.py", "from terraphi.forward import mpm", True),
        ("terraphi/forward/plane/solver.py", "import terraphi.library.store", False),
        ("terraphi/view/plots.py", "from terraphi import Soil", False),
        ("terraphi/robot/forces.py", "from terraphi.inference import posterior", False),
        ("terraphi/robot/forces.py", "from terraphi.forward import rft", False),
        ("terraphi/robot/footfall_fit.py", "from terraphi.forward import rft", True),
        ("terraphi/robot/forces.py", "def f():\n    import terraphi.inference.posterior", False),
        ("terraphi/view/plots.py", "from terraphi_studies import recovery", False),
        ("terraphi_studies/recovery.py", "from terraphi.view import plots", True),
        ("terraphi_studies/recovery.py", "from terraphi.cli import main", False),
        ("terraphi/__init__.py", "from terraphi.cli.main import main", True),
        ("terraphi/experiment/soil.py", "import terraphical", True),
    ],
)
def test_import_check_on_known_cases(
    file: str, line: str, fine: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms = {f"terraphi.{room}" for room in ROOMS}
    monkeypatch.setitem(globals(), "is_module", rooms.__contains__)
    assert (forbidden_imports(SOURCE / file, ast.parse(line)) == []) is fine


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("a + b", True),
        ("total += 1", True),
        ("a / b", True),
        ("folder / 'figure.png'", False),
        ("'phi = ' + text", False),
        ("value: int | None = -1", False),
        ("2 ** -k", True),
    ],
)
def test_arithmetic_check_on_known_cases(line: str, found: bool) -> None:
    assert bool(arithmetic(ast.parse(line))) is found


def test_function_length_leaves_out_the_docstring() -> None:
    tree = ast.parse('def f():\n    """One.\n\n    Two.\n    """\n    return 1\n')
    function = tree.body[0]
    assert isinstance(function, Function)
    assert function_lines(function) == 2
