#!/usr/bin/env python3
"""Measures the structure of the Rust code and fails where it breaks a rule of the project.

    structure.py            prints the figures, a line a crate
    structure.py --check    prints what breaks a rule, a line each, and exits with 1 where something does
    structure.py --list constants|closures|types|circles|pub CRATE    prints the places behind one figure

Code inside `#[cfg(test)]` and in test files is left out. Rules: no circle of imports between files;
every numeric constant says its source; comments stay within 100 columns; a type's name is used
once; few numeric constants, closures with names and public items. Where the code does not keep a
rule yet, LIMITS says how far it is off: it may not get worse.
"""
import argparse
import collections
import math
import os
import re
import subprocess
import sys

ROOT = os.path.normpath(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
CRATES = {"scene": "scene/src", "preprocess": "preprocess/src", "sfm": "sfm/src", "splat": "splat/src", "stereo": "stereo/src", "baselines": "baselines/src", "lighting": "lighting/src", "shape": "shape/src", "sat-recon": "src"}
COMMENT_COLUMNS = 100
# What the code has of each at most. Lower a limit when the code gets better; never raise one.
LIMITS = {
    "circles of imports": 0,
    "numeric constants without a source": 0,
    "comments that are too wide": 0,
    "type names defined more than once": 0,
    "numeric constants per 1000 lines": 8.0,
    "closures with a name per 1000 lines": 2.5,
    "public items of splat": 120,
    "public items of sfm": 160,
}
NUMBER = r"(?:[fiu](?:8|16|32|64|128|size)|D?(?:Vec|Mat)[234]|Duration|NonZero\w+)"
CONSTANT = re.compile(rf"^\s*(?:pub(?:\([^)]*\))? )?(?:const|static) ([A-Z][A-Z0-9_]*): (?:&(?:'static )?)?[\[(]*(?:&(?:'static )?)?{NUMBER}\b")
CLOSURE = re.compile(r"^\s*let (?:mut )?\w+(?:: [^=]+)? =\s*(?:move )?\|")
TYPE = re.compile(r"^\s*(?:pub(?:\([^)]*\))? )?(?:struct|enum|trait|union) ([A-Z]\w*)")
REEXPORT = re.compile(r"\bpub(?:\([^)]*\))? use\s+([^;]*);")
PUBLIC = re.compile(r"^\s*pub (?:const |async |unsafe )*(?:fn|struct|enum|trait|const|static|type|mod|use|union)\b")


def files():
    """Rust files of the crates' sources that are no test files."""
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "-co", "--exclude-standard", "*.rs"], capture_output=True, text=True, check=True)
    for path in sorted(listed.stdout.split()):
        crate = next((c for c, folder in CRATES.items() if path.startswith(folder + "/")), None)
        name = os.path.basename(path)
        if crate and os.path.exists(os.path.join(ROOT, path)) and not (name in ("tests.rs", "testing.rs") or name.endswith("_tests.rs") or "/tests/" in path or "/parity/" in path):
            yield crate, path


def without_tests(text):
    """The lines that are not inside an item marked `#[cfg(test)]`, with their numbers."""
    kept, depth, skipping, pending = [], 0, False, False
    for number, line in enumerate(text.split("\n"), 1):
        bare = re.sub(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'|//.*', "", line)
        if not skipping and re.match(r"\s*#\[cfg\((?:test|all\(test)", line):
            pending = True
            continue
        if pending and not skipping:
            if bare.strip().startswith("#["):
                continue
            pending, opened = False, bare.count("{") - bare.count("}")
            if opened > 0:
                skipping, depth = True, opened
            elif not bare.rstrip().endswith((";", "}")) and "{" not in bare:
                pending = True
            continue
        if skipping:
            depth += bare.count("{") - bare.count("}")
            skipping = depth > 0
            continue
        kept.append((number, line))
    return kept


class Source:
    """One file, as far as it is no test."""

    def __init__(self, crate, path):
        self.crate, self.path = crate, path
        with open(os.path.join(ROOT, path)) as stream:
            self.lines = without_tests(stream.read())

    def module(self):
        """Names of the modules from the crate's root to this one."""
        parts = os.path.splitext(os.path.relpath(self.path, CRATES[self.crate]))[0].split("/")
        return tuple(parts[:-1] if parts[-1] in ("mod", "lib", "main") else parts)

    def constants(self):
        """Numeric constants: line, name, and whether the comment above says a source."""
        comment = []
        for number, line in self.lines:
            bare = line.strip()
            found = CONSTANT.match(line)
            if found:
                yield number, found.group(1), "Source:" in " ".join(comment)
            if bare.startswith("//"):
                comment.append(bare)
            elif not (bare.startswith("#[") or found):
                comment = []

    def matching(self, pattern):
        return [(number, found) for number, line in self.lines if (found := pattern.match(line))]


