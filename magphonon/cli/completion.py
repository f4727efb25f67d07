"""`magphonon completion SHELL`: a script that completes commands, options, ready scenes and files in bash or zsh.

Write it once, in bash with `magphonon completion bash > ~/.local/share/bash-completion/completions/magphonon`, in zsh to the file
`_magphonon` in a directory of `$fpath`, and again after an update of magphonon. Completing a word starts no Python.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, _SubParsersAction

HELP = 'complete commands, scenes and files with the tab key'
FUNCTIONS = {
    'bash': '''_magphonon_scene_files() {{ compgen -W "{names}" -- "$1"; compgen -f -X '!*.toml' -- "$1"; compgen -d -- "$1"; }}
_magphonon_ready() {{ compgen -W "{names}" -- "$1"; }}
_magphonon_files_or_ready() {{ compgen -W "{names}" -- "$1"; compgen -f -- "$1"; }}''',
    'zsh': '''_magphonon_scene_files() {{ _alternative "ready:ready scene:({names})" "files:scene file:_files -g '*.toml'" }}
_magphonon_ready() {{ _alternative "ready:ready scene:({names})" }}
_magphonon_files_or_ready() {{ _alternative "ready:ready scene:({names})" "files:file:_files" }}''',
}
"""Shell functions that complete scenes.  Their names contain 'file', so that shtab makes bash append a slash to a directory."""
SHELLS = tuple(FUNCTIONS)
SCENE, READY, SCANS = (dict.fromkeys(SHELLS, name) for name in ('_magphonon_scene_files', '_magphonon_ready',
                                                                '_magphonon_files_or_ready'))  # after scans comes a scene


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('shell', choices=SHELLS, metavar='SHELL', help=' or '.join(SHELLS))


def run(options: Namespace) -> None:
    try:
        import shtab
    except ImportError:
        raise ValueError("the script is made by shtab, which is missing; pip install 'magphonon[completion]' brings it") from None
    from ..scenes.sources import ready_scenes
    from .main import parser_of

    parser, names = parser_of(), ' '.join(ready_scenes())
    completed = {'scene': SCENE, 'name': READY, 'output': shtab.DIRECTORY, 'files': shtab.DIRECTORY}
    completed |= {'tables': SCANS} | dict.fromkeys(('file', 'geometry', 'style', 'page'), shtab.FILE)
    [commands] = [action for action in parser._actions if isinstance(action, _SubParsersAction)]
    for command in commands._choices_actions:  # zsh shows descriptions, and these are too long
        commands.choices[command.dest].description = command.help
    for action in [action for command in commands.choices.values() for action in command._actions]:
        if action.dest in completed:
            action.complete = completed[action.dest]  # pyright: ignore[reportAttributeAccessIssue]  which shtab looks for
    print(shtab.complete(parser, options.shell, preamble=FUNCTIONS[options.shell].format(names=names)))
