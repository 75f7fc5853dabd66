"""A source tree as its rules see it: who imports what, what stands in which folder. By `ast` alone.

Every function takes the root of a tree and returns what is wrong with it, one sentence each.
"""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path


@dataclass(frozen=True)
class Import:
    """One name that one module imports.

    Attributes:
        source: The module that imports.
        target: The module that is imported, of the tree or of others.
        name: What is taken from it; "" for the module itself.
        line: In the source.
        inside: Whether it stands in a function.
    """

    source: str
    target: str
    name: str
    line: int
    inside: bool


@dataclass(frozen=True)
class Tree:
    """The modules of some packages.

    Attributes:
        files: File of each module by its full name; a package has the name of its folder.
        imports: In the order of modules and lines.
    """

    files: Mapping[str, Path]
    imports: tuple[Import, ...]

    @property
    def edges(self) -> dict[str, set[str]]:
        """Modules of the tree that each module imports."""
        found: dict[str, set[str]] = {name: set() for name in self.files}
        for i in self.imports:
            if i.target in self.files and i.target != i.source:
                found[i.source].add(i.target)
        return found

    def reached(self, modules: Iterable[str]) -> set[str]:
        """These modules and all of the tree that they import, directly or not."""
        edges, left, found = self.edges, list(modules), set[str]()
        while left:
            if (name := left.pop()) not in found:
                found.add(name)
                left += edges[name]
        return found


def read_tree(root: Path, packages: Iterable[str]) -> Tree:
    """Modules and imports of the packages below a root."""
    files: dict[str, Path] = {}
    for package in packages:
        for file in sorted((root / package).rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return Tree(files, tuple(i for name in files for i in _imports(name, files)))


def circles(tree: Tree) -> list[str]:
    """The first circle of imports, if there is one."""
    try:
        TopologicalSorter(tree.edges).prepare()
    except CycleError as error:
        return [" <- ".join(error.args[1])]
    return []


def upward_arrows(tree: Tree, layers: Sequence[Sequence[str]]) -> list[str]:
    """Imports of a layer above, and modules that import something but are in no layer."""
    rank = {name: i for i, layer in enumerate(layers) for name in layer}

    def layer_of(module: str) -> int | None:
        """Of its longest prefix."""
        while module and module not in rank:
            module = module.rpartition(".")[0]
        return rank.get(module)

    wrong = []
    for i in tree.imports:
        if i.target not in tree.files:
            continue
        if any(name.startswith(f"{i.target}.") for name in rank) and i.target not in rank:
            continue  # a package all of whose rooms are in layers of their own
        above, below = layer_of(i.source), layer_of(i.target)
        if above is None or below is None:
            wrong.append(f"{i.source if above is None else i.target} is in no layer")
        elif below > above:
            wrong.append(f"{i.source}:{i.line} imports {i.target}, which is above it")
    return sorted(set(wrong))


def imports_of(tree: Tree, target: str, *, outside: str = "", within: str = "") -> list[str]:
    """Imports of a package or what is in it.

    Args:
        tree: Where to look.
        target: The package.
        outside: Prefix of the modules that may import it; "" for none.
        within: Prefix of the modules that are looked at; "" for all.
    """
    return [
        f"{i.source}:{i.line} imports {i.target}"
        for i in tree.imports
        if _in(i.target, target)
        and _in(i.source, within)
        and not (outside and _in(i.source, outside))
    ]


def private_uses(tree: Tree) -> list[str]:
    """Names and modules with a leading underscore that other modules of the tree import or read."""
    wrong = [
        f"{i.source}:{i.line} imports {i.target}.{i.name}".rstrip(".")
        for i in tree.imports
        if i.target in tree.files
        and i.target != i.source
        and (_private(i.name) or any(map(_private, i.target.split("."))))
    ]
    for name, file in tree.files.items():
        bound = {
            i.name.partition(" as ")[2] or i.target.rpartition(".")[2]
            for i in tree.imports
            if i.source == name and i.target in tree.files and _module_itself(i)
        }
        wrong += [
            f"{name}:{node.lineno} reads {node.value.id}.{node.attr}"
            for node in ast.walk(ast.parse(file.read_text()))
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in bound
            and _private(node.attr)
        ]
    return wrong


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


def read_layers(document: str) -> list[list[str]]:
    """Layers of a document, bottom first: the block that begins with ```layers."""
    _, _, rest = document.partition("```layers\n")
    block, end, _ = rest.partition("```")
    assert end, "no block of layers"
    return [line.split() for line in block.splitlines() if line.strip()]


def _imports(module: str, files: Mapping[str, Path]) -> Iterator[Import]:
    """Imports of a module in the order of its lines, without those for type checkers."""
    file = files[module]
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node, inside in _statements(ast.parse(file.read_text()), False):
        if isinstance(node, ast.Import):
            for alias in node.names:
                name = f" as {alias.asname}" if alias.asname else ""
                yield Import(module, alias.name, name, node.lineno, inside)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[: len(package.split(".")) + 1 - node.level]
            base = ".".join([*(parts if node.level else []), *filter(None, [node.module])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                if full in files:
                    name = f" as {alias.asname}" if alias.asname else ""
                    yield Import(module, full, name, node.lineno, inside)
                else:
                    yield Import(module, base, alias.name, node.lineno, inside)
        elif isinstance(node, ast.Call) and _calls_import(node):
            (named, *_) = node.args
            if isinstance(named, ast.Constant) and isinstance(named.value, str):
                yield Import(module, named.value, "", node.lineno, inside)


def _statements(node: ast.AST, inside: bool) -> Iterator[tuple[ast.AST, bool]]:
    """Every node below, and whether it is in a function."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and _type_checking(child.test):
            for other in child.orelse:
                yield other, inside
                yield from _statements(other, inside)
            continue
        yield child, inside
        function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield from _statements(child, inside or function)


def _type_checking(test: ast.expr) -> bool:
    return ast.unparse(test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def _calls_import(node: ast.Call) -> bool:
    """`import_module("x")` and `__import__("x")`."""
    name = ast.unparse(node.func).rpartition(".")[2]
    return name in ("import_module", "__import__") and bool(node.args)


def _module_itself(i: Import) -> bool:
    return not i.name or i.name.startswith(" as ")


def _private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _in(module: str, package: str) -> bool:
    return not package or module == package or module.startswith(f"{package}.")