def expanded(tree, prefix=()):
    """Paths of a `use` tree such as `a::{b, c::{d, e}}`."""
    tree = tree.strip()
    depth, start, parts = 0, 0, []
    for i, c in enumerate(tree):
        depth += (c == "{") - (c == "}")
        if c == "," and depth == 0:
            parts.append(tree[start:i])
            start = i + 1
    parts.append(tree[start:])
    for part in (p.strip() for p in parts if p.strip()):
        head, brace, rest = part.partition("{")
        path = prefix + tuple(s for s in head.split(" as ")[0].strip().split("::") if s)
        if brace:
            yield from expanded(rest.rstrip()[:-1] if rest.rstrip().endswith("}") else rest, path)
        else:
            yield path


def imports(source, modules):
    """Files of the same crate from which this one takes names."""
    text = "\n".join(line.split("//")[0] for _, line in source.lines)
    here = source.module()
    text = REEXPORT.sub("", text)  # hands a name on and takes none
    paths = [p for use in re.findall(r"\buse\s+((?:crate|super|self|[a-z]\w*)[^;]*);", text) for p in expanded(re.sub(r"\s+", " ", use))]
    body = re.sub(r"\buse\s+[^;]*;", "", text)
    paths += [tuple(p.split("::")) for p in re.findall(r"\b(?:(?:crate|super|self|[a-z]\w*)::)+[A-Za-z]\w*", body)]
    for path in paths:
        at, rest = None, list(path)
        if rest[0] == "crate":
            at, rest = (), rest[1:]
        elif rest[0] == "self":
            at, rest = here, rest[1:]
        elif rest[0] == "super":
            at = here
            while rest and rest[0] == "super":
                at, rest = at[:-1], rest[1:]
        elif here + (rest[0],) in modules[source.crate]:
            at = here
        if at is None:
            continue
        while rest and at + (rest[0],) in modules[source.crate]:
            at, rest = at + (rest[0],), rest[1:]
        yield at, rest[0] if rest else None


def graph(sources):
    """Arrows between files by the names that they take from each other: [file][file] = names."""
    modules = collections.defaultdict(dict)
    for s in sources:
        modules[s.crate][s.module()] = s
    exported = {}
    for s in sources:
        found = {}
        text = "\n".join(line.split("//")[0] for _, line in s.lines)
        for use in REEXPORT.findall(text):
            for path in expanded(re.sub(r"\s+", " ", use)):
                found[path[-1]] = path
        exported[s.crate, s.module()] = found
    arrows = collections.defaultdict(lambda: collections.defaultdict(set))
    for s in sources:
        for at, name in imports(s, modules):
            for _ in range(8):
                again = exported.get((s.crate, at), {}).get(name)
                if again is None:
                    break
                step, rest = at, list(again)
                if rest[0] == "crate":
                    step, rest = (), rest[1:]
                elif rest[0] == "self":
                    rest = rest[1:]
                while rest and rest[0] == "super":
                    step, rest = step[:-1], rest[1:]
                while rest and step + (rest[0],) in modules[s.crate]:
                    step, rest = step + (rest[0],), rest[1:]
                if (step, rest[0] if rest else None) == (at, name):
                    break
                at, name = step, rest[0] if rest else None
            target = modules[s.crate].get(at)
            # A name that is a module itself (`use super::turn`) is no item of it.
            if target and target is not s and name is not None:
                arrows[s.path][target.path].add(name)
    return arrows


def circles(arrows):
    """Strongly connected components of more than one file (Tarjan, SIAM J. Comput. 1972)."""
    index, low, stack, on, found = {}, {}, [], set(), []

    def visit(v):
        index[v] = low[v] = len(index)
        stack.append(v)
        on.add(v)
        for w in arrows.get(v, {}):
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            component = []
            while True:
                w = stack.pop()
                on.discard(w)
                component.append(w)
                if w == v:
                    break
            if len(component) > 1:
                found.append(sorted(component))

    sys.setrecursionlimit(10000)
    for v in sorted(arrows):
        if v not in index:
            visit(v)
    return sorted(found)


