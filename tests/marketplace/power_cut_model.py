"""What a power cut leaves of the files that a program has changed, from a recording of its calls.

A disk keeps what was synced: a file's content by fsync of the file, names by fsync of their directory. Of the rest it keeps
any part, in any order: each unsynced write and each unsynced change of a name is there or is not. A rename is one change of
names, also between two directories, as journals have it; nothing else is atomic.
"""
import copy
import os
import re

CALLS = "openat,openat2,mkdir,mkdirat,write,pwrite64,ftruncate,fsync,fdatasync,rename,renameat,renameat2,unlink,unlinkat,rmdir"
STRACE = ["strace", "-f", "-qq", "-y", "-xx", "-s", "16777216", "-e", "trace=" + CALLS]


def plain(text):
    """The bytes that strace has written as \\x41."""
    return bytes.fromhex(re.sub(r"\\x", "", text)) if text.startswith("\\x") else text.encode()


def name_of(text):
    return plain(text).decode("utf-8", "replace").removesuffix(" (deleted)")


class Node:
    def __init__(self, directory):
        self.directory = directory
        self.synced = b""     # content that is safe
        self.writes = []      # since then: (offset, bytes), or a new length
        self.entries = {}     # names that are safe
        self.now = {}         # as programs see them
        self.length = 0

    def content(self, keeps):
        data = bytearray(self.synced)
        for write in self.writes:
            if not keeps():
                continue
            if isinstance(write, int):
                del data[write:]
                continue
            offset, piece = write
            if len(data) < offset:
                data.extend(b"\0" * (offset - len(data)))
            data[offset:offset + len(piece)] = piece
        return bytes(data)


class Disk:
    """The directories below `roots`, followed call by call. `syncs`: whether fsync does anything."""

    def __init__(self, roots, syncs=True):
        self.roots, self.syncs = roots, syncs
        self.tops = {root: self.load(root) for root in roots}
        self.changes = []  # of names, unsynced: [(directory, name, node or None), …]

    def load(self, path):
        node = Node(os.path.isdir(path))
        if not node.directory:
            with open(path, "rb") as file:
                node.synced = file.read()
            node.length = len(node.synced)
        else:
            node.now = {name: self.load(os.path.join(path, name)) for name in os.listdir(path)}
            node.entries = dict(node.now)
        return node

    def find(self, path):
        for root, top in self.tops.items():
            if path != root and not path.startswith(root + "/"):
                continue
            node = top
            for part in path[len(root):].split("/"):
                if part and node is not None:
                    node = node.now.get(part)
            return node
        return None

    def change(self, *names):
        for directory, name, node in names:
            directory.now[name] = node
            if node is None:
                del directory.now[name]
        self.changes.append(list(names))

    def parent(self, path):
        return self.find(os.path.dirname(path)), os.path.basename(path)

    def make(self, path, directory):
        parent, name = self.parent(path)
        if parent is not None and name not in parent.now:
            self.change((parent, name, Node(directory)))

    def remove(self, path):
        parent, name = self.parent(path)
        if parent is not None and name in parent.now:
            self.change((parent, name, None))

    def rename(self, source, target):
        parent, name = self.parent(source)
        to, new_name = self.parent(target)
        if parent is not None and to is not None:
            node = parent.now[name]
            self.change((parent, name, None), (to, new_name, node))

    def write(self, path, data):
        node = self.find(path)
        if node is not None:
            node.writes.append((node.length, data))
            node.length += len(data)

    def truncate(self, path, length):
        node = self.find(path)
        if node is not None:
            node.writes.append(length)
            node.length = length

    def sync(self, path):
        node = self.find(path)
        if node is None or not self.syncs:
            return
        node.synced, node.writes = node.content(lambda: True), []
        waiting = [change for change in self.changes if any(directory is node for directory, _, _ in change)]
        for change in waiting:
            self.apply(change)
        self.changes = [change for change in self.changes if change not in waiting]

    @staticmethod
    def apply(change):
        for directory, name, node in change:
            directory.entries.pop(name, None)
            if node is not None:
                directory.entries[name] = node

    def leave(self, places, keeps_name, keeps_write):
        """Writes what a cut now leaves: each root into the place that is named for it."""
        left = copy.deepcopy((self.tops, self.changes))
        tops, changes = left
        for change in changes:
            if keeps_name():
                self.apply(change)
        for root, place in places.items():
            self.put(tops[root], place, keeps_write)

    def put(self, node, path, keeps):
        if not node.directory:
            with open(path, "wb") as file:
                file.write(node.content(keeps))
            return
        os.makedirs(path, exist_ok=True)
        for name, child in node.entries.items():
            self.put(child, os.path.join(path, name), keeps)


def recorded(trace):
    """The calls of a recording that have succeeded, as (method of Disk, arguments)."""
    calls, unfinished = [], {}
    with open(trace, encoding="latin-1") as file:
        for line in file:
            process, _, text = line.rstrip("\n").partition(" ")
            text = text.strip()
            if text.endswith("<unfinished ...>"):
                unfinished[process] = text[:-len("<unfinished ...>")]
                continue
            resumed = re.match(r"<\.\.\. \w+ resumed>(.*)", text)
            if resumed:
                text = unfinished.pop(process, "") + resumed.group(1)
            call = call_of(text)
            if call:
                calls.append(call)
    return calls


def call_of(text):
    match = re.match(r"(\w+)\((.*)\)\s+= (-?\d+)", text)
    if not match or int(match.group(3)) < 0:
        return None
    call, arguments, result = match.group(1), match.group(2), int(match.group(3))
    descriptors = [name_of(found) for found in re.findall(r"(?:\d+|AT_FDCWD)<([^>]*)>", arguments)]
    strings = re.findall(r'"((?:\\x[0-9a-f]{2})*)"', arguments)
    paths = [name_of(found) for found in strings]

    def at(index):
        base = descriptors[index] if index < len(descriptors) else "/"
        return os.path.normpath(os.path.join(base, paths[index]))

    if call in ("openat", "openat2"):
        return ("make", at(0), False) if "O_CREAT" in arguments else None
    if call in ("mkdir", "mkdirat"):
        return "make", at(0), True
    if call in ("write", "pwrite64"):
        return ("write", descriptors[0], plain(strings[0])[:result]) if strings else None
    if call == "ftruncate":
        return "truncate", descriptors[0], int(arguments.split(",")[-1])
    if call in ("fsync", "fdatasync"):
        return "sync", descriptors[0]
    if call in ("rename", "renameat", "renameat2"):
        return "rename", at(0), at(1)
    return "remove", at(0)
