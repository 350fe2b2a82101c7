#!/usr/bin/env python3
"""Who may include whom (docs/architecture.md, Layers), and which plugins have nothing in common: reads every
#include of the tree, and what the plugins' CMakeLists.txt say is linked.

    layers_test.py SOURCE_DIR

Exit code 1 and one line for each include or link that points the wrong way.
"""
import itertools
import pathlib
import re
import sys

INCLUDE = re.compile(r'^\s*#\s*include\s+[<"]([^>"]+)[>"]', re.M)
SOURCES = {".cpp", ".hpp", ".h"}

# A layer may include its own headers, generated ones, and the public headers of the layers named here.
MAY_USE = {
    "sdk": set(),
    "marketplace": {"sdk"},
    "host": {"sdk", "marketplace"},
    "console": {"sdk", "marketplace"},
    "plugins": {"sdk"},
}

# A plugin that is judged by another one's world must not know how that is made: neither may reach anything of the
# other, and both only the libraries named here.
APART = {("building-simulator", "smart-bluetooth-localization"): {"building"}}
COMMAND = re.compile(r"\b(add_library|add_executable|fiona_add_plugin|target_link_libraries)\s*\(([^)]*)\)")
NO_TARGETS = {"PUBLIC", "PRIVATE", "INTERFACE", "STATIC", "SHARED", "MODULE", "OBJECT"}
PLUGIN_ARGUMENTS = {"SOURCES", "LIBRARIES", "MANIFEST", "README", "SHARE"}


def headers_of(root, layer):
    """Spelling -> layer-relative path of the headers that a layer has: public ones below include, private ones below src."""
    found = {}
    for path in (root / layer).rglob("*.hpp"):
        parts = path.relative_to(root / layer).parts
        for folder in ("include", "src"):
            if folder in parts:
                spelling = "/".join(parts[parts.index(folder) + 1:])
                found.setdefault(spelling, set()).add(folder)
    return found


def sources_of(root, layer):
    return sorted(p for p in (root / layer).rglob("*") if p.suffix in SOURCES)


def wrong_includes(root):
    headers = {layer: headers_of(root, layer) for layer in MAY_USE}
    problems = []
    seen = 0
    for layer, allowed in MAY_USE.items():
        for source in sources_of(root, layer):
            for spelling in INCLUDE.findall(source.read_text(encoding="utf-8")):
                seen += 1
                if spelling in headers[layer] or (source.parent / spelling).exists():
                    continue
                owners = [other for other in MAY_USE if spelling in headers[other]]
                for owner in owners:
                    private = headers[owner][spelling] == {"src"}
                    if owner not in allowed or private:
                        problems.append("%s includes %s, %s of %s" % (
                            source.relative_to(root), spelling, "a private header" if private else "a header", owner))
    return problems, seen


def without_comments(text):
    return re.sub(r"#[^\n]*", "", text)


def linked_targets(plugins):
    """Target -> what it links; target -> plugin folder that makes it."""
    links, owner = {}, {}
    for file in sorted(plugins.glob("*/CMakeLists.txt")):
        for command, arguments in COMMAND.findall(without_comments(file.read_text(encoding="utf-8"))):
            target, *words = arguments.split()
            if command != "target_link_libraries":
                owner[target] = file.parent.name
            if command == "target_link_libraries":
                links.setdefault(target, set()).update(word for word in words if word not in NO_TARGETS)
            if command == "fiona_add_plugin" and "LIBRARIES" in words:
                libraries = itertools.takewhile(lambda word: word not in PLUGIN_ARGUMENTS,
                                                words[words.index("LIBRARIES") + 1:])
                links.setdefault(target, set()).update(libraries)
    return links, owner


def folders_linked_by(plugin, links, owner):
    """The plugin folders that the targets of a plugin link, themselves or through others."""
    open_targets = [target for target, folder in owner.items() if folder == plugin]
    seen = set(open_targets)
    while open_targets:
        for linked in links.get(open_targets.pop(), ()):
            if linked in owner and linked not in seen:
                seen.add(linked)
                open_targets.append(linked)
    return {owner[target] for target in seen}


def folders_included_by(plugin, plugins):
    """The plugin folders whose headers the sources of a plugin include, themselves or through others. A spelling that
    several folders have counts for each of them, unless the including folder is one."""
    spellings = {}
    for header in plugins.glob("*/*/**/*.hpp"):
        folder, _, *spelling = header.relative_to(plugins).parts
        spellings.setdefault("/".join(spelling), set()).add(folder)
    reached, open_folders = {plugin}, [plugin]
    while open_folders:
        folder = open_folders.pop()
        for source in sources_of(plugins, folder):
            for spelling in INCLUDE.findall(source.read_text(encoding="utf-8")):
                beside = (source.parent / spelling).resolve()
                owners = {beside.relative_to(plugins).parts[0]} if beside.exists() else spellings.get(spelling, set())
                for owner in owners - reached if folder not in owners else ():
                    reached.add(owner)
                    open_folders.append(owner)
    return reached


def not_apart(root):
    plugins = (root / "plugins").resolve()
    links, owner = linked_targets(plugins)
    problems = []
    for pair, common in APART.items():
        reached = [folders_linked_by(plugin, links, owner) | folders_included_by(plugin, plugins) for plugin in pair]
        for plugin, folders in zip(pair, reached):
            if len(folders) < 2:
                problems.append("%s seems to use nothing: this test does not read its sources" % plugin)
        for plugin in sorted((reached[0] & reached[1]) - common):
            problems.append("%s and %s both use %s" % (*pair, plugin))
    return problems


def main():
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    problems, seen = wrong_includes(pathlib.Path(sys.argv[1]))
    problems += not_apart(pathlib.Path(sys.argv[1]))
    for problem in problems:
        print(problem)
    if seen < 500:
        print("only %d includes found: this is not the source tree" % seen)
        return 1
    print("%d includes, %d wrong" % (seen, len(problems)))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
