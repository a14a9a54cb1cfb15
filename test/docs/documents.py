"""The commands that the documents show."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    *sorted((ROOT / 'docs').rglob('*.md')),
]
#: Blocks that are no commands begin with one of these.
NO_COMMANDS = (
    'x (forward)',  # a drawing
    'sweep, matching and scan took',  # what the demo prints
    'stripe_columns:',  # parameters
    'β(x) =',  # a formula
)
#: The package's executables.
OURS = (
    *('panodepth_ros', 'arm_driver', 'camera', 'mosaicer', 'depth', 'calibrator', 'check_scan'),
    *('views', 'simulated_arm'),
)
#: Words that begin a command in the middle of a sentence.
PROGRAMS = (
    *OURS,
    *('ros2', 'make', 'python', 'pip', 'colcon', 'rosdep', 'apt-get'),
    *('.ci/run', '.venv/jazzy/bin/python', 'v4l2-ctl', 'git', 'rviz2'),
)


def commands(document: Path) -> list[str]:
    """Commands of a document in their order, without prompts and remarks."""
    text = document.read_text()
    found: list[tuple[int, str]] = []
    fences = re.compile(r'^( *)```(\w*)\n(.*?)^\1```', re.MULTILINE | re.DOTALL)
    for match in fences.finditer(text):
        if match[2] == 'console':
            lines = re.findall(r'^ *\$ (.*)$', match[3], re.MULTILINE)
            found += [(match.start(), line) for line in lines]
        elif match[2] != 'python':
            found.append((match.start(), f'```{match[2]}'))  # a fence of an unknown kind
    text = fences.sub(lambda match: re.sub(r'[^\n]', '#', match[0]), text)
    blocks = re.compile(r'(?<=\n\n)((?: {4,}[^\n]*\n)+)')
    for match in blocks.finditer(text):
        if match[0].strip().startswith(NO_COMMANDS) or match[0].lstrip()[0] in '*-0123456789':
            continue  # an item of a list, or no commands
        if _continues_a_list(text[: match.start()]) and not _is_command(match[0]):
            continue
        found += [(match.start(), line.strip()) for line in match[0].splitlines()]
    for match in re.finditer(r'(?<!`)`([^`]+)`(?!`)', text):
        inside = ' '.join(match[1].split())
        if inside.split()[0] in PROGRAMS and ' ' in inside:
            found.append((match.start(), inside))
    return [re.sub(r'\s+#.*$', '', command) for _, command in sorted(found, key=lambda f: f[0])]


def _is_command(text: str) -> bool:
    return text.split(maxsplit=1)[0] in PROGRAMS


def _continues_a_list(before: str) -> bool:
    """Whether the paragraph before is a part of a list, whose own paragraphs are indented."""
    last = before.rstrip().rpartition('\n\n')[2]
    return bool(re.match(r' *(\*|-|\d+\.) | {2,}', last))
