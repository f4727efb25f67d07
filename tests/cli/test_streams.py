"""Output that nobody reads: closed streams, terminals without letters, Python without docstrings."""

import os
import subprocess
import sys

import pytest

from magphonon.scenes.scene import ready_scene


def command(*arguments, **options):
    """The command in a process of its own, as a shell would start it."""
    return subprocess.run([sys.executable, '-m', 'magphonon', *map(str, arguments)], timeout=600, text=True,
                          **({'capture_output': True} | options))


@pytest.mark.slow
def test_closed_streams_cost_nothing(tmp_path):
    """As `>&-` and `2>&-` close them: results are written all the same."""
    file = tmp_path / 'chain.toml'
    file.write_text(ready_scene('chain').read_text())
    for stream in (1, 2):
        out = tmp_path / str(stream)
        done = command('bands', file, '-o', out, capture_output=False, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                       preexec_fn=lambda stream=stream: os.close(stream))
        assert (done.returncode, done.stderr) == (0, '')
        assert (out / 'bands.csv').exists()


@pytest.mark.slow
def test_letters_that_the_terminal_lacks(tmp_path):
    file = tmp_path / 'chain.toml'
    file.write_text(ready_scene('chain').read_text().replace('title = "', 'title = "größe 😀 '), encoding='utf-8')
    done = command('check', file, env={**os.environ, 'PYTHONIOENCODING': 'ascii', 'LC_ALL': 'C'})
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.startswith('gr\\xf6\\xdfe \\U0001f600')


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='a system without such files')
def test_a_report_that_cannot_be_shown_has_a_status_of_its_own(tmp_path):
    (tmp_path / 'law.csv').write_text('r_mm,f_N\n1,16\n2,8\n4,4\n8,2\n16,1\n')
    fit = ('fit', tmp_path / 'law.csv', '-o', tmp_path / 'out')
    for arguments, written in ((('scene', 'chain'), ''), (fit, '; the results are written')):
        with open('/dev/full', 'w') as full:
            done = command(*arguments, capture_output=False, stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 3
        assert done.stderr.strip() == f'magphonon: the report could not be shown (No space left on device){written}'


@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='a system without such files')
def test_a_mistake_keeps_its_status_where_its_message_cannot_be_shown(tmp_path):
    with open('/dev/full', 'w') as full:
        done = command('check', tmp_path / 'none.toml', capture_output=False, stderr=full, stdout=subprocess.PIPE)
    assert (done.returncode, done.stdout) == (2, '')


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists('/proc'), reason='a system without a folder in which nobody can write')
def test_no_docstrings_another_backend_and_a_home_that_cannot_be_written_change_nothing(tmp_path):
    homes = ('MPLCONFIGDIR', 'XDG_CACHE_HOME', 'XDG_CONFIG_HOME')
    shell = {name: value for name, value in os.environ.items() if name not in homes} | {'HOME': '/proc', 'PYTHONOPTIMIZE': '2'}
    bare = subprocess.run([sys.executable, '-c', 'import matplotlib'], env=shell, capture_output=True, text=True, check=True)
    assert 'cache directory' in bare.stderr  # the control: what matplotlib says of such a home
    shell['MPLBACKEND'] = 'bogus'
    (tmp_path / 'chain.toml').write_text(ready_scene('chain').read_text())
    done = command('bands', tmp_path / 'chain.toml', '-o', tmp_path / 'out', env=shell)
    assert (done.returncode, done.stderr) == (0, '')
    assert (tmp_path / 'out' / 'bands.png').exists()
    assert command('--version', env=shell).stdout.startswith('magphonon ')
