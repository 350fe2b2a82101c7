"""Every sentence of docs/patterns.md names tests that exist, and each of them runs over every transport, or says why not.

sentences.txt holds the page's sentences in their order, each followed by indented lines with the tests that hold it, as
`Suite.Name`; and by `- REASON` where there is nothing that could be tested, or not over every transport. A sentence that
was changed, added or taken away is missing here until somebody has said which test holds it now. Two sections are this
list's own: "Not over every transport" gives the reason of a test, or of all those of its suite; "Defects" is what is
known to go wrong elsewhere.
"""
import re
import sys
from pathlib import Path


EXCUSES = "Not over every transport"


def sentences_of(page):
    """[(section, sentence)]: of paragraphs, items and table rows; code is left out."""
    found, section, block, in_code = [], "", [], False

    def end_block():
        text = " ".join(" ".join(block).split())
        block.clear()
        if text:
            found.extend((section, one) for one in re.split(r"(?<=\.)\s+(?=[*`A-Z])(?![*`]*[a-z]*\.\s)", text) if one)

    for line in page.splitlines():
        stripped = line.strip()
        if stripped.startswith("```"):
            end_block()
            in_code = not in_code
        elif in_code:
            continue
        elif stripped.startswith("#"):
            end_block()
            section = stripped.lstrip("# ")
        elif stripped.startswith("|"):
            end_block()
            if not re.fullmatch(r"[|\s:-]+", stripped):
                found.append((section, stripped))
        elif not stripped or re.match(r"- ", stripped):
            end_block()
            block.append(stripped.removeprefix("- "))
        else:
            block.append(stripped)
    end_block()
    return found


def read_list(text):
    """[(section, sentence, tests, reason)]"""
    entries, section = [], ""
    for line in text.splitlines():
        if line.startswith("# "):
            section = line[2:]
        elif line.startswith("  - ") and entries:
            entries[-1][3] = line[4:]
        elif line.startswith("  ") and entries:
            entries[-1][2].extend(line.split())
        elif line and not line.startswith("//"):
            entries.append([section, line, [], ""])
    return entries


def tests_of(folder):
    """{"Suite.Name": its suite runs over every transport}"""
    found = {}
    for directory in {source.parent for source in folder.rglob("*_test.cpp")}:
        text = "\n".join(source.read_text() for source in sorted(directory.glob("*_test.cpp")))
        over_all = set(re.findall(r"^FIONA_OVER_EVERY_(?:TRANSPORT|PLACE)\((\w+)\)", text, re.M))
        for suite, name in re.findall(r"^TEST(?:_P|_F)?\((\w+),\s*(\w+)\)", text, re.M):
            found[suite + "." + name] = found.get(suite + "." + name, False) or suite in over_all
    return found


def excuse_of(name, excused):
    """Under which name a test has a reason; None: it has none."""
    return next((one for one in (name, name.split(".")[0]) if one in excused), None)


def main(root):
    here = Path(__file__).parent
    wanted = sentences_of((root / "docs/patterns.md").read_text())
    entries = read_list((here / "sentences.txt").read_text())
    tests = tests_of(root / "tests")
    wrong = []
    excused = {name for section, name, _, reason in entries if section == EXCUSES and reason}
    entries = [entry for entry in entries if entry[0] != EXCUSES]
    listed = [(section, sentence) for section, sentence, _, _ in entries if section != "Defects"]
    wrong += ["no entry: [%s] %s" % one for one in wanted if one not in listed]
    wrong += ["not in docs/patterns.md: [%s] %s" % one for one in listed if one not in wanted]
    counts = {}
    for section, sentence, names, reason in entries:
        wrong += ["there is no test '%s': %s" % (name, sentence) for name in names if name not in tests]
        if not names and not reason:
            wrong.append("no test: " + sentence)
        elif section != "Defects" and not reason:
            few = [name for name in names if not tests.get(name) and excuse_of(name, excused) is None]
            if few:
                wrong.append("not over every transport, and no reason why not: %s: %s" % (" ".join(few), sentence))
        count = counts.setdefault(section, [0, 0, 0])
        count[0] += 1
        count[1] += bool(names) and all(tests.get(name) for name in names)
        count[2] += not names
    used = {excuse_of(name, excused) for _, _, names, _ in entries for name in names}
    wrong += ["no sentence needs the reason of " + one for one in sorted(excused - used)]
    print("%-26s%10s%18s%10s" % ("section", "sentences", "every transport", "no test"))
    for section, (all_, over_all, without) in counts.items():
        print("%-26s%10d%18d%10d" % (section, all_, over_all, without))
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong or not entries else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