def long_comments():
    """Comment lines of any Rust file that are too wide."""
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "-co", "--exclude-standard", "*.rs", "*.wgsl", "*.cc", "*.h"], capture_output=True, text=True, check=True)
    for path in listed.stdout.split():
        if not os.path.exists(os.path.join(ROOT, path)):
            continue
        with open(os.path.join(ROOT, path)) as stream:
            for number, line in enumerate(stream, 1):
                if line.strip().startswith("//") and len(line.rstrip("\n")) > COMMENT_COLUMNS:
                    yield f"{path}:{number}: a comment of {len(line) - 1} columns; {COMMENT_COLUMNS} is the most"


def table(sources, arrows):
    """The figures of each crate and of all."""
    names = collections.Counter(found.group(1) for s in sources for _, found in s.matching(TYPE))
    print(f"{'crate':12} {'lines':>6} {'constants':>9} {'per 1000':>8} {'sourced':>7} {'closures':>8} {'per 1000':>8} {'pub':>5}")
    for crate in [*CRATES, "all"]:
        some = [s for s in sources if crate in (s.crate, "all")]
        lines = sum(len(s.lines) for s in some)
        constants = [c for s in some for c in s.constants()]
        closures = sum(len(s.matching(CLOSURE)) for s in some)
        public = sum(len(s.matching(PUBLIC)) for s in some)
        sourced = sum(c[2] for c in constants) / max(len(constants), 1)
        print(f"{crate:12} {lines:6} {len(constants):9} {1e3 * len(constants) / lines:8.1f} {sourced:7.0%} "
              f"{closures:8} {1e3 * closures / lines:8.1f} {public:5}")
    print(f"type names {len(names)}, defined more than once {sum(n > 1 for n in names.values())}; circles of imports {len(circles(arrows))}")


def places(sources, arrows, what, crate):
    """The places behind a figure."""
    some = [s for s in sources if crate in (s.crate, "all")]
    if what == "circles":
        for circle in circles(arrows):
            print(f"circle of {len(circle)}")
            for a in circle:
                for b in circle:
                    if b in arrows[a]:
                        print(f"  {a} -> {b}: {', '.join(sorted(arrows[a][b]))}")
    elif what == "types":
        where = collections.defaultdict(list)
        for s in sources:
            for number, found in s.matching(TYPE):
                where[found.group(1)].append(f"{s.path}:{number}")
        for name, at in sorted(where.items()):
            if len(at) > 1 and (crate == "all" or any(p.startswith(CRATES[crate]) for p in at)):
                print(f"{name}: {' '.join(at)}")
    else:
        for s in some:
            if what == "constants":
                rows = [(number, f"{name}{'' if sourced else ' (no source)'}") for number, name, sourced in s.constants()]
            else:
                rows = [(number, found.group(0).strip()) for number, found in s.matching({"closures": CLOSURE, "pub": PUBLIC}[what])]
            for number, text in rows:
                print(f"{s.path}:{number}: {text}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--list", nargs=2, metavar=("WHAT", "CRATE"))
    args = parser.parse_args()
    sources = [Source(crate, path) for crate, path in files()]
    arrows = graph(sources)
    if args.list:
        places(sources, arrows, *args.list)
        return 0
    if not args.check:
        table(sources, arrows)
        return 0
    return check(sources, arrows)


def check(sources, arrows):
    """Holds the code against LIMITS; what breaks a rule is listed where a limit is exceeded."""
    lines = sum(len(s.lines) for s in sources)
    constants = [(s, *c) for s in sources for c in s.constants()]
    names = collections.Counter(found.group(1) for s in sources for _, found in s.matching(TYPE))
    wide = list(long_comments())
    unsourced = [f"{s.path}:{number}: {name} says no source" for s, number, name, sourced in constants if not sourced]
    round_up = lambda count: math.ceil(1e4 * count / lines) / 10
    found = {
        "circles of imports": [", ".join(circle) for circle in circles(arrows)],
        "numeric constants without a source": unsourced,
        "comments that are too wide": wide,
        "type names defined more than once": [name for name, n in names.items() if n > 1],
        "numeric constants per 1000 lines": round_up(len(constants)),
        "closures with a name per 1000 lines": round_up(sum(len(s.matching(CLOSURE)) for s in sources)),
    } | {
        f"public items of {crate}": sum(len(s.matching(PUBLIC)) for s in sources if s.crate == crate) for crate in ("splat", "sfm")
    }
    status = 0
    for rule, what in found.items():
        count = len(what) if isinstance(what, list) else what
        if count > LIMITS[rule]:
            status = 1
            print("\n".join(what) if isinstance(what, list) else "", end="\n" if isinstance(what, list) else "")
            print(f"{rule}: {count}, {LIMITS[rule]} at most (tools/structure.py --list shows the places)")
    return status


if __name__ == "__main__":
    sys.exit(main())
