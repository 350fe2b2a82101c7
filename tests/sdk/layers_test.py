#!/usr/bin/env python3
"""Who may include whom (architecture 3): reads every #include of the tree.

    layers_test.py SOURCE_DIR

Exit code 1 and one line for each include that points the wrong way.
"""
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


def main():
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    problems, seen = wrong_includes(pathlib.Path(sys.argv[1]))
    for problem in problems:
        print(problem)
    if seen < 500:
        print("only %d includes found: this is not the source tree" % seen)
        return 1
    print("%d includes, %d wrong" % (seen, len(problems)))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
