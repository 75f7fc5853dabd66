"""What import-linter does not say of a source tree: private names, sizes, doubled names."""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import grimp


def modules_of(root: Path, packages: Iterable[str]) -> dict[str, Path]:
    """File of each module by its full name; a package has the name of its folder."""
    files: dict[str, Path] = {}
    for package in packages:
        for file in sorted((root / package).rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return files


def private_uses(files: Mapping[str, Path]) -> list[str]:
    """Names and modules with a leading underscore that other modules of the tree import or read."""
    wrong = []
    for module, file in files.items():
        tree = ast.parse(file.read_text())
        bound = set()
        for line, target, alias in _imports(module, file, tree):
            own_module = target in files
            if not own_module and target.rpartition(".")[0] not in files:
                continue
            if any(map(_private, target.split("."))):
                wrong.append(f"{module}:{line} imports {target}")
            if own_module:
                bound.add(alias)
        wrong += [
            f"{module}:{node.lineno} reads {node.value.id}.{node.attr}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in bound
            and _private(node.attr)
        ]
    return wrong


def fragments(files: Mapping[str, Path], graph: grimp.ImportGraph, fewest: int) -> list[str]:
    """Modules of fewer lines than `fewest` that one module imports: they belong in it."""
    return [
        f"{module}: {lines} lines, imported by {next(iter(importers))} alone"
        for module, file in files.items()
        if file.name != "__init__.py"
        and (lines := len(file.read_text().splitlines())) < fewest
        and len(importers := graph.find_modules_that_directly_import(module)) == 1
    ]


def long_modules(files: Mapping[str, Path], most: int) -> list[str]:
    """Modules of more lines than `most`."""
    counted = {module: len(file.read_text().splitlines()) for module, file in files.items()}
    return [f"{module}: {lines} lines" for module, lines in counted.items() if lines > most]


def shared_names(root: Path, folder: str) -> list[str]:
    """Names of test modules and rigs that are there twice below a folder that is no package."""
    places = defaultdict(list)
    for file in sorted((root / folder).rglob("*.py")):
        if file.stem != "conftest":
            places[file.stem].append(str(file.relative_to(root)))
    return [f"{name}: {', '.join(found)}" for name, found in places.items() if len(found) > 1]


def untyped_packages(root: Path, packages: Iterable[str]) -> list[str]:
    """Packages without the marker of PEP 561."""
    return [f"{p} has no py.typed" for p in packages if not (root / p / "py.typed").is_file()]


def _imports(module: str, file: Path, tree: ast.AST) -> Iterator[tuple[int, str, str]]:
    """Line, full name and local name of everything that a module imports."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, alias.asname or alias.name
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = parts[: len(parts) + 1 - node.level] if node.level else []
            for alias in node.names:
                name = ".".join([*base, *filter(None, [node.module]), alias.name])
                yield node.lineno, name, alias.asname or alias.name


def _private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")
