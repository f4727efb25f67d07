"""The list of keys follows the models: what it calls allowed is read, and what lies outside is refused."""

import tomllib

import pytest

from magphonon.cli.main import main
from magphonon.scenes.fields import UNITS
from magphonon.scenes.keys import scene_keys
from magphonon.scenes.scene import Scene, ready_scenes

KEYS = scene_keys()
PLACES = {(key.table, kind, key.name): key for key in KEYS for kind in key.kinds or ('',)}


def places(table, place=''):
    """(table, kind, name) of everything that stands in a scene."""
    for name, value in table.items():
        yield place, str(table.get('kind', '')), name
        if isinstance(value, dict):
            yield from places(value, f'{place}.{name}' if place else name)


@pytest.mark.parametrize('name', ready_scenes())
def test_every_key_of_a_ready_scene_is_listed(name):
    for table, kind, key in places(tomllib.loads(ready_scenes()[name].read_text(encoding='utf-8'))):
        assert (table, kind, key) in PLACES or (table, '', key) in PLACES


def test_every_key_of_the_schema_is_listed_and_described():
    schema = Scene.model_json_schema()
    names = {name for model in [schema, *schema['$defs'].values()] for name in model['properties']}
    assert {key.name for key in KEYS} == names
    assert [key.place for key in KEYS if not key.description] == []
    # a tolerance in the unit of its parameter needs no example, the one in percent has one
    told = [key for key in KEYS if not key.type.startswith('table') and key.table != 'uncertainty']
    assert [key.place for key in told if not key.example] == []


def test_every_number_with_a_unit_tells_it():
    ends = tuple(UNITS)
    assert [key.place for key in KEYS if bool(key.unit) != (key.name.endswith(ends) and not key.type.startswith('table'))] == []


def prototype():
    return tomllib.loads(ready_scenes()['prototype'].read_text(encoding='utf-8'))


def refused(place, value):
    """The message for a scene in which the key has this value, or None if it is read."""
    scene = table = prototype()
    *tables, name = place.split('.')
    for step in tables:
        table = table[step]
    table[name] = value
    try:
        Scene.model_validate(scene)
    except ValueError as error:
        return str(error)


RANGED = [key for key in KEYS if ' to ' in key.allowed and key.type == 'number' and not key.kinds
          and key.table in ('lattice', 'foundation.pillar', 'frf', 'vibrometer', 'frf.force')]


@pytest.mark.parametrize('key', RANGED, ids=lambda key: key.place)
@pytest.mark.filterwarnings('ignore:.*denser than any metal')
def test_the_range_is_that_of_the_check(key):
    least, most = map(float, key.allowed.split(' to '))
    words = 'must lie between'
    for inside in (least, most):  # other checks may refuse it, as no such lattice can be computed
        assert words not in (refused(key.place, inside) or '') or inside == 0
    for outside in (least - 0.01 * abs(least) - 1e-40, 1.01 * most):
        message = refused(key.place, outside)
        assert message is not None
        assert words in message or 'positive' in message


def test_one_table_is_listed_with_those_in_it():
    assert {key.table for key in scene_keys('law')} == {'law', *(f'law.{shape}' for shape in
                                                               ('ring', 'disc', 'sphere', 'cuboid', 'calibration'))}


def test_the_command_prints_them(capsys):
    assert main(['scene', '--keys', 'foundation']) == 0
    out = capsys.readouterr().out
    assert 'density_kg_per_m3' in out
    assert '[law]' not in out
    assert main(['scene', '--keys']) == 0
    out = capsys.readouterr().out
    assert {key.name for key in KEYS} <= {line.split()[0] for line in out.splitlines() if line}
    assert max(map(len, out.splitlines())) <= 100
    for wrong, meant in (('lwa', "did you mean 'law'?"), ('spacing', "did you mean 'spacing_m'?"), ('zz', 'the tables are ')):
        assert main(['scene', '--keys', wrong]) == 2
        assert meant in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'places'), [
    ('theta0_deg', ['lattice.theta0_deg']), ('lattice.spacing_m', ['lattice.spacing_m']),
    ('spacing_m', ['lattice.spacing_m', 'uncertainty.spacing_m']), ('title', ['title'])])
def test_a_key_is_found_by_its_name(name, places, capsys):
    assert [key.place for key in scene_keys(name)] == places
    assert main(['scene', '--keys', name]) == 0
    assert capsys.readouterr().out.count(f'  {name.split(".")[-1]} ') >= len(places)
